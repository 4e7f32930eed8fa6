"""Scenes whose materials displace, with programs that run on a device."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.displacement.displaced import DisplacedMeshes
from raybatch_addon.core.programs import ops  # noqa: F401 - files of ops register them
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Material, Mesh, Scene
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.shading.images.textures import ImageTable
from tests.support import scenes
from tests.support.under_test import DEVICE

TURNED = np.array([(0, -2, 0, 1), (1, 0, 0, 2), (0, 0, 3, 3)], np.float32)  # a quarter turn, stretched


def displacing(name: str, *steps: tuple) -> Material:
    """A white material that displaces along the shading normal, by a factor of each of `steps`."""
    builder = ProgramBuilder()
    value = builder.value("normals")[0]
    for factor in steps:
        value = builder.value("multiply_colors", value, (factor,) * 3)
    builder.closure("vertex_offset", value)
    return dataclasses.replace(scenes.diffuse(1.0), name=name, displacement=builder.finish())


def flat_square() -> Mesh:
    positions = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    mesh = Mesh("square", positions, np.array([(0, 1, 2), (0, 2, 3)], np.int32))
    freeze(mesh.positions), freeze(mesh.triangles)
    return mesh


def placed(*placements: tuple) -> Scene:
    """A scene of one square, placed with each transform and material."""
    return scenes.scene([(flat_square(), transform, material) for transform, material in placements])


def displaced(scene: Scene, meshes: DisplacedMeshes | None = None) -> Scene:
    return (meshes or DisplacedMeshes()).displaced(scene, ImageTable, wp.get_device(DEVICE))


def test_a_scene_without_displacement_is_left_as_it_is():
    scene = placed((scenes.IDENTITY, scenes.diffuse(1.0)))
    assert displaced(scene) is scene


def test_an_offset_of_the_world_moves_vertices_by_as_much_in_the_world():
    moved = displaced(placed((TURNED, displacing("raised", 0.5))))
    mesh = moved.meshes[moved.instances.mesh[0]]
    there = mesh.positions @ TURNED[:, :3].T + TURNED[:, 3]
    before = flat_square().positions @ TURNED[:, :3].T + TURNED[:, 3]
    assert there - before == pytest.approx(np.tile([0, 0, 0.5], (4, 1)), abs=1e-6)


def test_instances_that_displace_alike_share_a_mesh_and_others_have_their_own():
    high, low, none = displacing("high", 0.5), displacing("low", 0.25), scenes.diffuse(1.0)
    square = flat_square()
    scene = scenes.scene([(square, scenes.IDENTITY, each) for each in (high, high, low, none)])
    moved = displaced(scene)
    heights = [float(moved.meshes[k].positions[:, 2].max()) for k in moved.instances.mesh.tolist()]
    assert heights == pytest.approx([0.5, 0.5, 0.25, 0])
    assert moved.instances.mesh[0] == moved.instances.mesh[1] and len(moved.meshes) == 3


def test_what_is_not_finite_stays_where_it_is_and_is_named():
    moved = displaced(placed((scenes.IDENTITY, displacing("huge", 1e30, 1e30))))
    assert np.array_equal(moved.meshes[0].positions, flat_square().positions)
    (warning,) = moved.warnings
    assert "“huge” is not finite, or too large, at 4 vertices" in warning


def test_a_mesh_is_kept_while_it_is_displaced_alike():
    meshes, scene = DisplacedMeshes(), placed((TURNED, displacing("raised", 0.5)))
    first = displaced(scene, meshes).meshes[0]
    assert displaced(scene, meshes).meshes[0] is first
    other = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=TURNED[None] * 2))
    assert displaced(other, meshes).meshes[0] is not first
