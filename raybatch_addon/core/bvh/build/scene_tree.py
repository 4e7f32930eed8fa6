"""The trees of a whole scene, on the device that will trace them, and how they follow from frame to frame."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from ...device.devices import free_memory
from ...errors import OutOfMemoryError, SceneError
from ...kept_arrays import KeptArrays
from ...scene.flatten import FlatGeometry
from ...scene.geometry import Geometry, mat34
from ..node import VECTOR_BYTES, Layout, aligned_empty
from ..tree import Tree
from .collapse import collapse_boxes_kernel, fill_boxes_kernel
from .cpu.stages import build_kernel
from .cuda.build import DEVICE_BUILD_KERNELS
from .encode import as_vectors, place_groups_kernel
from .entries import Entries, entries_of
from .in_common import TreesInCommon
from .mesh_tree import MeshTree, MeshTrees, mesh_parts
from .top_level import Listed, OverTime, build_top_level

_VECTORS_MAX = 2**31 - 1  # elements of an array
# The top level has room for more nodes than it has, a share of them and a few: another frame's may need them
_TOP_ROOM_SHARE, _TOP_ROOM_NODES = 0.25, 4


@dataclass(kw_only=True)
class BuiltTree:
    """A scene's trees with everything that must outlive them."""

    tree: Tree
    layout: Layout
    instancing: bool
    splits_moving: bool  # whether triangles are split in trees that are built anew because vertices moved
    splits_planned: bool  # whether it was built for a render that splits triangles; those that moved since are whole
    meshes: list[MeshTree] = field(repr=False)  # their blocks are parts of the tree's arrays
    box: np.ndarray | None = None  # two corners that hold all surfaces [m], float64, shape [2, 3]
    range_count: int | None = None  # as for `build_scene_tree`, and so is the next
    mesh_ranges: bool = True
    entry_mesh: np.ndarray | None = field(default=None, repr=False)  # by entry of the tree, index in `meshes`
    # first nodes of the top levels of all ranges of time among these, then their count
    top_first: list[int] = field(default_factory=lambda: [0])
    top_room: int = 0  # vectors behind the mesh trees' nodes, for the nodes of the top level
    statistics: dict[str, Any] = field(default_factory=dict)
    arrays: KeptArrays = field(default_factory=KeptArrays, repr=False)  # those of entries

    @property
    def whole_count(self) -> int:
        """Mesh trees that split no triangles: none were wanted, or their vertices moved."""
        return sum(not mesh.splits for mesh in self.meshes)

    def note(self, built_count: int, refitted_count: int, start: float | None = None) -> None:
        """Put into the statistics what was done for the frame since `start` [s, `time.perf_counter`]; None: nothing
        was.
        """
        seconds = 0.0 if start is None else round(time.perf_counter() - start, 6)
        self.statistics = {**self.statistics, "built": built_count, "refitted": refitted_count, "seconds": seconds}


def build_scene_tree(
    flat: FlatGeometry,
    geometry: Geometry,
    visibility: np.ndarray,
    instancing: bool,
    device: wp.Device,
    layout: Layout,
    spatial_splits: bool = False,
    splits_moving: bool = False,
    on_device: bool | None = None,
    range_count: int | None = None,
    mesh_ranges: bool = True,
    in_common: TreesInCommon | None = None,
) -> BuiltTree:
    """Build all trees of `flat`, whose arrays are on `device` as `geometry`.

    Args:
        visibility: `Visibility` bits of each instance, int, shape [instance_count].
        layout: BOXES for the traversal of CPUs, QUANTISED for that of GPUs.
        instancing: as the kernels that will ask the tree (`SceneFeatures.instancing`).
        spatial_splits: split triangles where that makes a better tree, which takes longer to build, and cannot be
            refitted well.
        splits_moving: do so too for trees that are built anew because their vertices moved.
        on_device: as for `MeshTrees`.
        range_count: ranges of time that have a top level each, a power of two, where something moves; None: as many as
            pay.
        mesh_ranges: have nodes for these ranges in trees of meshes whose vertices move; trees that are cut use none.
        in_common: where other devices get the same trees; None: there are none.

    Raises `OutOfMemoryError` where the trees do not fit.
    """
    start = time.perf_counter()
    trees, parts = MeshTrees(flat, geometry, device, layout, spatial_splits, on_device), mesh_parts(flat)

    def build() -> list[MeshTree]:
        return [trees.build(part) for part in parts]

    built = BuiltTree(
        tree=Tree(),
        layout=layout,
        instancing=instancing,
        splits_moving=splits_moving,
        splits_planned=spatial_splits,
        range_count=range_count,
        mesh_ranges=mesh_ranges,
        meshes=in_common.get(device, (layout, spatial_splits, on_device, *parts), build) if in_common else build(),
    )
    assemble(built, trees, flat, entries_of(flat, visibility), device, fresh=True)
    built.note(len(built.meshes), 0, start)
    return built


