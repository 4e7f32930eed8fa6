"""The trees of a whole scene, on the device that will trace them.

On the CPU: binned SAH and the layout BOXES. On CUDA: clusters in Morton order, built on the device, and the layout
QUANTISED; meshes with spatial splits are built by the CPU and uploaded.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from ..scene.flatten import FlatGeometry
from ..scene.geometry import Geometry, mat34
from .binary import BuildOptions
from .build_cuda import DeviceTop, build_mesh, build_top
from .build_sah import build_binary, build_binary_from_boxes
from .collapse import collapse_entries, collapse_mesh
from .encode import as_vectors
from .margin import SLAB_MARGIN
from .node import TRIANGLES_MAX_QUANTISED, Layout, WideTop, aligned_empty
from .tree import Tree

_VECTOR = 16  # bytes of an element of the device's arrays


@dataclass
class MeshTree:
    """The blocks of one mesh: host arrays, or device arrays of vec4."""

    nodes: Any
    triangles: Any
    centre: np.ndarray  # float32 [3]
    box: np.ndarray  # float32 [2, 3]
    node_count: int
    triangle_places: int  # triangles listed, or groups of them
    depth: int
    sah: float  # expected node steps of a ray that meets the root's box


@dataclass
class BuiltTree:
    """A scene's trees with everything that must outlive them."""

    tree: Tree
    layout: Layout
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    statistics: dict[str, Any]
    keep: list[Any] = field(default_factory=list, repr=False)


def build_scene_tree(
    flat: FlatGeometry, geometry: Geometry, visibility: np.ndarray, instancing: bool, device: wp.Device, layout: Layout,
    spatial_splits: bool = False, on_device: bool | None = None,
) -> BuiltTree:  # fmt: skip
    """Build all trees of `flat`, whose arrays are on `device` as `geometry`.

    Args:
        visibility: `Visibility` bits of each instance, int, shape [instance_count].
        layout: BOXES for the traversal of CPUs, QUANTISED for that of GPUs.
        instancing: as the kernels that will ask the tree (`SceneFeatures.instancing`).
        spatial_splits: split triangles where that makes a better tree, which takes longer to build.
        on_device: build mesh trees (QUANTISED, without splits) where they will be traced, also where that is the CPU; default: on CUDA.

    Raises `OutOfMemoryError` where the trees do not fit.
    """
    start = time.perf_counter()
    if on_device is None:
        on_device = device.is_cuda and not spatial_splits
    maker = _MeshTrees(flat, geometry, device, layout, spatial_splits, on_device)
    entries = _Entries()
    for group in flat.merged:
        if group.triangle_count:
            entries.add_merged(maker.tree(group.triangle_first, group.triangle_count), group)
    made: dict[int, int] = {}
    for i in flat.shared.tolist():
        mesh = int(flat.instance_mesh[i])
        if mesh not in made:
            first, end = flat.mesh_triangle_first[mesh : mesh + 2].tolist()
            made[mesh] = maker.tree(first, end - first)
        entries.add_instance(made[mesh], i, int(visibility[i]), flat.instance_transform[i])
    return _assembled(maker, entries, instancing, device, start)


def layout_for(device: wp.Device) -> Layout:
    """The layout whose traversal is fastest on `device`."""
    return Layout.QUANTISED if device.is_cuda else Layout.BOXES


class _MeshTrees:
    """Builds mesh trees, and says where each one's blocks will lie."""

    def __init__(
        self, flat: FlatGeometry, geometry: Geometry, device: wp.Device, layout: Layout, spatial_splits: bool, on_device: bool
    ):
        self._flat, self._geometry, self.layout = flat, geometry, layout
        self._make = self._on_device if on_device else self._on_host
        if layout is Layout.QUANTISED:
            self._options = BuildOptions(leaf_group=1, leaf_max=TRIANGLES_MAX_QUANTISED, spatial_splits=spatial_splits)
        else:
            self._options = BuildOptions(spatial_splits=spatial_splits)
        self.trees: list[MeshTree] = []

    def tree(self, first: int, count: int) -> int:
        """The number of the tree over triangles first..first+count."""
        self.trees.append(self._make(first, count))
        return len(self.trees) - 1

    def _on_host(self, first: int, count: int) -> MeshTree:
        positions, triangles = self._flat.positions, self._flat.triangles[first : first + count]
        binary = build_binary(positions, triangles, self._options)
        wide = collapse_mesh(binary, positions, triangles, self.layout)
        return MeshTree(
            wide.nodes, wide.triangles, wide.centre, wide.box, wide.node_count, len(wide.triangles), wide.depth, wide.sah
        )  # fmt: skip

    def _on_device(self, first: int, count: int) -> MeshTree:
        made = build_mesh(self._geometry.positions, self._geometry.triangles, first, count)
        return MeshTree(made.nodes, made.triangles, made.centre, made.box, made.node_count, count, made.depth, made.sah)


