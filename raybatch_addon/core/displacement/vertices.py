"""The vertices of one mesh that materials move, and the mesh once they are moved. NumPy alone."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..scene.description import Mesh
from ..scene.frozen import freeze


@dataclass(frozen=True)
class MovedVertices:
    """Vertices of a mesh that are moved, and where each is seen from: as in Cycles, the first triangle that has it and
    whose material displaces.
    """

    vertex: np.ndarray  # indices into `Mesh.positions`, int64, shape [n]
    triangle: np.ndarray  # int64, shape [n]
    corner: np.ndarray  # of that triangle, 0 to 2, int64, shape [n]

    @staticmethod
    def of(mesh: Mesh, moves: np.ndarray) -> MovedVertices:
        """`moves`: for each triangle, whether its material displaces; bool, shape [triangle_count]."""
        displaced = np.flatnonzero(moves)
        vertex, place = np.unique(mesh.triangles[displaced].reshape(-1), return_index=True)
        return MovedVertices(vertex.astype(np.int64), displaced[place // 3], place % 3)


def triangle_crosses(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals of triangles, as long as twice their area [m²], float64, shape [n, 3]."""
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def units(vectors: np.ndarray) -> np.ndarray:
    """`vectors` at length 1; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def cofactors(linear: np.ndarray) -> np.ndarray:
    """The map that takes normals where `linear` takes directions, float64, shape [3, 3]; a mirrored triangle keeps its
    front outside.
    """
    return np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]) * (np.sign(np.linalg.det(linear)) or 1.0)


def vertex_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals of vertices, float64, shape [vertex_count, 3]: those of their triangles, weighted by the angle at
    the vertex, as Blender has them.
    """
    normals = units(triangle_crosses(mesh.positions, mesh.triangles))
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    total = np.zeros((len(mesh.positions), 3))
    for k in range(3):
        to_next = units(corners[:, (k + 1) % 3] - corners[:, k])
        to_last = units(corners[:, (k + 2) % 3] - corners[:, k])
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", to_next, to_last), -1, 1))
        _add_at(total, mesh.triangles[:, k], angle[:, None] * normals)
    return units(total)


def moved_mesh(mesh: Mesh, moved: MovedVertices, offset: np.ndarray, renewed: np.ndarray) -> Mesh:
    """`mesh` with vertices moved by `offset` [m], in object space, shape [n, 3].

    Triangles of `renewed`, bool, shape [triangle_count], get new normals: at each vertex the mean of the unit normals
    of these triangles, as in Cycles, among those whose corners had the same normal there, so that sharp edges stay
    sharp. Other corners keep the normal that they have. A triangle that was flat stays flat. Where the mesh deforms
    its vertices are as far from where they were at all times, and its normals those of the middle. The arrays are
    frozen.
    """
    positions = mesh.positions.astype(np.float64)
    positions[moved.vertex] += offset
    positions = positions.astype(np.float32)
    normals = mesh.corner_normals
    if normals is not None:
        normals = freeze(_renewed_normals(mesh, positions, renewed))
    steps, step_normals = mesh.motion, mesh.motion_normals
    if steps is not None:
        steps = freeze((steps + (positions - mesh.positions)).astype(np.float32))
    if step_normals is not None:  # those of undisplaced surfaces
        step_normals = freeze(np.broadcast_to(normals, step_normals.shape).copy())
    return dataclasses.replace(
        mesh,
        positions=freeze(positions),
        corner_normals=normals,
        base_positions=mesh.positions,
        motion=steps,
        motion_normals=step_normals,
    )


def used_meshes(meshes: list[Mesh], mesh_of: np.ndarray) -> tuple[list[Mesh], np.ndarray]:
    """The meshes that instances place, in their order."""
    used, index = np.unique(mesh_of, return_inverse=True)
    return [meshes[k] for k in used.tolist()], index.reshape(-1).astype(np.int32)


def _renewed_normals(mesh: Mesh, positions: np.ndarray, renewed: np.ndarray) -> np.ndarray:
    normals = mesh.corner_normals.copy()
    which = np.flatnonzero(renewed)
    if mesh.flat is not None:
        normals[mesh.flat] = 0
        which = np.flatnonzero(renewed & ~mesh.flat)
    if len(which) == 0:
        return normals
    after = units(triangle_crosses(positions, mesh.triangles[which]))
    corner_normals = np.ascontiguousarray(mesh.corner_normals[which].reshape(-1, 3))
    # corners of one vertex that had the same normal, to the bit, are one group
    keys = np.empty((len(corner_normals), 4), np.int32)
    keys[:, 0] = mesh.triangles[which].reshape(-1)
    keys[:, 1:] = (corner_normals + np.float32(0)).view(np.int32)
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    total = np.zeros((group.max() + 1, 3))
    _add_at(total, group, np.repeat(after, 3, axis=0))
    normals[which] = units(total)[group].reshape(-1, 3, 3).astype(np.float32)
    return normals


def _add_at(total: np.ndarray, index: np.ndarray, values: np.ndarray) -> None:
    for axis in range(3):
        total[:, axis] += np.bincount(index, values[:, axis], len(total))