def refit_scene_tree(
    built: BuiltTree,
    flat: FlatGeometry,
    geometry: Geometry,
    visibility: np.ndarray,
    moved: Sequence[int],
    device: wp.Device,
    remade: Collection[int] = (),
) -> None:
    """Make `built` the tree of another frame, which has as many triangles, and the same instances and visibility; it
    cannot be used if this raises.

    Mesh trees whose vertices moved are refitted in place; those that became too bad, or are over another mesh, are
    built anew. The top level always is.

    Args:
        flat, geometry: the frame, on the host and on the device.
        visibility: as when the tree was built.
        moved: indices in `mesh_parts` of the meshes with new positions or triangles.
        remade: those of them that are other meshes than before.
    """
    start = time.perf_counter()
    trees = MeshTrees(flat, geometry, device, built.layout, built.splits_moving)
    worse = [i for i in moved if i in remade or not trees.refit(built.meshes[i])]
    parts = mesh_parts(flat)
    if worse:
        # before new ones are built: their memory is free where no other tree shares it
        built.tree = Tree()
        for i in worse:
            built.meshes[i] = None
        for i in worse:
            built.meshes[i] = trees.build(parts[i])
    assemble(built, trees, flat, entries_of(flat, visibility), device, fresh=bool(worse))
    built.note(len(worse), len(moved) - len(worse), start)


def refit_moved(
    built: BuiltTree,
    flat: FlatGeometry,
    geometry: Geometry,
    visibility: np.ndarray,
    moved: Mapping[int, Sequence[tuple[int, int]]],
    device: wp.Device,
) -> bool:
    """Refit like `refit_scene_tree`, for triangles alone, whose arrays `flat` may lack; False where a tree should be
    built anew, after which `built` is of no frame.

    `moved`: by mesh tree, first and count of the triangles that moved, among those of the scene.
    """
    start = time.perf_counter()
    trees = MeshTrees(flat, geometry, device, built.layout, built.splits_moving)
    for i, spans in moved.items():
        mesh = built.meshes[i]
        if not trees.refit(mesh, [(first - mesh.part.triangle_first, count) for first, count in spans]):
            return False
    assemble(built, trees, flat, entries_of(flat, visibility), device, fresh=False)
    built.note(0, len(moved), start)
    return True


def build_kernels(device: wp.Device) -> list[wp.Kernel]:
    """The kernels that build trees on `device`, for compiling ahead; builds load what they need by themselves."""
    if device.is_cuda:
        return list(DEVICE_BUILD_KERNELS)
    return [build_kernel, collapse_boxes_kernel, fill_boxes_kernel, place_groups_kernel]


def splits_triangles(spatial_splits: str, layout: Layout) -> bool:
    """Whether trees of this layout split triangles under the setting `spatial_splits`, where there is time for it."""
    return spatial_splits == "ON" or (spatial_splits == "AUTO" and layout is Layout.BOXES)


def layout_for(device: wp.Device) -> Layout:
    """The layout whose traversal is fastest on `device`."""
    return Layout.QUANTISED if device.is_cuda else Layout.BOXES


