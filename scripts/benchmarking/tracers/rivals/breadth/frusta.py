"""Kernels in which bounds of packets meet nodes, level by level."""

from __future__ import annotations

import warp as wp

from benchmarking.tracers.rivals.breadth.flat import FlatTree
from raybatch_addon.core.bvh.margin import DIRECTION_LEAST, SLAB_MARGIN
from raybatch_addon.core.bvh.tree import Tree as DeviceTree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.geometry import transform_point, transform_vector

LEAST = wp.constant(DIRECTION_LEAST)
MARGIN = wp.constant(SLAB_MARGIN)


@wp.struct
class Slabs:
    """A ray against boxes, as `traverse/boxes/ray.h` has it."""

    inverse: wp.vec3
    before: wp.vec3  # the origin moved back by the margin, relative to the tree's centre [m]
    behind: wp.vec3  # moved on
    sound: bool  # whether the ray can be traced


@wp.struct
class Moved:
    """A ray in the space of a tree."""

    origin: wp.vec3
    direction: wp.vec3
    slabs: Slabs


@wp.func
def moved_ray(tree: DeviceTree, entry: int, origin: wp.vec3, direction: wp.vec3) -> Moved:
    """The ray in the space of `entry`, or of the top level (-1)."""
    moved = Moved()
    moved.origin = origin
    moved.direction = direction
    centre = tree.top_centre
    margin = tree.top_margin
    if entry >= 0:
        if tree.entry_from_world.shape[0] != 0:
            moved.origin = transform_point(tree.entry_from_world[entry], origin)
            moved.direction = transform_vector(tree.entry_from_world[entry], direction)
        centre = tree.entry_centre[entry]
        margin = MARGIN
    o = moved.origin - centre
    d = moved.direction
    least = wp.max(wp.abs(d)) * LEAST
    back = wp.max(wp.abs(o)) * margin
    finite = float(0.0)
    for k in range(3):
        raised = wp.max(wp.abs(d[k]), least)
        if d[k] < 0.0:
            raised = -raised
        inverse = 1.0 / raised
        step = wp.where(raised < 0.0, -back, back)
        moved.slabs.inverse[k] = inverse
        moved.slabs.before[k] = o[k] + step
        moved.slabs.behind[k] = o[k] - step
        finite = finite + wp.abs(inverse) + wp.abs(moved.slabs.before[k] * inverse) + wp.abs(d[k])
    moved.slabs.sound = finite < wp.inf
    return moved


@wp.struct
class Bounds:
    """Of a packet in a tree, by axis: distances of its rays are bounded by (plane - origin) * rate."""

    axes: int  # bit k: all rays go the same way along axis k; bit k + 3: against it
    before: wp.vec3  # farthest on their way of the origins, moved back [m]
    behind: wp.vec3  # farthest back of those moved on
    least: wp.vec3  # of 1 / direction
    most: wp.vec3
    limit: float  # no ray asks for anything beyond; below 0: none can be traced [m]


@wp.struct
class Items:
    """Packets in trees."""

    packet: wp.array(dtype=int)
    entry: wp.array(dtype=int)  # -1: the top level
    bounds: wp.array(dtype=Bounds)


@wp.kernel(**KERNEL_OPTIONS)
def bounds_kernel(
    tree: DeviceTree, rays: Rays, slots: wp.array(dtype=int), packet_first: wp.array(dtype=int), items: Items
):
    """The bounds of each item."""
    i = wp.tid()
    packet = items.packet[i]
    entry = items.entry[i]
    found = Bounds()
    found.limit = -1.0
    least = wp.vec3(wp.inf, wp.inf, wp.inf)
    most = -least
    before_least = least
    before_most = most
    behind_least = least
    behind_most = most
    for j in range(packet_first[packet], packet_first[packet + 1]):
        slot = slots[j]
        s = moved_ray(tree, entry, rays.origin[slot], rays.direction[slot]).slabs
        if s.sound:
            found.limit = wp.max(found.limit, wp.max(rays.t_max[slot], 0.0))
            least = wp.min(least, s.inverse)
            most = wp.max(most, s.inverse)
            before_least = wp.min(before_least, s.before)
            before_most = wp.max(before_most, s.before)
            behind_least = wp.min(behind_least, s.behind)
            behind_most = wp.max(behind_most, s.behind)
    found.least = least
    found.most = most
    for k in range(3):
        if least[k] > 0.0:
            found.axes = found.axes | (1 << k)
            found.before[k] = before_most[k]
            found.behind[k] = behind_least[k]
        elif most[k] < 0.0:
            found.axes = found.axes | (9 << k)
            found.before[k] = before_least[k]
            found.behind[k] = behind_most[k]
    items.bounds[i] = found


