"""The two layouts of a wide tree: nodes with up to eight children, and blocks of triangles.

A *mesh tree* is one block of nodes and one block of triangles. Node 0 is the root; every index is relative to the first
node or triangle of its block, so that blocks can be moved. Boxes are relative to the tree's `centre`, triangles are
not.

BOXES is for CPUs: full float32 boxes as rows of eight for vector units, nodes and groups of triangles in depth-first
order. QUANTISED is for GPUs: 80 bytes a node, boxes as bytes on a grid of the node's own (Ylitie, Karras and Laine
2017, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs"). Both keep whole float32 triangles.

Every child box is the box of what is below it, moved by the centre, grown by `SLAB_MARGIN` (`margin.py`) times the
largest absolute coordinate, relative to the centre, of the triangles below *the node that holds it*, and rounded
outwards. A spatial split lets a box be smaller than its triangles. The bound still holds: the point near which the hit
lies belongs to one part of the triangle, and the box of that part is visited. But the error grows with the triangle's
vertices, so it is these, not the clipped boxes, that set the margin.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

WIDTH = 8  # children of a node
EMPTY_CHILD = 0x7FFFFFFF  # BOXES: a slot without a child
TRIANGLES_MAX_BOXES = 8  # of a leaf: one group
GROUPS_MAX = 8  # of a leaf of BOXES that the binary tree made so large: its word counts them in three bits
TRIANGLES_MAX_QUANTISED = 3

# One node of BOXES, 256 bytes. `planes` [axis, lower or upper, slot]: an empty slot has +inf and -inf. `child`: a node
# when >= 0; a leaf is ~(first_group * 8 + group_count - 1).
BOXES_NODE = np.dtype([("planes", "<f4", (3, 2, WIDTH)), ("child", "<i4", WIDTH), ("spare", "<i4", WIDTH)])
# Eight triangles of BOXES, 320 bytes. `corners` [corner, axis, lane]; `face` is -1, and the corners 0, where there is
# none.
BOXES_GROUP = np.dtype([("corners", "<f4", (3, 3, WIDTH)), ("face", "<i4", WIDTH)])

# One node of QUANTISED, 80 bytes. A plane is origin + byte * 2^(exponent - 127). Bit s of `inner_mask`: slot s holds a
# node. These nodes are contiguous from `child_base`, in the order of slots. `meta` of a node is 1 << 5 | 24 + slot; of
# a leaf, its count in unary (1, 3, 7) << 5 | offset of its first triangle from `triangle_base`; of an empty slot, 0.
# Slot bits say where a child lies: 4 towards +x, 2 towards +y, 1 towards +z. A ray with the octant o (4 when dx < 0, 2
# when dy < 0, 1 when dz < 0) meets children roughly in the order of slot ^ o.
QUANTISED_NODE = np.dtype(
    [
        ("origin", "<f4", 3),
        ("exponent", "u1", 3),
        ("inner_mask", "u1"),
        ("child_base", "<i4"),
        ("triangle_base", "<i4"),
        ("meta", "u1", WIDTH),
        ("low", "u1", (3, WIDTH)),
        ("high", "u1", (3, WIDTH)),
    ]
)
# One triangle of QUANTISED, 48 bytes
QUANTISED_TRIANGLE = np.dtype(
    [("a", "<f4", 3), ("face", "<i4"), ("b", "<f4", 3), ("spare_b", "<i4"), ("c", "<f4", 3), ("spare_c", "<i4")]
)

VECTOR_BYTES = 16  # of an element of the arrays of nodes and triangles: a word of a quantised layout

# What native code knows of either layout; of BOXES in bytes
BOXES_DEFINES = {
    "NODE_BYTES": BOXES_NODE.itemsize,
    "NODE_CHILD": BOXES_NODE.fields["child"][1],
    "NODE_SPARE": BOXES_NODE.fields["spare"][1],
    "GROUP_BYTES": BOXES_GROUP.itemsize,
    "GROUP_FACE": BOXES_GROUP.fields["face"][1],
    "GROUP_ROW": WIDTH * 4,
    "EMPTY_CHILD": EMPTY_CHILD,
}
QUANTISED_DEFINES = {
    "NODE_WORDS": QUANTISED_NODE.itemsize // VECTOR_BYTES,
    "TRIANGLE_WORDS": QUANTISED_TRIANGLE.itemsize // VECTOR_BYTES,
}


class Layout(enum.Enum):
    """How nodes and triangles lie in memory."""

    BOXES = "boxes"
    QUANTISED = "quantised"

    @property
    def node_words(self) -> int:
        """Words of 4 bytes of a node."""
        return (BOXES_NODE if self is Layout.BOXES else QUANTISED_NODE).itemsize // 4

    @property
    def node_type(self) -> type[np.generic]:
        """Element of the array of nodes."""
        return np.float32 if self is Layout.BOXES else np.uint32

    @property
    def triangle_words(self) -> int:
        """Words of 4 bytes of a group of triangles (BOXES), or of one triangle (QUANTISED)."""
        return (BOXES_GROUP if self is Layout.BOXES else QUANTISED_TRIANGLE).itemsize // 4


@dataclass(frozen=True, kw_only=True)
class WideTree:
    """Nodes over something that leaves list."""

    layout: Layout
    nodes: np.ndarray  # BOXES: float32, shape [n, 64]; QUANTISED: uint32, shape [n, 20]; both 64-byte aligned
    centre: np.ndarray  # float32, shape [3]: what box coordinates are relative to
    box: np.ndarray  # float32, shape [2, 3]: lowest and highest corner of everything below, absolute and not grown
    depth: int  # levels of nodes, at least 1
    leaf_count: int
    reference_count: int  # things listed by all leaves; more than there are where they were split
    sah: float  # expected cost of a random ray that meets the root's box, in node steps (surface area heuristic)

    @property
    def node_count(self) -> int:
        """Nodes of the tree."""
        return len(self.nodes)


@dataclass(frozen=True)
class WideMesh(WideTree):
    """The tree of one mesh with its triangles."""

    triangles: np.ndarray  # float32, 64-byte aligned; BOXES: groups, shape [g, 80]; QUANTISED: shape [t, 12]
    triangle_count: int  # triangles of the mesh

    @property
    def byte_count(self) -> int:
        """Memory of nodes and triangles [bytes]."""
        return self.nodes.nbytes + self.triangles.nbytes


@dataclass(frozen=True)
class WideTop(WideTree):
    """A tree over entries (meshes in their places) instead of triangles.

    A leaf of BOXES is ~(first * 8 + count - 1), one of QUANTISED counts from `triangle_base`: both over positions in
    `order`.
    """

    order: np.ndarray  # int32: entries as leaves list them


def aligned_empty(shape: tuple[int, ...], dtype: type[np.generic]) -> np.ndarray:
    """An array without contents whose memory starts at a multiple of 64 bytes (a cache line)."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + 64, np.uint8)
    first = -memory.ctypes.data % 64
    return memory[first : first + size].view(dtype).reshape(shape)