class _Entries:
    """Mesh trees in their places; the fields are columns."""

    def __init__(self):
        self.mesh: list[int] = []
        self.instance: list[int] = []
        self.visibility: list[int] = []
        self.to_world: list[np.ndarray] = []
        self.merged_first = [0]
        self.merged_instance: list[int] = []
        self.merged_triangle_first: list[int] = []

    def add_merged(self, mesh: int, group) -> None:
        """Baked instances that share one tree in world space."""
        self.merged_instance += group.instance.tolist()
        self.merged_triangle_first += group.instance_triangle_first.tolist()
        self._add(mesh, -1, group.visibility, np.eye(3, 4))

    def add_instance(self, mesh: int, instance: int, visibility: int, transform: np.ndarray) -> None:
        """An instance of a shared mesh."""
        self._add(mesh, instance, visibility, transform.astype(np.float64))

    def _add(self, mesh: int, instance: int, visibility: int, to_world: np.ndarray) -> None:
        self.mesh.append(mesh)
        self.instance.append(instance)
        self.visibility.append(visibility)
        self.to_world.append(to_world)
        self.merged_first.append(len(self.merged_instance))


def _assembled(maker: _MeshTrees, entries: _Entries, instancing: bool, device: wp.Device, start: float) -> BuiltTree:
    trees, layout = maker.trees, maker.layout
    to_world = np.array(entries.to_world, np.float64).reshape(-1, 3, 4)
    from_world = inverse_transforms(to_world)
    tree = Tree()
    boxes = [_transformed_box(matrix, trees[i].box.astype(np.float64)) for i, matrix in zip(entries.mesh, to_world)]
    top = None
    if instancing:
        top, tree.top_margin = _top_level(boxes, to_world, from_world, layout, device)
        tree.top_centre = wp.vec3(*top.centre.tolist())
    node_first = np.cumsum([0, *(mesh.node_count for mesh in trees)])
    triangle_first = np.cumsum([0, *(mesh.triangle_places for mesh in trees)])
    tree.top_node = int(node_first[-1])
    blocks = [mesh.nodes for mesh in trees] + ([top.nodes] if top else [])
    tree.nodes, kept = _joined(blocks, device)
    tree.triangles, kept_triangles = _joined([mesh.triangles for mesh in trees], device)

    def upload(values, dtype, shape=(-1,)) -> wp.array:
        host = np.array(values, np.float32 if dtype in (wp.vec3, mat34) else np.int32).reshape(shape)
        return wp.array(host, dtype=dtype, device=device)

    tree.entry_node = upload(node_first[entries.mesh], int)
    tree.entry_triangle = upload(triangle_first[entries.mesh], int)
    tree.entry_centre = upload([trees[i].centre for i in entries.mesh], wp.vec3, (-1, 3))
    tree.entry_from_world = upload(from_world, mat34, (-1, 3, 4))
    tree.entry_instance = upload(entries.instance, int)
    tree.entry_visibility = upload(entries.visibility, int)
    tree.merged_first = upload(entries.merged_first, int)
    tree.merged_instance = upload(entries.merged_instance, int)
    tree.merged_triangle_first = upload(entries.merged_triangle_first, int)
    order = top.order if top else []
    tree.top_entry = order if isinstance(order, wp.array) else upload(order, int)
    tree.entry_count = len(entries.mesh)
    wp.synchronize_device(device)
    statistics = {
        "layout": layout.value,
        "trees": len(trees),
        "entries": len(entries.mesh),
        "nodes": int(node_first[-1]) + (top.node_count if top else 0),
        "bytes": (tree.nodes.size + tree.triangles.size) * _VECTOR,
        "depth": max((mesh.depth for mesh in trees), default=0),
        "sah": round(float(max((mesh.sah for mesh in trees), default=0.0)), 4),
        "seconds": round(time.perf_counter() - start, 6),
    }
    box = np.array(boxes)
    return BuiltTree(tree, layout, np.stack([box[:, 0].min(0), box[:, 1].max(0)]), statistics, [kept, kept_triangles])


