"""The reference tree: Warp's own `wp.Mesh` under a `wp.Bvh` of instances.

The tracer that tests and benchmarks measure others against. Its triangle test is watertight (Woop, Benthin and
Wald 2013, as implemented by Warp). Of hits at the same distance the lower instance wins; within one mesh it is the one
that Warp visits first, which depends on the tree but never on the schedule.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp

from ...scene.flatten import FlatGeometry
from ...scene.geometry import mat34, transform_point, transform_vector
from .identify import merged_name


@wp.struct
class ReferenceTree:
    """Device side of the tree. An *entry* is one mesh tree in its place."""

    entry_tree: wp.uint64  # `wp.Bvh` over the world boxes of the entries; 0 when there is one entry only
    entry_mesh: wp.array(dtype=wp.uint64)  # `wp.Mesh` of each entry
    entry_instance: wp.array(dtype=int)  # instance id, or -1: baked instances that share one tree
    entry_visibility: wp.array(dtype=int)
    entry_from_world: wp.array(dtype=mat34)
    merged_first: wp.array(dtype=int)  # first of an entry's baked instances in the next two, int32, shape [entries + 1]
    merged_instance: wp.array(dtype=int)
    merged_triangle_first: wp.array(dtype=int)


@wp.struct
class Hit:
    """A closest hit; `instance` is -1 when there is none."""

    t: float
    instance: int
    primitive: int
    uv: wp.vec2


class ReferenceQueries(NamedTuple):
    """Warp functions of one specialisation."""

    closest: wp.Function  # (tree, origin, direction, t_max, visibility) -> Hit
    occluded: wp.Function  # (tree, origin, direction, t_max, visibility) -> bool


@dataclass
class BuiltReference:
    """The tree with everything that must outlive it."""

    tree: ReferenceTree
    meshes: list[wp.Mesh]
    entry_tree: wp.Bvh | None
    keep: list[wp.array]
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]


@wp.func
def merged_hit(tree: ReferenceTree, entry: int, face: int) -> wp.vec2i:
    """`merged_name` in this tree."""
    return merged_name(tree.merged_first, tree.merged_instance, tree.merged_triangle_first, entry, face)


@functools.cache
def make_reference(instancing: bool) -> ReferenceQueries:
    """Queries for one world-space tree, or for instances."""

    if not instancing:

        @wp.func
        def closest(tree: ReferenceTree, origin: wp.vec3, direction: wp.vec3, t_max: float, visibility: int) -> Hit:
            hit = Hit()
            hit.instance = -1
            query = wp.mesh_query_ray(tree.entry_mesh[0], origin, direction, t_max)
            if query.result:
                found = merged_hit(tree, 0, query.face)
                hit.t = query.t
                hit.instance = found[0]
                hit.primitive = found[1]
                hit.uv = wp.vec2(query.v, 1.0 - query.u - query.v)
            return hit

        @wp.func
        def occluded(tree: ReferenceTree, origin: wp.vec3, direction: wp.vec3, t_max: float, visibility: int) -> bool:
            return wp.mesh_query_ray_anyhit(tree.entry_mesh[0], origin, direction, t_max)

        return ReferenceQueries(closest, occluded)

    @wp.func
    def closest_of_entries(
        tree: ReferenceTree, origin: wp.vec3, direction: wp.vec3, t_max: float, visibility: int
    ) -> Hit:
        hit = Hit()
        hit.instance = -1
        hit.t = t_max
        entry = int(0)
        candidates = wp.bvh_query_ray(tree.entry_tree, origin, direction)
        while wp.bvh_query_next(candidates, entry, hit.t):
            if (tree.entry_visibility[entry] & visibility) != 0:
                matrix = tree.entry_from_world[entry]
                # a hit at exactly the best distance must still be seen: the lower instance wins
                limit = hit.t
                if hit.instance >= 0:
                    limit = hit.t * wp.static(1.0 + 2.0**-23)
                query = wp.mesh_query_ray(
                    tree.entry_mesh[entry], transform_point(matrix, origin), transform_vector(matrix, direction), limit
                )
                if query.result and query.t <= hit.t:
                    instance = tree.entry_instance[entry]
                    primitive = query.face
                    if instance < 0:
                        found = merged_hit(tree, entry, query.face)
                        instance = found[0]
                        primitive = found[1]
                    if query.t < hit.t or hit.instance < 0 or instance < hit.instance:
                        hit.t = query.t
                        hit.instance = instance
                        hit.primitive = primitive
                        hit.uv = wp.vec2(query.v, 1.0 - query.u - query.v)
        return hit

    @wp.func
    def occluded_by_entries(
        tree: ReferenceTree, origin: wp.vec3, direction: wp.vec3, t_max: float, visibility: int
    ) -> bool:
        blocked = bool(False)
        entry = int(0)
        candidates = wp.bvh_query_ray(tree.entry_tree, origin, direction)
        while wp.bvh_query_next(candidates, entry, t_max):
            if (tree.entry_visibility[entry] & visibility) != 0:
                matrix = tree.entry_from_world[entry]
                if wp.mesh_query_ray_anyhit(
                    tree.entry_mesh[entry], transform_point(matrix, origin), transform_vector(matrix, direction), t_max
                ):
                    blocked = True
                    break
        return blocked

    return ReferenceQueries(closest_of_entries, occluded_by_entries)


def build_reference(
    flat: FlatGeometry, instance_visibility: np.ndarray, instancing: bool, device: wp.Device
) -> BuiltReference:
    """Build the trees of `flat` on `device`; `instancing` as the queries that will ask them."""
    positions = wp.array(flat.positions, dtype=wp.vec3, device=device)
    meshes: list[wp.Mesh] = []
    keep: list[wp.array] = [positions]
    boxes: list[np.ndarray] = []

    def mesh_tree(first: int, count: int) -> wp.Mesh:
        # each tree reads its own slice; vertices are shared by all of them
        indices = wp.array(flat.triangles[first : first + count].reshape(-1), dtype=int, device=device)
        keep.append(indices)
        # this builder's trees are the fastest to trace of those that Warp builds on CUDA
        fastest = {"bvh_constructor": "cubql", "bvh_leaf_size": 1} if device.is_cuda else {}
        meshes.append(wp.Mesh(points=positions, indices=indices, **fastest))
        return meshes[-1]

    entry_mesh, entry_instance, entry_visibility, entry_from_world = [], [], [], []
    merged_first, merged_instance, merged_triangle_first = [0], [], []
    for group in flat.merged:
        if group.triangle_count == 0:
            continue
        entry_mesh.append(mesh_tree(group.triangle_first, group.triangle_count).id)
        entry_instance.append(-1)
        entry_visibility.append(group.visibility)
        entry_from_world.append(np.eye(3, 4))
        merged_instance += group.instance.tolist()
        merged_triangle_first += group.instance_triangle_first.tolist()
        merged_first.append(len(merged_instance))
        corners = flat.positions[flat.triangles[group.triangle_first : group.triangle_first + group.triangle_count]]
        boxes.append(_padded(corners.min((0, 1)), corners.max((0, 1))))

    trees: dict[int, tuple[wp.Mesh, np.ndarray]] = {}
    for i in flat.shared.tolist():
        mesh = int(flat.instance_mesh[i])
        first, end = flat.mesh_triangle_first[mesh : mesh + 2].tolist()
        if mesh not in trees:
            corners = flat.positions[flat.triangles[first:end]]
            trees[mesh] = (mesh_tree(first, end - first), np.stack([corners.min((0, 1)), corners.max((0, 1))]))
        tree, box = trees[mesh]
        matrix = flat.instance_transform[i].astype(np.float64)
        inverse = np.linalg.inv(matrix[:, :3])
        entry_mesh.append(tree.id)
        entry_instance.append(i)
        entry_visibility.append(int(instance_visibility[i]))
        entry_from_world.append(np.column_stack([inverse, -inverse @ matrix[:, 3]]))
        merged_first.append(len(merged_instance))
        boxes.append(_padded(*_transformed_box(matrix, box)))

    def upload(values, dtype) -> wp.array:
        return wp.array(np.array(values), dtype=dtype, device=device)

    tree = ReferenceTree()
    tree.entry_mesh = upload(np.array(entry_mesh, np.uint64), wp.uint64)
    tree.entry_instance = upload(np.array(entry_instance, np.int32), int)
    tree.entry_visibility = upload(np.array(entry_visibility, np.int32), int)
    tree.entry_from_world = upload(np.array(entry_from_world, np.float32).reshape(-1, 3, 4), mat34)
    tree.merged_first = upload(np.array(merged_first, np.int32), int)
    tree.merged_instance = upload(np.array(merged_instance, np.int32), int)
    tree.merged_triangle_first = upload(np.array(merged_triangle_first, np.int32), int)
    entry_tree = None
    if instancing:
        low, high = (np.array(corner, np.float32).reshape(-1, 3) for corner in zip(*boxes))
        entry_tree = wp.Bvh(upload(low, wp.vec3), upload(high, wp.vec3))
        tree.entry_tree = entry_tree.id
    low, high = (np.array(corners) for corners in zip(*boxes))
    return BuiltReference(tree, meshes, entry_tree, keep, np.stack([low.min(0), high.max(0)]))


def _transformed_box(matrix: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World box of an object-space box (Arvo 1990)."""
    centre, half = box.astype(np.float64).mean(0), (box[1].astype(np.float64) - box[0]) / 2
    middle = matrix[:, :3] @ centre + matrix[:, 3]
    reach = np.abs(matrix[:, :3]) @ half
    return middle - reach, middle + reach


def _padded(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # A ray is carried to object space by nine products and sums a coordinate (relative error below 16 roundings),
    # so a hit may lie this far outside the box that was computed here
    margin = 16 * np.finfo(np.float32).eps * np.maximum(np.abs(low), np.abs(high)).max()
    return low - margin, high + margin