@wp.func
def entered(flat: FlatTree, child: int, b: Bounds) -> float:
    """A distance below that at which any ray of the packet enters the box of `child`; -1 where none can."""
    low = flat.low[child]
    high = flat.high[child]
    enter = float(0.0)
    leave = b.limit
    for k in range(3):
        if (b.axes >> k) & 1:
            near = low[k] - b.before[k]
            far = high[k] - b.behind[k]
            if (b.axes >> (k + 3)) & 1:
                near = high[k] - b.before[k]
                far = low[k] - b.behind[k]
            enter = wp.max(enter, near * wp.where(near < 0.0, b.most[k], b.least[k]))
            leave = wp.min(leave, far * wp.where(far < 0.0, b.least[k], b.most[k]))
    return wp.where(enter <= leave, enter, -1.0)


@wp.struct
class Frontier:
    """Items at nodes of one level."""

    item: wp.array(dtype=int)
    node: wp.array(dtype=int)  # of all nodes
    base: wp.array(dtype=int)  # the first node of its tree
    inner: wp.array(dtype=int)  # how many nodes it goes on to; then summed up
    leaves: wp.array(dtype=int)  # how much it finds in leaves; then summed up


@wp.struct
class Found:
    """What items met in leaves."""

    key: wp.array(dtype=wp.int64)  # the item above the bits of the distance
    what: wp.array(dtype=int)  # a child of all children; in the top level, an entry


@wp.kernel(**KERNEL_OPTIONS)
def count_kernel(flat: FlatTree, items: Items, frontier: Frontier, top: bool):
    """How many children each goes on to, and how much is in leaves that it meets: of the top level entries, else
    leaves."""
    i = wp.tid()
    b = items.bounds[frontier.item[i]]
    inner = int(0)
    leaves = int(0)
    for k in range(8):
        child = frontier.node[i] * 8 + k
        count = flat.count[child]
        if count >= 0:
            if entered(flat, child, b) >= 0.0:
                if count == 0:
                    inner = inner + 1
                elif top:
                    leaves = leaves + count
                else:
                    leaves = leaves + 1
    frontier.inner[i] = inner
    frontier.leaves[i] = leaves


@wp.kernel(**KERNEL_OPTIONS)
def emit_kernel(
    flat: FlatTree, tree: DeviceTree, items: Items, frontier: Frontier, top: bool, deeper: Frontier, found: Found
):
    """What `count_kernel` counted, in its place; sums in `frontier` are inclusive."""
    i = wp.tid()
    item = frontier.item[i]
    b = items.bounds[item]
    inner = int(0)
    leaf = int(0)
    if i > 0:
        inner = frontier.inner[i - 1]
        leaf = frontier.leaves[i - 1]
    for k in range(8):
        child = frontier.node[i] * 8 + k
        count = flat.count[child]
        if count >= 0:
            enter = entered(flat, child, b)
            if enter >= 0.0:
                if count == 0:
                    deeper.item[inner] = item
                    deeper.base[inner] = frontier.base[i]
                    deeper.node[inner] = frontier.base[i] + flat.first[child]
                    inner = inner + 1
                else:
                    key = wp.int64(item) << wp.int64(32) | wp.int64(wp.cast(enter, wp.uint32))
                    number = wp.where(top, count, 1)
                    for j in range(number):
                        found.key[leaf] = key
                        if top:
                            found.what[leaf] = tree.top_entry[flat.first[child] + j]
                        else:
                            found.what[leaf] = child
                        leaf = leaf + 1
