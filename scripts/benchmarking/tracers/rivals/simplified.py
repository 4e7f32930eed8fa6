"""A simplified scene, in which rays find about where they will hit."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarking.scenes import BenchmarkScene
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.frozen import freeze


def simplified_scene(scene: BenchmarkScene, cells: int) -> BenchmarkScene:
    """`scene` with every mesh simplified to a grid of `cells` along its longest side."""
    meshes = tuple(simplified_mesh(mesh, cells) for mesh in scene.scene.meshes)
    for mesh in meshes:
        freeze(mesh.positions)
        freeze(mesh.triangles)
    made = dataclasses.replace(scene.scene, meshes=meshes)
    return dataclasses.replace(scene, scene=made, flat=flatten(made))


def simplified_mesh(mesh: Mesh, cells: int) -> Mesh:
    """The triangles of `mesh` that are left, each once, where all vertices of a cell become their mean (vertex
    clustering: Rossignac and Borrel 1993, "Multi-resolution 3D approximations for rendering complex scenes"); the mesh
    itself where none would be left.
    """
    corners = mesh.positions[mesh.triangles].reshape(-1, 3)
    low, high = corners.min(0).astype(np.float64), corners.max(0).astype(np.float64)
    edge = (high - low).max() / cells
    if not edge > 0:
        return mesh
    cell = ((mesh.positions.astype(np.float64) - low) / edge).clip(0, cells).astype(np.int64)
    number = (cell[:, 0] * (cells + 1) + cell[:, 1]) * (cells + 1) + cell[:, 2]
    _, cluster = np.unique(number, return_inverse=True)
    count = np.bincount(cluster)
    means = np.stack([np.bincount(cluster, mesh.positions[:, axis]) / count for axis in range(3)], 1)
    triangles = np.sort(cluster[mesh.triangles], 1)
    kept = (triangles[:, 0] < triangles[:, 1]) & (triangles[:, 1] < triangles[:, 2])
    if not kept.any():
        return mesh
    triangles = np.unique(triangles[kept], axis=0).astype(np.int32)
    return Mesh(mesh.name, np.ascontiguousarray(means, np.float32), np.ascontiguousarray(triangles))
