"""The trees of a whole scene in memory, cut into treelets: the resident nodes and triangles, the treelets' blocks,
their tables.

`Tree.nodes` holds the resident nodes of one mesh tree after another, then the top level's; `Tree.triangles` those
triangles that hang at opened nodes. All treelets of a mesh lie in two arrays, one of nodes and one of triangles;
treelets are numbered mesh by mesh, so that instances share them.

In the top level a leaf of a tree that was built on CUDA (`build_cuda.build_top`, whose leaves hold at most one) lists
exactly one entry. One that was built on the CPU lists up to 8 entries (BOXES) or 3 (QUANTISED): where boxes overlap so
much that apart they would cost more.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from ...device.devices import free_memory
from ...device.kernel import KERNEL_OPTIONS
from ...errors import OutOfMemoryError
from ...native.structs import to_numpy
from ..build.encode import as_vectors
from ..build.mesh_tree import MeshTree
from ..build.scene_tree import BuiltTree
from ..node import VECTOR_BYTES, Layout, aligned_empty
from ..tree import Tree, Treelets
from .cut import CutRule, cut_nodes
from .links import tree_levels


@wp.kernel(**KERNEL_OPTIONS)
def gather_kernel(
    source: wp.array(dtype=wp.vec4), order: wp.array(dtype=int), first: int, vectors: int, out: wp.array(dtype=wp.vec4)
):
    """Units of `vectors` elements: unit k of `out` is unit order[first + k] of `source` (one thread an element)."""
    i = wp.tid()
    unit = i // vectors
    out[i] = source[order[first + unit] * vectors + (i - unit * vectors)]


TREELET_KERNELS = (gather_kernel,)


@dataclass(kw_only=True)
class TreeletTree:
    """A scene's trees, cut, with everything that must outlive them. Bytes of a treelet are those of its root too."""

    tree: Tree
    treelets: Treelets
    layout: Layout
    instancing: bool
    treelet_count: int
    # levels of resident nodes on the longest way to a treelet's root, the top level's first; at least as many as a
    # trail has elements
    levels: int
    node_bytes: int  # all nodes, those of the top level too
    triangle_bytes: int  # all triangles
    box: np.ndarray | None  # as `BuiltTree.box`
    treelet_sizes: np.ndarray = field(repr=False)  # nodes of each treelet, its root among them, int64, shape [T]
    # triangles, or groups of them (BOXES), of all steps, int64, shape [T]
    treelet_units: np.ndarray = field(repr=False)
    mesh_node: np.ndarray = field(
        repr=False
    )  # first resident node of each mesh tree, then the top level's, int64, shape [m + 1]
    mesh_triangle: np.ndarray = field(repr=False)  # likewise of resident triangles or groups, then their count
    mesh_treelet: np.ndarray = field(repr=False)  # likewise of treelets, then their count
    blocks: list[wp.array] = field(repr=False)  # where the treelets lie
    # large treelet that each treelet is in, or -1, int64, shape [T]. In `Treelets.of_node` these are numbered behind
    # treelets
    treelet_large: np.ndarray = field(repr=False)
    large_count: int = 0
    statistics: dict[str, Any] = field(default_factory=dict)

    @property
    def bytes(self) -> int:
        """Memory of nodes, triangles and the tables of treelets."""
        tables = 4 * (self.treelets.of_node.size + self.treelets.root.size) + 16 * self.treelet_count
        return self.node_bytes + self.triangle_bytes + tables

    @property
    def treelet_bytes(self) -> np.ndarray:
        """Nodes and triangles of each treelet, int64, shape [T]."""
        return 4 * (self.layout.node_words * self.treelet_sizes + self.layout.triangle_words * self.treelet_units)

    @property
    def resident_bytes(self) -> int:
        """Nodes and triangles above the treelets, their roots among them."""
        return 4 * (
            self.layout.node_words * self.treelets.of_node.size
            + self.layout.triangle_words * int(self.mesh_triangle[-1])
        )


