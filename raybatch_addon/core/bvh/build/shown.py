"""The trees of a scene in which other things are shown than in the frame before: those over what stayed are kept."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping

import numpy as np
import warp as wp

from ...scene.flatten import FlatGeometry
from ...scene.geometry import Geometry
from .entries import entries_of
from .mesh_tree import MeshTrees, mesh_parts
from .scene_tree import BuiltTree, assemble
from .segments import place_primitives


def follow_shown(
    built: BuiltTree,
    flat: FlatGeometry,
    geometry: Geometry,
    visibility: np.ndarray,
    kept: Mapping[int, int],
    changed: Collection[int],
    moved: Collection[int],
    device: wp.Device,
) -> None:
    """Make `built` the tree of a frame in which nothing moves. Mesh trees that are kept have the boxes that they had,
    with room for what left its place empty, or are refitted; all others are built, and those that became too bad.
    `built` cannot be used if this raises.

    Args:
        flat, geometry: the frame, on the host and on the device.
        visibility: `Visibility` bits of each instance, int, shape [instance_count].
        kept: by index in `mesh_parts` the mesh tree that is over the same triangles.
        changed: those of them in which triangles left their places, or came back.
        moved: those of them in which some are elsewhere.
    """
    start = time.perf_counter()
    trees, meshes, parts = MeshTrees(flat, geometry, device, built.layout, built.splits_moving), [], mesh_parts(flat)
    new, before = 0, built.meshes
    for i, part in enumerate(parts):
        mesh = built.meshes[kept[i]] if i in kept else None
        if mesh is not None:
            mesh.part = part
            if i in changed:
                mesh.whole = None
                place_primitives(mesh.triangles, built.layout, geometry.positions, geometry.triangles[part.span])
            if i in moved and not trees.refit(mesh):
                mesh = None
        new += mesh is None
        meshes.append(mesh or trees.build(part))
    built.meshes = meshes
    stay = len(meshes) == len(before) and all(a is b for a, b in zip(meshes, before, strict=True))
    assemble(built, trees, flat, entries_of(flat, visibility), device, fresh=not stay)
    built.note(new, len(moved), start)