def assemble(
    built: BuiltTree, trees: MeshTrees, flat: FlatGeometry, entries: Entries, device: wp.Device, fresh: bool
) -> None:
    """Put mesh trees, top level and entries together; with `fresh` mesh trees, all of them move to new arrays."""
    meshes, tree = built.meshes, Tree()
    times = OverTime(
        entries,
        np.array([mesh.box for mesh in meshes]),
        np.array([mesh.sah for mesh in meshes]),
        np.array([mesh.step_units > 0 for mesh in meshes]),
    )
    count = _range_count(built, trees, times, device) if flat.motion and built.instancing else 1
    fresh = _keep_ranges(built, trees, times, count) or fresh
    mesh_ranges = np.array([mesh.ranges.count if mesh.ranges else 1 for mesh in meshes])
    # each entry once, but where meshes have ranges of time
    listed = Listed.of(entries.mesh, mesh_ranges, count) if mesh_ranges.max(initial=1) > 1 else None
    source = listed.source if listed else slice(None)
    built.entry_mesh = mesh_of = entries.mesh[source]
    top = None
    if built.instancing:
        boxes = [times.boxes(k, count) for k in range(count)]
        top = build_top_level(entries, boxes, built.layout, device, listed.of_range if listed else None)
    top_size = top.nodes.size if top else 0
    vectors_per_node, vectors_per_block = built.layout.node_words // 4, built.layout.triangle_words // 4
    if fresh or top_size > built.top_room:
        built.top_room = top_size + int(top_size * _TOP_ROOM_SHARE) + _TOP_ROOM_NODES * vectors_per_node if top else 0
        ranged = [mesh for mesh in meshes if mesh.ranges]
        blocks = [*(mesh.nodes for mesh in meshes), *(mesh.ranges.nodes for mesh in ranged)]
        tree.nodes, parts = _joined(blocks, built.top_room, device)
        for mesh, part in zip(meshes, parts):
            mesh.nodes = part
        for mesh, part in zip(ranged, parts[len(meshes) :], strict=True):
            mesh.ranges = replace(mesh.ranges, nodes=part)
    else:
        tree.nodes = built.tree.nodes
    if fresh:  # after the nodes, whose old arrays are free by now
        tree.triangles, parts = _joined([mesh.triangles for mesh in meshes], 0, device)
        for mesh, part in zip(meshes, parts, strict=True):
            mesh.triangles = part
    else:
        tree.triangles = built.tree.triangles
    entry_node, entry_centre, top_first = _nodes_of_entries(meshes, mesh_of, listed)
    triangle_first = np.cumsum([0, *(mesh.triangles.size for mesh in meshes)])

    def upload(name: str, values: np.ndarray, dtype: type = int) -> None:
        host = np.ascontiguousarray(values, np.int32 if dtype is int else np.float32)
        setattr(tree, name, built.arrays.upload(name, host, dtype, device))

    upload("entry_node", entry_node // vectors_per_node)
    upload("entry_triangle", triangle_first[mesh_of] // vectors_per_block)
    upload("entry_centre", entry_centre, wp.vec3)
    upload("entry_from_world", entries.from_world[source], mat34)
    upload("entry_instance", entries.instance[source])
    upload("entry_visibility", entries.visibility[source])
    # further ones are no groups: what deforms is not baked
    further = len(mesh_of) - len(entries)
    upload("merged_first", np.pad(entries.merged_first, (0, further), mode="edge") if further else entries.merged_first)
    upload("merged_instance", entries.merged_instance)
    upload("merged_triangle_first", entries.merged_triangle_first)
    if flat.motion:
        steps = np.array([mesh.step_units for mesh in meshes])[mesh_of]
        upload("entry_motion", entries.motion[source])
        upload("entry_deform", steps)
        upload("motion_keys", entries.keys.reshape(-1), float)
        tree.motion_steps = entries.keys.shape[1]
        tree.deform_steps = flat.motion.vertex_steps
    tree.entry_count = len(mesh_of)
    tree.top_node, tree.top_entry = top_first // vectors_per_node, wp.empty(0, dtype=int, device=device)
    if top:
        wp.copy(tree.nodes, top.nodes, dest_offset=top_first, count=top_size)
        top.place(tree, tree.top_node, device)
    wp.synchronize_device(device)
    built.tree = tree
    built.top_first = top.first if top else [0]
    built.box = np.stack([times.whole[:, 0].min(0), times.whole[:, 1].max(0)])
    built.statistics = _description(built, flat, top_size // vectors_per_node)


def _range_count(built: BuiltTree, trees: MeshTrees, times: OverTime, device: wp.Device) -> int:
    """Ranges of time that have a top level each; those of meshes are known then, where they may be used."""
    if built.range_count == 1 or not (built.range_count or times.may_pay()):
        return 1
    for i, mesh in enumerate(built.meshes):
        if mesh.step_units and built.mesh_ranges:
            mesh.over_time = mesh.over_time or trees.over_time(mesh)
            times.meshes[i] = mesh.over_time
    # building takes the nodes three times
    return built.range_count or times.count(free_memory(device) // 12)


def _keep_ranges(built: BuiltTree, trees: MeshTrees, times: OverTime, count: int) -> bool:
    """Give mesh trees nodes for their ranges below `count` top levels, and take all others away; whether that changes
    any.
    """
    chosen, changed = times.chosen(count), False
    for i, mesh in enumerate(built.meshes):
        ranges = chosen.get(i)
        mesh.over_time = [each.without_nodes() for each in mesh.over_time]
        if i in times.meshes:
            times.meshes[i] = mesh.over_time
        if (ranges.count if ranges else 1) == (mesh.ranges.count if mesh.ranges else 1):
            continue
        mesh.ranges = trees.in_ranges(mesh, ranges.count) if ranges and ranges.nodes is None else ranges
        changed = True
    return changed


def _nodes_of_entries(
    meshes: Sequence[MeshTree], mesh_of: np.ndarray, listed: Listed | None
) -> tuple[np.ndarray, np.ndarray, int]:
    """The first vector of the nodes of each entry, the centre of its boxes, and the first vector behind all these."""
    first = np.cumsum([0, *(mesh.nodes.size for mesh in meshes)])
    centre = np.array([mesh.centre for mesh in meshes])
    entry_first, entry_centre, end = first[mesh_of], centre[mesh_of], int(first[-1])
    for i, mesh in enumerate(meshes):
        if mesh.ranges and listed:
            those, range_of = mesh_of == i, listed.range
            entry_first[those] = end + range_of[those] * mesh.nodes.size
            entry_centre[those] = mesh.ranges.centre[range_of[those]]
            end += mesh.ranges.nodes.size
    return entry_first, entry_centre, end


def _joined(blocks: list[wp.array], room: int, device: wp.Device) -> tuple[wp.array, list[wp.array]]:
    """`blocks` one after another in one array of `device`, and where each of them lies there; `room` vectors are left
    at the end.
    """
    if len(blocks) == 1 and room == 0 and blocks[0].device == device:
        return blocks[0], blocks
    ends = np.cumsum([block.size for block in blocks]).tolist()
    size = ends[-1] + room
    if size > _VECTORS_MAX:
        raise SceneError(
            f"the trees of all meshes need {size * VECTOR_BYTES / 1e9:.1f} GB, and one array holds "
            f"{_VECTORS_MAX * VECTOR_BYTES / 1e9:.1f} GB; split the scene"
        )
    if size * VECTOR_BYTES > free_memory(device):
        raise OutOfMemoryError(
            f"the trees of all meshes need {size * VECTOR_BYTES / 1e9:.2f} GB more while they are put together, and "
            f"{device.name} has "
            f"{free_memory(device) / 1e9:.2f} GB free; close other programs, or render a smaller scene"
        )
    joined = (
        wp.empty(size, dtype=wp.vec4, device=device)
        if device.is_cuda
        else as_vectors(aligned_empty((size, 4), np.float32))
    )
    parts = [joined[end - block.size : end] for block, end in zip(blocks, ends, strict=True)]
    for block, part in zip(blocks, parts, strict=True):
        wp.copy(part, block)
    return joined, parts


def _description(built: BuiltTree, flat: FlatGeometry, top_count: int) -> dict[str, Any]:
    """Figures of the trees over `flat` for statistics; `top_count` nodes are the top level's."""
    meshes, tree, sizes = built.meshes, built.tree, np.diff(flat.mesh_triangle_first)
    baked = sum(int(sizes[flat.instance_mesh[group.instance]].sum()) for group in flat.merged)  # without empty places
    costly = max(meshes, key=lambda mesh: mesh.sah)
    return {
        "layout": built.layout.value,
        "trees": len(meshes),
        "entries": tree.entry_count,
        "triangles": baked + sum(mesh.part.triangle_count for mesh in meshes[len(flat.merged) :]),
        "nodes": sum(mesh.node_count * (1 + (mesh.ranges.count if mesh.ranges else 0)) for mesh in meshes) + top_count,
        "bytes": (tree.nodes.size + tree.triangles.size) * VECTOR_BYTES,
        "depth": max(mesh.depth for mesh in meshes),
        "sah": round(costly.sah, 4),
        "sah_built": round(costly.sah_built, 4),
        **({"time_ranges": tree.top_ranges} if tree.motion_steps else {}),
    }
