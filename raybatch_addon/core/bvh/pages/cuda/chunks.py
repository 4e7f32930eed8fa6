"""The trees of chunks built on a device, whose large arrays stay there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....native.structs import to_numpy
from ...build.cuda.build import build_mesh
from ...node import Layout
from ...treelets.cut import Cut
from ...treelets.tree import gather_kernel
from ..chunk import Chunk, TreeFacts
from ..divide.cells import MeshTriangles, mesh_corner

_NODE_WORDS = Layout.QUANTISED.node_words
_TRIANGLE_VECTORS = Layout.QUANTISED.triangle_words // 4


@dataclass(frozen=True)
class ChunkTree:
    """The tree of a chunk, of the layout QUANTISED, before it is cut."""

    faces: np.ndarray  # the triangles, numbers in the mesh, int32, rising
    nodes: wp.array  # wp.vec4
    triangles: wp.array  # wp.vec4, with numbers in the mesh
    vertices: wp.array  # of each triangle, in the order of `triangles`, int32, shape [3 * count]
    steps: int  # of vertices that move, whose `triangles` and `vertices` lie one behind another
    facts: TreeFacts


@wp.kernel(**KERNEL_OPTIONS)
def corners_kernel(
    mesh: MeshTriangles, faces: wp.array(dtype=int), corners: wp.array(dtype=wp.vec3), vertices: wp.array(dtype=int)
):
    """Corners of triangles, and which vertices they are (one thread a corner)."""
    i = wp.tid()
    triangle = faces[i // 3]
    k = i % 3
    corners[i] = mesh_corner(mesh, triangle, k)
    vertices[i] = mesh.triangles[mesh.first + triangle][k]


@wp.kernel(**KERNEL_OPTIONS)
def name_kernel(
    faces: wp.array(dtype=int), vertices: wp.array(dtype=int), words: wp.array(dtype=int), out: wp.array(dtype=int)
):
    """Numbers in the mesh for triangles that are numbered in the chunk, and their vertices."""
    i = wp.tid()
    local = words[12 * i + 3]
    words[12 * i + 3] = faces[local]
    for k in range(3):
        out[3 * i + k] = vertices[3 * local + k]


@wp.kernel(**KERNEL_OPTIONS)
def one_treelet_kernel(words: wp.array(dtype=wp.uint32), out: wp.array(dtype=wp.uint32)):
    """Nodes of a tree that is one treelet: indices count from behind the root, those of nothing are 0 (one thread a
    node).
    """
    first = _NODE_WORDS * wp.tid()
    for k in range(_NODE_WORDS):
        out[first + k] = words[first + k]
    if words[first + 3] >> wp.uint32(24) == wp.uint32(0):
        out[first + 4] = wp.uint32(0)
    else:
        out[first + 4] = words[first + 4] - wp.uint32(1)
    leaves = int(0)
    for k in range(8):
        meta = (words[first + 6 + k // 4] >> wp.uint32(8 * (k % 4))) & wp.uint32(255)
        if meta != wp.uint32(0) and (meta & wp.uint32(0xF8)) != wp.uint32(0x38):
            leaves += 1
    if leaves == 0:
        out[first + 5] = wp.uint32(0)


@wp.kernel(**KERNEL_OPTIONS)
def gather_vertices_kernel(
    source: wp.array(dtype=int), order: wp.array(dtype=int), first: int, out: wp.array(dtype=int)
):
    """Vertices of triangles in another order (one thread a corner)."""
    i = wp.tid()
    out[i] = source[3 * order[first + i // 3] + i % 3]


@wp.kernel(**KERNEL_OPTIONS)
def own_kernel(
    mesh: MeshTriangles,
    stand_ins: wp.array(dtype=int),
    shift: int,
    first: int,
    words: wp.array(dtype=int),
    vertices: wp.array(dtype=int),
):
    """Primitives of the mesh, whose vertices lie `shift` further on, where triangles stand in for them: from number
    `first` on of `words` and `vertices` (one thread a primitive).
    """
    i = wp.tid()
    face = stand_ins[12 * i + 3]
    for k in range(3):
        vertex = mesh.triangles[mesh.first + face][k] + shift
        at = 12 * (first + i) + 4 * k
        for axis in range(3):
            words[at + axis] = wp.cast(mesh.positions[vertex][axis], wp.int32)
        words[at + 3] = stand_ins[12 * i + 4 * k + 3]
        vertices[3 * (first + i) + k] = vertex


CHUNK_KERNELS = (corners_kernel, name_kernel, one_treelet_kernel, own_kernel, gather_vertices_kernel, gather_kernel)


def retyped(array: wp.array, dtype: type) -> wp.array:
    """The memory of `array`, which must outlive it, as elements of another type."""
    size = array.size * wp.types.type_size_in_bytes(array.dtype) // wp.types.type_size_in_bytes(dtype)
    return wp.array(ptr=array.ptr, dtype=dtype, shape=size, device=array.device)


def build_chunk(mesh: MeshTriangles, faces: np.ndarray, numbers: wp.array) -> ChunkTree:
    """The tree of the triangles `faces` of `mesh`, int32, rising.

    `numbers`: 0, 1, 2; 3, 4, 5; ..., wp.vec3i, at least as many as triangles. Raises as `build_mesh`.
    """
    device, count = mesh.triangles.device, len(faces)
    listed = wp.array(faces, dtype=int, device=device)
    corners = wp.empty(3 * count, dtype=wp.vec3, device=device)
    vertices, named = (wp.empty(3 * count, dtype=int, device=device) for _ in range(2))
    wp.launch(corners_kernel, 3 * count, [mesh, listed, corners, vertices], device=device)
    made = build_mesh(corners, numbers, 0, count)
    words = retyped(made.triangles, wp.int32)
    wp.launch(name_kernel, count, [listed, vertices, words, named], device=device)
    facts = TreeFacts(made.centre, made.box, made.sah, made.depth)
    return ChunkTree(faces, made.nodes, made.triangles, named, 1, facts)


def own_in_place(tree: ChunkTree, mesh: MeshTriangles, shifts: np.ndarray) -> ChunkTree:
    """`tree` with the primitives of `mesh` in place of their stand-ins: those of as many steps as there are `shifts`
    (as in `OwnPrimitives`).
    """
    device, count, steps = tree.nodes.device, len(tree.faces), len(shifts)
    triangles = wp.empty(steps * count * _TRIANGLE_VECTORS, dtype=wp.vec4, device=device)
    vertices = wp.empty(3 * steps * count, dtype=int, device=device)
    into = retyped(triangles, wp.int32), vertices
    for step, shift in enumerate(shifts.tolist()):
        inputs = [mesh, retyped(tree.triangles, wp.int32), shift, step * count, *into]
        wp.launch(own_kernel, count, inputs, device=device)
    return replace(tree, triangles=triangles, vertices=vertices, steps=steps)


def one_treelet(tree: ChunkTree) -> Chunk:
    """The chunk as a single treelet: what `cut_nodes` makes of it by a rule that limits nothing."""
    device, count = tree.nodes.device, len(tree.faces)
    node_count = tree.nodes.size * 4 // _NODE_WORDS
    moved = wp.empty(node_count * _NODE_WORDS, dtype=wp.uint32, device=device)
    wp.launch(one_treelet_kernel, node_count, [retyped(tree.nodes, wp.uint32), moved], device=device)
    return Chunk(
        faces=tree.faces,
        facts=tree.facts,
        levels=1,
        top_nodes=to_numpy(moved[:_NODE_WORDS]).reshape(1, -1).copy(),
        top_treelet=np.zeros(1, np.int32),
        treelet_root=np.zeros(1, np.int32),
        top_triangles=np.zeros((0, 4 * _TRIANGLE_VECTORS), np.float32),
        nodes=moved[_NODE_WORDS:] if node_count > 1 else np.zeros((0, _NODE_WORDS), np.uint32),
        node_first=np.array([0, node_count - 1]),
        triangles=tree.triangles,
        triangle_first=np.array([0, tree.steps * count]),
        vertices=tree.vertices,
    )


def in_treelets(tree: ChunkTree, cut: Cut) -> Chunk:
    """The chunk in the treelets of `cut`, whose nodes lie in host memory."""
    device, count, top = tree.nodes.device, tree.steps * len(tree.faces), cut.top_triangle_count
    order = wp.array(cut.triangle_order.astype(np.int32), dtype=int, device=device)

    def gathered(first: int, end: int) -> wp.array:
        size = (end - first) * _TRIANGLE_VECTORS
        out = wp.empty(size, dtype=wp.vec4, device=device)
        wp.launch(gather_kernel, size, [tree.triangles, order, first, _TRIANGLE_VECTORS, out], device=device)
        return out

    vertices = wp.empty(3 * (count - top), dtype=int, device=device)
    wp.launch(gather_vertices_kernel, vertices.size, [tree.vertices, order, top, vertices], device=device)
    return Chunk(
        faces=tree.faces,
        facts=tree.facts,
        levels=cut.levels,
        top_nodes=cut.top_nodes,
        top_treelet=cut.top_treelet,
        treelet_root=cut.treelet_root,
        top_triangles=to_numpy(gathered(0, top)).reshape(-1, 4 * _TRIANGLE_VECTORS),
        nodes=cut.nodes,
        node_first=cut.node_first,
        triangles=gathered(top, count),
        triangle_first=cut.triangle_first - top,
        vertices=vertices,
    )
