"""Vertices that materials move, and the normals of meshes whose vertices moved."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.displacement.vertices import MovedVertices, moved_mesh, vertex_normals
from raybatch_addon.core.scene.description import Mesh


def grid(count: int, smooth: bool = True) -> Mesh:
    """A square of -1 to 1 in the plane z = 0, of count x count quads."""
    side = np.linspace(-1, 1, count + 1)
    x, y = np.meshgrid(side, side)
    positions = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).reshape(-1)
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + count + 2], -1), np.stack([a, a + count + 2, a + count + 1], -1)]
    )
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(triangles), 3, 1)) if smooth else None
    return Mesh("grid", positions, triangles.astype(np.int32), None, corner_normals=normals)


def all_of(mesh: Mesh) -> tuple[MovedVertices, np.ndarray]:
    moves = np.ones(len(mesh.triangles), bool)
    return MovedVertices.of(mesh, moves), moves


def waves(mesh: Mesh, height: float) -> np.ndarray:
    """A wave along x, as offsets along z."""
    offset = np.zeros((len(mesh.positions), 3))
    offset[:, 2] = height * np.sin(3 * mesh.positions[:, 0])
    return offset


def test_normals_of_a_moved_plane_are_those_of_the_surface_that_it_becomes():
    errors = []
    for count in (32, 64):
        mesh = grid(count)
        moved, moves = all_of(mesh)
        wave = moved_mesh(mesh, moved, waves(mesh, 0.2), moves)
        corners = wave.positions[mesh.triangles]
        slope = 0.6 * np.cos(3 * corners[..., 0])
        true = np.stack([-slope, np.zeros_like(slope), np.ones_like(slope)], -1)
        true /= np.linalg.norm(true, axis=-1, keepdims=True)
        inside = np.abs(corners[..., :2]).max((-1, -2)) < 0.9
        errors.append(np.abs(wave.corner_normals - true)[inside].max())
        assert np.allclose(np.linalg.norm(wave.corner_normals, axis=-1), 1, atol=1e-6)
        assert wave.base_positions is mesh.positions
    assert errors[1] < 0.35 * errors[0] < 0.005  # of second order


def test_a_vertex_is_seen_from_the_first_triangle_that_has_it_and_displaces():
    mesh = grid(1)  # triangles 0 1 3 and 0 3 2
    moved = MovedVertices.of(mesh, np.array([True, True]))
    assert moved.vertex.tolist() == [0, 1, 2, 3]
    assert list(zip(moved.triangle.tolist(), moved.corner.tolist())) == [(0, 0), (0, 1), (1, 2), (0, 2)]
    moved = MovedVertices.of(mesh, np.array([False, True]))
    assert moved.vertex.tolist() == [0, 2, 3]
    assert list(zip(moved.triangle.tolist(), moved.corner.tolist())) == [(1, 0), (1, 2), (1, 1)]


def test_flat_triangles_stay_flat_beside_smooth_ones():
    mesh = grid(4)
    flat = np.arange(len(mesh.triangles)) % 3 == 0
    mesh = dataclasses.replace(mesh, flat=flat)
    moved, moves = all_of(mesh)
    wave = moved_mesh(mesh, moved, waves(mesh, 0.3), moves)
    assert not wave.corner_normals[flat].any()
    assert np.allclose(np.linalg.norm(wave.corner_normals[~flat], axis=-1), 1, atol=1e-6)
    assert moved_mesh(grid(4, smooth=False), moved, waves(mesh, 0.3), moves).corner_normals is None


def test_sharp_edges_stay_sharp_and_smooth_ones_smooth():
    """Two walls that meet at a right angle, moved outwards along their own normals."""
    positions = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1), (0, 1, 0), (0, 1, 1)], np.float32)
    triangles = np.array([(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4)], np.int32)
    walls = np.array([(0, -1, 0), (0, -1, 0), (-1, 0, 0), (-1, 0, 0)], np.float32)
    sharp = Mesh("sharp", positions, triangles, None, corner_normals=np.repeat(walls[:, None], 3, 1))
    moved, moves = all_of(sharp)
    offset = np.full((6, 3), 0.25)
    assert np.allclose(moved_mesh(sharp, moved, offset, moves).corner_normals, sharp.corner_normals, atol=1e-6)
    smooth_normals = vertex_normals(sharp)[triangles].astype(np.float32)
    smooth = dataclasses.replace(sharp, corner_normals=smooth_normals)
    renewed = moved_mesh(smooth, moved, offset, moves).corner_normals
    edge = renewed[triangles < 2]
    assert np.allclose(edge, (-np.sqrt(0.5), -np.sqrt(0.5), 0), atol=1e-6)


def test_normals_are_kept_where_bumps_are_added_to_them():
    mesh = grid(4)
    moved, moves = all_of(mesh)
    wave = moved_mesh(mesh, moved, waves(mesh, 0.3), np.zeros_like(moves))
    assert np.array_equal(wave.corner_normals, mesh.corner_normals)
    assert not np.array_equal(wave.positions, mesh.positions)


def test_vertex_normals_are_weighted_by_angles():
    """A corner of a cube: three right angles, of which one is two triangles."""
    positions = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)], np.float32)
    triangles = np.array([(0, 4, 1), (0, 2, 4), (0, 1, 3), (0, 3, 2)], np.int32)
    corner = vertex_normals(Mesh("corner", positions, triangles))[0]
    assert corner == pytest.approx(np.full(3, -np.sqrt(1 / 3)), abs=1e-7)


def test_a_mesh_that_deforms_is_displaced_alike_at_all_times():
    mesh = grid(3)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    steps = np.stack([mesh.positions, mesh.positions + up])
    mesh = dataclasses.replace(mesh, motion=steps, motion_normals=np.stack([mesh.corner_normals] * 2))
    moved, moves = all_of(mesh)
    wave = moved_mesh(mesh, moved, waves(mesh, 0.3), moves)
    assert np.allclose(wave.motion[0], wave.positions, atol=1e-6)
    assert np.allclose(wave.motion[1] - wave.motion[0], up, atol=1e-6)
    assert np.array_equal(wave.motion_normals[1], wave.corner_normals)
