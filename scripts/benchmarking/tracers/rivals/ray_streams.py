"""Rivals that carry streams of rays through the tree of `off`: at a node every ray meets its eight boxes at once, and
those that want a child are listed.
"""

from __future__ import annotations

import warp as wp

from benchmarking.tracers.rivals.native_stage import FILTER, ORDERED, REORDERED, PacketTracer
from benchmarking.tracers.stages import SceneTrees


class FilterTracer(PacketTracer):
    """Multi-BVH ray streams: Tsakok 2009, "Faster incoherent rays: Multi-BVH ray stream tracing".

    A node filters its stream into one list a child. All rays take the children in one order, here that of the mean
    distances at which their rays enter them. Lists hold numbers of rays alone, so a ray that found a closer hit since
    is noticed only when it meets the boxes of the next node, or the triangles. In a leaf, rays are tested one by one
    against eight triangles, as ours are; theirs were gathered to vectors of rays.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, size: int):
        """`size`: rays of a stream."""
        super().__init__(name, trees, device, FILTER, size=size)


class DynamicStreamTracer(PacketTracer):
    """Dynamic ray streams: Barringer and Akenine-Moeller 2014, "Dynamic ray stream traversal".

    Each ray keeps an order of its own. A binary node makes three streams: left, right, left; rays that want the left
    child first are in the first two, the others in the last two, and of the streams that wait rays with a closer hit
    are left out. For four children they nest this once. Here it is nested twice, over the halves, pairs and places of
    the eight slots: 27 streams, 128 orders, by the nearest box of either part. As there, few rays go on one by one. Our
    boxes fill a vector with one ray; with their binary tree, rays of a stream filled it.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, size: int, alone: int):
        """`size`: rays of a stream; `alone`: so many or fewer go on one by one."""
        super().__init__(name, trees, device, REORDERED, size=size, alone=alone)


class OrderedStreamTracer(PacketTracer):
    """Ordered ray streams: Fuetterling, Lojewski, Pfreundt and Ebert 2015, "Efficient ray tracing kernels for modern
    CPU architectures".

    A ray's order of a node's children comes from a table, by its octant, so that nothing is sorted, and it is kept
    strictly: each ray is listed at the child that is next for it alone, and when that was visited it moves on to the
    list of the one behind. Their table is by how the four children are split along axes; our nodes do not tell, so here
    a table beside the tree has the eight children of each node by the middles of their boxes along the octant's
    diagonal (`octant_orders`). A child is visited when it is the first, in the order of the stream's first ray, at
    which rays wait. Distances of entry are kept, so that a ray passes children behind its closest hit. Few rays go on
    one by one.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, size: int, alone: int):
        """`size`: rays of a stream; `alone`: so many or fewer go on one by one."""
        super().__init__(name, trees, device, ORDERED, size=size, alone=alone)