def _joined(blocks: list[Any], device: wp.Device) -> tuple[wp.array, list[Any]]:
    """All blocks one after another on `device`, and what must be kept for that."""
    if len(blocks) == 1:
        block = blocks[0]
        if not isinstance(block, np.ndarray):
            return block, []
        shared = as_vectors(block)
        return (wp.clone(shared, device=device), []) if device.is_cuda else (shared, [block])
    sizes = [block.nbytes // _VECTOR if isinstance(block, np.ndarray) else block.size for block in blocks]
    if not device.is_cuda:
        joined = aligned_empty((sum(sizes), 4), np.float32)
        place = 0
        for block, size in zip(blocks, sizes):
            words = block.view(np.float32) if isinstance(block, np.ndarray) else block.numpy()
            joined[place : place + size] = words.reshape(-1, 4)
            place += size
        return as_vectors(joined), [joined]
    joined = wp.empty(sum(sizes), dtype=wp.vec4, device=device)
    place = 0
    for block, size in zip(blocks, sizes):
        wp.copy(joined, as_vectors(block) if isinstance(block, np.ndarray) else block, dest_offset=place, count=size)
        place += size
    return joined, []


def _top_level(
    boxes: list[np.ndarray], to_world: np.ndarray, from_world: np.ndarray, layout: Layout, device: wp.Device
) -> tuple[WideTop | DeviceTop, float]:
    """The tree over the entries, whose world boxes are `boxes`, and the margin of rays against it.

    A ray that is carried to object space by nine products and sums of float32 meets there what it would meet, carried exactly,
    within 8u |A| (|M| |o| + |m|), coordinate by coordinate, where x -> M x + m is the entry's map from the world and A the inverse of M;
    the rounding of M and m adds as much again, the distance along the ray likewise. With k the largest row of |A| |M| this is below
    `SLAB_MARGIN` k (|o| + reach), reach being the largest coordinate of the entry's box or of its origin.
    """
    grown = []
    condition = (np.abs(to_world[:, :, :3]) @ np.abs(from_world[:, :, :3])).sum(2).max(1)
    centre = np.abs(boxes).max()  # no coordinate of the top level's centre is larger
    for box, matrix, k in zip(boxes, to_world, condition):
        reach = max(np.abs(box).max(), np.abs(matrix[:, 3]).max()) + centre
        margin = 2 * SLAB_MARGIN * k * reach
        grown.append((box[0] - margin, box[1] + margin))
    low, high = (np.array(corner, np.float32).reshape(-1, 3) for corner in zip(*grown))
    low, high = np.nextafter(low, np.float32(-np.inf)), np.nextafter(high, np.float32(np.inf))
    margin = float(2 * SLAB_MARGIN * condition.max())
    if device.is_cuda:
        return build_top(wp.array(low, dtype=wp.vec3, device=device), wp.array(high, dtype=wp.vec3, device=device)), margin
    return collapse_entries(build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=1)), layout), margin


def inverse_transforms(matrices: np.ndarray) -> np.ndarray:
    """Inverses of affine maps, float64, shape [n, 3, 4]."""
    inverse = np.linalg.inv(matrices[:, :, :3])
    return np.concatenate([inverse, -inverse @ matrices[:, :, 3:]], axis=2)


def _transformed_box(matrix: np.ndarray, box: np.ndarray) -> np.ndarray:
    """World box of an object-space box (Arvo 1990)."""
    centre, half = box.mean(0), (box[1] - box[0]) / 2
    middle = matrix[:, :3] @ centre + matrix[:, 3]
    reach = np.abs(matrix[:, :3]) @ half
    return np.stack([middle - reach, middle + reach])
