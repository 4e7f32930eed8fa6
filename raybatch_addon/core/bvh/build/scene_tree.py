"""The trees of a whole scene, on the device that will trace them, and how they follow from frame to frame."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from ...device.devices import free_memory
from ...errors import OutOfMemoryError, SceneError
from ...scene.flatten import FlatGeometry
from ...scene.geometry import Geometry, mat34
from ..node import VECTOR_BYTES, Layout, aligned_empty
from ..tree import Tree
from .collapse import collapse_boxes_kernel, fill_boxes_kernel
from .cpu.stages import build_kernel
from .cuda.build import DEVICE_BUILD_KERNELS
from .encode import as_vectors, place_groups_kernel
from .entries import Entries, build_top_level, entries_of
from .mesh_tree import MeshTree, MeshTrees, mesh_parts

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
    top_room: int = 0  # vectors behind the mesh trees' nodes, for the nodes of the top level
    statistics: dict[str, Any] = field(default_factory=dict)

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

    Raises `OutOfMemoryError` where the trees do not fit.
    """
    start = time.perf_counter()
    trees = MeshTrees(flat, geometry, device, layout, spatial_splits, on_device)
    built = BuiltTree(
        tree=Tree(),
        layout=layout,
        instancing=instancing,
        splits_moving=splits_moving,
        splits_planned=spatial_splits,
        meshes=[trees.build(part) for part in mesh_parts(flat)],
    )
    _assemble(built, flat, entries_of(flat, visibility), device, fresh=True)
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
    _assemble(built, flat, entries_of(flat, visibility), device, fresh=bool(worse))
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
    _assemble(built, flat, entries_of(flat, visibility), device, fresh=False)
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


def _assemble(built: BuiltTree, flat: FlatGeometry, entries: Entries, device: wp.Device, fresh: bool) -> None:
    """Put mesh trees, top level and entries together; with `fresh` mesh trees, all of them move to new arrays."""
    meshes, tree = built.meshes, Tree()
    boxes = entries.boxes(np.array([mesh.box for mesh in meshes]))
    top = build_top_level(entries, boxes, built.layout, device) if built.instancing else None
    top_size = top.nodes.size if top else 0
    vectors_per_node, vectors_per_block = built.layout.node_words // 4, built.layout.triangle_words // 4
    if fresh or top_size > built.top_room:
        built.top_room = top_size + int(top_size * _TOP_ROOM_SHARE) + _TOP_ROOM_NODES * vectors_per_node if top else 0
        tree.nodes, parts = _joined([mesh.nodes for mesh in meshes], built.top_room, device)
        for mesh, part in zip(meshes, parts, strict=True):
            mesh.nodes = part
    else:
        tree.nodes = built.tree.nodes
    if fresh:  # after the nodes, whose old arrays are free by now
        tree.triangles, parts = _joined([mesh.triangles for mesh in meshes], 0, device)
        for mesh, part in zip(meshes, parts, strict=True):
            mesh.triangles = part
    else:
        tree.triangles = built.tree.triangles
    node_first = np.cumsum([0, *(mesh.nodes.size for mesh in meshes)])
    triangle_first = np.cumsum([0, *(mesh.triangles.size for mesh in meshes)])

    def upload(values: np.ndarray, dtype: type) -> wp.array:
        host = np.ascontiguousarray(values, np.float32 if dtype in (wp.vec3, mat34) else np.int32)
        return wp.array(host, dtype=dtype, device=device)

    tree.entry_node = upload(node_first[entries.mesh] // vectors_per_node, int)
    tree.entry_triangle = upload(triangle_first[entries.mesh] // vectors_per_block, int)
    tree.entry_centre = upload(np.array([mesh.centre for mesh in meshes])[entries.mesh], wp.vec3)
    tree.entry_from_world = upload(entries.from_world, mat34)
    tree.entry_instance = upload(entries.instance, int)
    tree.entry_visibility = upload(entries.visibility, int)
    tree.merged_first = upload(entries.merged_first, int)
    tree.merged_instance = upload(entries.merged_instance, int)
    tree.merged_triangle_first = upload(entries.merged_triangle_first, int)
    if flat.motion:
        steps = np.array([mesh.step_units for mesh in meshes])[entries.mesh]
        tree.entry_motion, tree.entry_deform = upload(entries.motion, int), upload(steps, int)
        tree.motion_keys = wp.array(entries.keys.reshape(-1), dtype=float, device=device)
        tree.motion_steps = entries.keys.shape[1]
        tree.deform_steps = flat.motion.vertex_steps
    tree.entry_count = len(entries.mesh)
    tree.top_node = int(node_first[-1]) // vectors_per_node
    tree.top_entry = top.order if top else wp.empty(0, dtype=int, device=device)
    if top:
        wp.copy(tree.nodes, top.nodes, dest_offset=int(node_first[-1]), count=top_size)
        tree.top_centre, tree.top_margin = wp.vec3(*top.centre.tolist()), top.margin
    wp.synchronize_device(device)
    built.tree = tree
    built.box = np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)])
    built.statistics = _description(built, top_size // vectors_per_node)


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


def _description(built: BuiltTree, top_count: int) -> dict[str, Any]:
    """Figures of the trees for statistics; `top_count` nodes are the top level's."""
    meshes, tree = built.meshes, built.tree
    costly = max(meshes, key=lambda mesh: mesh.sah)
    return {
        "layout": built.layout.value,
        "trees": len(meshes),
        "entries": tree.entry_count,
        "triangles": sum(mesh.part.triangle_count for mesh in meshes),
        "nodes": sum(mesh.node_count for mesh in meshes) + top_count,
        "bytes": (tree.nodes.size + tree.triangles.size) * VECTOR_BYTES,
        "depth": max(mesh.depth for mesh in meshes),
        "sah": round(costly.sah, 4),
        "sah_built": round(costly.sah_built, 4),
    }