class Children(NamedTuple):
    """Children of nodes, decoded."""

    low: np.ndarray  # float64, shape [n, 8, 3], relative to the centre; +inf where there is no child
    high: np.ndarray  # likewise; -inf where there is none
    inner: np.ndarray  # int64, shape [n, 8]: node, or -1
    first: np.ndarray  # int64, shape [n, 8]: first triangle or group of a leaf, or -1
    count: np.ndarray  # int64, shape [n, 8]: triangles or groups of a leaf, or 0


def decode_children(layout: Layout, nodes: np.ndarray) -> Children:
    """What the words of `nodes`, shape [n, words of a node], say."""
    return (_decode_boxes if layout is Layout.BOXES else _decode_quantised)(nodes)


def _decode_boxes(nodes: np.ndarray) -> Children:
    fields = np.ascontiguousarray(nodes).view(BOXES_NODE)[:, 0]
    planes = fields["planes"].astype(np.float64)
    child = fields["child"].astype(np.int64)
    leaf = child < 0
    inner = np.where(leaf | (child == EMPTY_CHILD), -1, child)
    first, count = np.where(leaf, ~child >> 3, -1), np.where(leaf, (~child & 7) + 1, 0)
    return Children(planes[:, :, 0].transpose(0, 2, 1), planes[:, :, 1].transpose(0, 2, 1), inner, first, count)


def _decode_quantised(nodes: np.ndarray) -> Children:
    fields = np.ascontiguousarray(nodes).view(QUANTISED_NODE)[:, 0]
    meta = fields["meta"].astype(np.int64)
    origin = fields["origin"].astype(np.float64)[:, None, :]
    scale = np.exp2(fields["exponent"].astype(np.float64) - 127)[:, None, :]
    empty = (meta == 0)[..., None]
    low = np.where(empty, np.inf, origin + fields["low"].transpose(0, 2, 1) * scale)
    high = np.where(empty, -np.inf, origin + fields["high"].transpose(0, 2, 1) * scale)
    inner_bit = fields["inner_mask"].astype(np.int64)[:, None] >> np.arange(WIDTH) & 1
    before = np.cumsum(inner_bit, 1) - inner_bit
    inner = np.where(inner_bit == 1, fields["child_base"].astype(np.int64)[:, None] + before, -1)
    leaf = (meta != 0) & (inner_bit == 0)
    first = np.where(leaf, fields["triangle_base"].astype(np.int64)[:, None] + (meta & 31), -1)
    unary = meta >> 5
    count = np.where(leaf, (unary & 1) + (unary >> 1 & 1) + (unary >> 2), 0)
    return Children(low, high, inner, first, count)


def triangle_faces(layout: Layout, triangles: np.ndarray) -> np.ndarray:
    """View of the triangle numbers in the blocks, int32, shape [groups, 8] (-1 for none) or [t]."""
    return triangles.view(BOXES_GROUP if layout is Layout.BOXES else QUANTISED_TRIANGLE)[:, 0]["face"]


def half_areas(extents: np.ndarray) -> np.ndarray:
    """Half the surface areas of boxes with these `extents`, shape [..., 3]."""
    x, y, z = extents[..., 0], extents[..., 1], extents[..., 2]
    return x * y + y * z + z * x