def cut_scene_tree(built: BuiltTree, rule: CutRule, device: wp.Device) -> TreeletTree:
    """Cut every mesh tree of `built`, which is on `device` and is left as it is, by `rule`.

    Nothing of `built` but small arrays of its entries is used later. A frame whose tree was refitted is cut again.
    Raises `OutOfMemoryError` where the result does not fit beside it.
    """
    layout, source = built.layout, built.tree
    needed, free = VECTOR_BYTES * (source.nodes.size + source.triangles.size), free_memory(device)
    if needed > free:
        raise OutOfMemoryError(
            f"cutting the trees into treelets needs {needed / 1e9:.2f} GB more, and {device.name} has {free / 1e9:.2f} "
            "GB free; render "
            "with batching OFF"
        )
    top = _top_level(built) if built.instancing else np.empty((0, layout.node_words), layout.node_type)
    top_levels = max((len(tree_levels(layout, top[first:])) for first in built.top_first[:-1]), default=0)
    parts = [_cut_mesh(layout, mesh, rule, device) for mesh in built.meshes]
    mesh_node = _ends([len(part.top_nodes) for part in parts])
    mesh_triangle = _ends([part.top_triangle_count for part in parts])
    mesh_treelet = _ends([len(part.root) for part in parts])

    # nodes of meshes for ranges of time stay behind: those around all of the time serve every entry
    tree = _placed(built, mesh_node, mesh_triangle, np.array([part.top_deform for part in parts], np.int32), device)
    tree.nodes = _upload_words(np.concatenate([*(part.top_nodes for part in parts), top]), device)
    tree.triangles = _empty_vectors(int(mesh_triangle[-1]) * layout.triangle_words // 4, device)
    for part, first in zip(parts, mesh_triangle.tolist()):
        count = part.top_triangle_count * layout.triangle_words // 4
        if count:
            wp.copy(tree.triangles, part.top_triangles, dest_offset=first * layout.triangle_words // 4, count=count)
    treelets = Treelets()
    of_node = [np.where(part.of_node < 0, -1, part.of_node + first) for part, first in zip(parts, mesh_treelet)]
    count, large_first = int(mesh_treelet[-1]), _ends([part.large_count for part in parts])
    of_node = [
        np.where(part.of_large < 0, of, part.of_large + count + first)
        for part, of, first in zip(parts, of_node, large_first)
    ]
    root = [part.root + first for part, first in zip(parts, mesh_node)]
    treelets.of_node = wp.array(
        np.concatenate([*of_node, np.full(len(top), -1)]).astype(np.int32), dtype=int, device=device
    )
    treelets.root = wp.array(np.concatenate(root).astype(np.int32), dtype=int, device=device)
    treelets.nodes = wp.array(np.concatenate([part.node_address for part in parts]), dtype=wp.uint64, device=device)
    treelets.triangles = wp.array(
        np.concatenate([part.triangle_address for part in parts]), dtype=wp.uint64, device=device
    )
    if source.motion_steps:
        treelets.deform = wp.array(
            np.concatenate([part.deform for part in parts]).astype(np.int32), dtype=int, device=device
        )
    wp.synchronize_device(device)
    made = TreeletTree(
        tree=tree,
        treelets=treelets,
        layout=layout,
        instancing=built.instancing,
        treelet_count=count,
        levels=top_levels + max(part.levels for part in parts),
        node_bytes=4 * layout.node_words * (len(top) + sum(mesh.node_count for mesh in built.meshes)),
        triangle_bytes=VECTOR_BYTES * sum(mesh.triangles.size for mesh in built.meshes),
        box=built.box,
        treelet_sizes=np.concatenate([part.sizes for part in parts]),
        treelet_units=np.concatenate([part.units for part in parts]),
        mesh_node=mesh_node,
        mesh_triangle=mesh_triangle,
        mesh_treelet=mesh_treelet,
        treelet_large=np.concatenate(
            [np.where(part.in_large < 0, -1, part.in_large + first) for part, first in zip(parts, large_first)]
        ),
        large_count=int(large_first[-1]),
        blocks=[block for part in parts for block in (part.nodes, part.triangles)],
    )
    made.statistics = _description(made)
    return made


def _top_level(built: BuiltTree) -> np.ndarray:
    """Words of the top level's nodes; it lies behind the mesh trees, with room behind it."""
    layout = built.layout
    behind = built.tree.nodes[built.tree.top_node * layout.node_words // 4 :]
    return _words(behind, layout.node_words, layout.node_type)[: built.top_first[-1]]


def _placed(
    built: BuiltTree, mesh_node: np.ndarray, mesh_triangle: np.ndarray, mesh_deform: np.ndarray, device: wp.Device
) -> Tree:
    """The entries of `built` with their first resident nodes and triangles, and the triangles of a step."""
    source, tree, mesh = built.tree, Tree(), built.entry_mesh
    tree.entry_node = wp.array(mesh_node[mesh].astype(np.int32), dtype=int, device=device)
    tree.entry_triangle = wp.array(mesh_triangle[mesh].astype(np.int32), dtype=int, device=device)
    if source.motion_steps:
        tree.entry_deform = wp.array(mesh_deform[mesh], dtype=int, device=device)
    for name in (
        "entry_from_world",
        "entry_instance",
        "entry_visibility",
        "merged_first",
        "merged_instance",
        "merged_triangle_first",
        "entry_motion",
        "motion_keys",
        "motion_steps",
        "deform_steps",
        "top_entry",
        "top_centre",
        "top_margin",
        "top_ranges",
        "range_centre",
        "entry_count",
    ):
        setattr(tree, name, getattr(source, name))
    tree.entry_centre = wp.array(
        np.array([each.centre for each in built.meshes])[mesh].astype(np.float32), dtype=wp.vec3, device=device
    )
    tree.top_node = int(mesh_node[-1])
    if source.motion_steps:
        tree.range_node = wp.array(
            to_numpy(source.range_node) + np.int32(tree.top_node - source.top_node), dtype=int, device=device
        )
    return tree


class _MeshCut(NamedTuple):
    """The part of a mesh tree's `Cut` that is kept: the large arrays are on the device."""

    top_nodes: np.ndarray
    of_node: np.ndarray
    of_large: np.ndarray
    in_large: np.ndarray
    root: np.ndarray
    top_triangles: wp.array
    top_triangle_count: int
    nodes: wp.array
    triangles: wp.array
    node_address: np.ndarray
    triangle_address: np.ndarray
    sizes: np.ndarray
    units: np.ndarray
    top_deform: int
    deform: np.ndarray
    levels: int

    @property
    def large_count(self) -> int:
        """Large treelets."""
        return int(self.of_large.max(initial=-1)) + 1


def _cut_mesh(layout: Layout, mesh: MeshTree, rule: CutRule, device: wp.Device) -> _MeshCut:
    steps = mesh.triangles.size * 4 // layout.triangle_words // mesh.step_units if mesh.step_units else 1
    cut = cut_nodes(layout, _words(mesh.nodes, layout.node_words, layout.node_type), rule, steps)
    top_deform, deform = cut.deform
    nodes = _upload_words(cut.nodes, device)
    order = wp.array(cut.triangle_order.astype(np.int32), dtype=int, device=device)

    def gathered(first: int, end: int) -> wp.array:
        vectors = layout.triangle_words // 4
        out = _empty_vectors((end - first) * vectors, device)
        wp.launch(gather_kernel, (end - first) * vectors, [mesh.triangles, order, first, vectors, out], device=device)
        return out

    triangles = gathered(cut.top_triangle_count, len(cut.triangle_order))
    return _MeshCut(
        top_nodes=cut.top_nodes,
        of_node=cut.top_treelet,
        of_large=cut.top_large,
        in_large=cut.treelet_large,
        root=cut.treelet_root,
        top_triangles=gathered(0, cut.top_triangle_count),
        top_triangle_count=cut.top_triangle_count,
        nodes=nodes,
        triangles=triangles,
        node_address=(nodes.ptr + 4 * layout.node_words * cut.node_first[:-1]).astype(np.uint64),
        triangle_address=(
            triangles.ptr + 4 * layout.triangle_words * (cut.triangle_first[:-1] - cut.triangle_first[0])
        ).astype(np.uint64),
        sizes=cut.treelet_sizes,
        units=np.diff(cut.triangle_first),
        top_deform=top_deform,
        deform=deform,
        levels=cut.levels,
    )


def _words(vectors: wp.array, words: int, dtype: type[np.generic]) -> np.ndarray:
    """The whole nodes or units of `words` words each in `vectors`; an incomplete one at the end is left out."""
    return to_numpy(vectors[: vectors.size * 4 // words * words // 4]).view(dtype).reshape(-1, words)


def _empty_vectors(count: int, device: wp.Device) -> wp.array:
    """An array of at least one element, so that it has an address, which is a multiple of 64 bytes."""
    count = max(count, 1)
    return (
        wp.empty(count, dtype=wp.vec4, device=device)
        if device.is_cuda
        else as_vectors(aligned_empty((count, 4), np.float32))
    )


def _upload_words(words: np.ndarray, device: wp.Device) -> wp.array:
    out = _empty_vectors(words.size // 4, device)
    if words.size:
        wp.copy(out, as_vectors(words), count=words.size // 4)
    return out


def _ends(counts: list[int]) -> np.ndarray:
    return np.cumsum([0, *counts], dtype=np.int64)


def _description(made: TreeletTree) -> dict[str, Any]:
    """Figures of the treelets for statistics."""
    sizes, sizes_bytes = made.treelet_sizes, made.treelet_bytes
    large = {"large_treelets": made.large_count} if made.large_count else {}
    return {
        "treelets": made.treelet_count,
        **large,
        "treelet_nodes_mean": round(float(sizes.mean()), 2),
        "treelet_nodes_largest": int(sizes.max()),
        "treelet_bytes_mean": round(float(sizes_bytes.mean()), 1),
        "treelet_bytes_largest": int(sizes_bytes.max()),
        "resident_nodes": made.treelets.of_node.size,
        "resident_bytes": made.resident_bytes,
        "levels": made.levels,
        "bytes": made.bytes,
    }
