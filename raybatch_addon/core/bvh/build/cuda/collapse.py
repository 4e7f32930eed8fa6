"""Wide nodes of the layout QUANTISED made of a binary tree, on the device.

Bottom-up, dynamic programming finds the least cost of covering each binary node by at most 1 to 7 wide nodes and
leaves, and remembers the choice (Ylitie, Karras and Laine 2017, "Efficient incoherent ray traversal on GPUs through
compressed wide BVHs", section 3.1), one height of the binary tree after the other.

Then top-down, a level of wide nodes at a time: count the children of each, number them by a scan, write the nodes.
Children lie behind their parents, those of one node in the order of slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....native.build import native_source
from ....native.structs import to_numpy
from ..collapse import CollapseCost
from ..encode import ENCODE_QUANTISED
from .clusters import BinaryNodes, half_area
from .order import HEIGHT_BITS, HeightOrder

vec7 = wp.types.vector(length=7, dtype=wp.float32)
vec8 = wp.types.vector(length=8, dtype=wp.float32)
vec8i = wp.types.vector(length=8, dtype=wp.int32)

VECTORS_PER_NODE = 5  # of four words
# The choice of a binary node, 64 bits: for each j of 2 to 8 parts, six bits at 6 (j - 2): parts of the first child,
# then of the second, or 0 where the node is one part after all; then its leaves (4: more than 3), and whether as one
# part it is a leaf
COUNT_SHIFT, LEAF_SHIFT = wp.constant(42), wp.constant(45)
COUNT_MANY = wp.constant(4)


@wp.struct
class Choices:
    """The findings of dynamic programming for each inner binary node."""

    cost: wp.array(dtype=vec7)  # least cost as at most 1 .. 7 parts, in units of the scaled scene's area
    choice: wp.array(dtype=wp.uint64)
    node_cost: float
    unit_cost: float  # of one triangle or entry of a leaf
    leaf_max: int  # triangles or entries of a leaf, 1 .. 3


@wp.struct
class Level:
    """Wide nodes of one level, and what is below them."""

    binary: wp.array(dtype=int)  # binary node of each
    counts: wp.array(dtype=wp.vec3i)  # its inner children, its leaves, and their triangles or entries
    offsets: wp.array(dtype=wp.vec3i)  # exclusive sum of `counts`
    next_binary: wp.array(dtype=int)  # the same as `binary` for the next level
    nodes: wp.array(dtype=wp.vec4)  # words of the wide nodes
    order: wp.array(dtype=int)  # what all leaves list, in the order of the whole tree
    area: wp.array(dtype=wp.vec2d)  # half the area of the node; of its leaves, each times its count
    next_first: int  # first node of the next level, from the tree's first
    order_first: int  # what leaves of earlier levels list
    centre: wp.vec3


@dataclass
class WideNodes:
    """A wide tree on the device."""

    nodes: wp.array  # wp.vec4, shape [5 * node_count]
    order: wp.array  # int32: triangles or entries as leaves list them
    level_first: list[int]  # first node of each level, then the node count; children lie in the next level
    leaf_count: int
    node_steps: float  # wide nodes that a random ray through the root's box meets (surface area heuristic)
    unit_tests: float  # triangles or entries in the leaves that it meets


@wp.func
def part_costs(nodes: BinaryNodes, choices: Choices, node: int) -> vec7:
    """Cost of a binary node as at most 1 .. 7 parts."""
    if node >= nodes.leaf_count:
        return choices.cost[node - nodes.leaf_count]
    leaf = half_area(nodes.low[node], nodes.high[node], nodes.scale) * choices.unit_cost
    costs = vec7()
    for k in range(7):
        costs[k] = leaf
    return costs


@wp.func
def leaves_below(nodes: BinaryNodes, choices: Choices, node: int) -> int:
    """Leaves of the binary tree below a node, at most COUNT_MANY."""
    if node < nodes.leaf_count:
        return 1
    return int((choices.choice[node - nodes.leaf_count] >> wp.uint64(COUNT_SHIFT)) & wp.uint64(7))


@wp.kernel(**KERNEL_OPTIONS)
def choose_kernel(nodes: BinaryNodes, choices: Choices, order: wp.array(dtype=int), first: int):
    """Costs and choices of the inner nodes `order[first]` .., whose children have theirs."""
    node = order[first + wp.tid()]
    k = node - nodes.leaf_count
    children = nodes.children[k]
    a = part_costs(nodes, choices, children[0])
    b = part_costs(nodes, choices, children[1])
    below = wp.min(leaves_below(nodes, choices, children[0]) + leaves_below(nodes, choices, children[1]), COUNT_MANY)
    area = half_area(nodes.low[node], nodes.high[node], nodes.scale)

    # the cost of exactly j parts, shared out between the children
    shared = vec8()
    packed = vec8i()
    for j in range(2, 9):
        best = a[0] + b[j - 2]
        best_first = int(1)
        for i in range(2, j):
            cost = a[i - 1] + b[j - i - 1]
            if cost < best:
                best = cost
                best_first = i
        shared[j - 1] = best
        packed[j - 1] = best_first | ((j - best_first) << 3)

    choice = wp.uint64(below) << wp.uint64(COUNT_SHIFT)
    costs = vec7()
    costs[0] = shared[7] + area * choices.node_cost
    leaf = area * choices.unit_cost * float(below)
    if below <= choices.leaf_max and leaf <= costs[0]:
        costs[0] = leaf
        choice = choice | (wp.uint64(1) << wp.uint64(LEAF_SHIFT))
    last = int(0)
    for j in range(2, 8):
        costs[j - 1] = costs[j - 2]
        if shared[j - 1] < costs[j - 2]:
            costs[j - 1] = shared[j - 1]
            last = packed[j - 1]
        choice = choice | (wp.uint64(last) << wp.uint64(6 * (j - 2)))
    choice = choice | (wp.uint64(packed[7]) << wp.uint64(36))
    choices.cost[k] = costs
    choices.choice[k] = choice


@wp.func
def wide_children(nodes: BinaryNodes, choices: Choices, root: int) -> tuple[vec8i, int]:
    """Binary nodes that become the children of the wide node at `root`, and how many."""
    found = vec8i()
    parts = vec8i()
    found[0] = root
    parts[0] = 8
    count = int(1)
    i = int(0)
    while i < count:
        node = found[i]
        split = int(0)
        if node >= nodes.leaf_count and parts[i] > 1:
            split = int(choices.choice[node - nodes.leaf_count] >> wp.uint64(6 * (parts[i] - 2))) & 63
        if split == 0:
            i += 1
        else:
            children = nodes.children[node - nodes.leaf_count]
            found[i] = children[0]
            parts[i] = split & 7
            found[count] = children[1]
            parts[count] = split >> 3
            count += 1
    return found, count


@wp.func
def leaf_size(nodes: BinaryNodes, choices: Choices, node: int) -> int:
    """Triangles or entries of a child that is a leaf; 0 for an inner one."""
    if node < nodes.leaf_count:
        return 1
    choice = choices.choice[node - nodes.leaf_count]
    if ((choice >> wp.uint64(LEAF_SHIFT)) & wp.uint64(1)) == wp.uint64(0):
        return 0
    return int((choice >> wp.uint64(COUNT_SHIFT)) & wp.uint64(7))


@wp.func
def leaf_members(nodes: BinaryNodes, root: int) -> wp.vec3i:
    """The at most three binary leaves below `root`."""
    found = wp.vec3i(root, 0, 0)
    count = int(1)
    i = int(0)
    while i < count:
        if found[i] < nodes.leaf_count:
            i += 1
        else:
            children = nodes.children[found[i] - nodes.leaf_count]
            found[i] = children[0]
            found[count] = children[1]
            count += 1
    return found


@wp.kernel(**KERNEL_OPTIONS)
def count_nodes_kernel(nodes: BinaryNodes, choices: Choices, level: Level):
    """Counts of what each wide node of the level has below it."""
    w = wp.tid()
    found, count = wide_children(nodes, choices, level.binary[w])
    inner = int(0)
    units = int(0)
    for i in range(count):
        size = leaf_size(nodes, choices, found[i])
        units += size
        if size == 0:
            inner += 1
    level.counts[w] = wp.vec3i(inner, count - inner, units)


@wp.func
def child_slots(nodes: BinaryNodes, root: int, found: vec8i, count: int) -> vec8i:
    """The child in each of eight slots, or -1.

    Slot bits say where a child lies (4: +x, 2: +y, 1: +z of the node's middle), so that `slot ^ octant of the ray`
    roughly sorts children front to back. Greedy: of all pairs that are left the one that fits best (section 3.2 there).
    """
    middle = 0.5 * nodes.low[root] + 0.5 * nodes.high[root]
    x = vec8()
    y = vec8()
    z = vec8()
    slots = vec8i()
    for i in range(count):
        offset = ((0.5 * nodes.low[found[i]] + 0.5 * nodes.high[found[i]]) - middle) * nodes.scale
        x[i] = offset[0]
        y[i] = offset[1]
        z[i] = offset[2]
    for s in range(8):
        slots[s] = -1
    left = int((1 << count) - 1)
    while left != 0:
        best = float(-wp.inf)
        best_child = int(-1)
        best_slot = int(0)
        for i in range(count):
            if (left >> i) & 1 == 1:
                for s in range(8):
                    if slots[s] < 0:
                        fit = wp.where((s & 4) != 0, x[i], -x[i])
                        fit += wp.where((s & 2) != 0, y[i], -y[i])
                        fit += wp.where((s & 1) != 0, z[i], -z[i])
                        if best_child < 0 or fit > best:
                            best = fit
                            best_child = i
                            best_slot = s
        slots[best_slot] = found[best_child]
        left = left & ~(1 << best_child)
    return slots


@wp.func_native(
    native_source(
        "encode/rounding.h",
        "collapse/node_children.h",
        "encode/quantised.h",
        "collapse/node_words.h",
        **ENCODE_QUANTISED,
    )
)
def encode_node(
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    root: int,
    slots: vec8i,
    middle: wp.vec3,
    links: vec8i,
    out: wp.array(dtype=wp.vec4),
    index: int,
): ...


@wp.kernel(**KERNEL_OPTIONS)
def write_kernel(nodes: BinaryNodes, choices: Choices, level: Level):
    """Wide nodes of a level, what their leaves list, and the binary nodes of the next level."""
    w = wp.tid()
    root = level.binary[w]
    found, count = wide_children(nodes, choices, root)
    slots = child_slots(nodes, root, found, count)
    inner_first = level.offsets[w][0]
    unit_first = level.order_first + level.offsets[w][2]
    inner = int(0)
    units = int(0)
    leaf_area = float(0.0)
    links = vec8i()  # mask of inner children, first node, first unit, two words of meta bytes
    links[1] = level.next_first + inner_first
    links[2] = unit_first
    for s in range(8):
        child = slots[s]
        if child >= 0:
            size = leaf_size(nodes, choices, child)
            meta = (1 << 5) | (24 + s)
            if size == 0:
                links[0] = links[0] | (1 << s)
                level.next_binary[inner_first + inner] = child
                inner += 1
            else:
                meta = (((1 << size) - 1) << 5) | units
                members = leaf_members(nodes, child)
                for k in range(size):
                    level.order[unit_first + units + k] = nodes.primitive[members[k]]
                units += size
                leaf_area += half_area(nodes.low[child], nodes.high[child], nodes.scale) * float(size)
            links[3 + s / 4] = links[3 + s / 4] | (meta << (8 * (s & 3)))
    encode_node(nodes.low, nodes.high, root, slots, level.centre, links, level.nodes, w)
    level.area[w] = wp.vec2d(
        wp.float64(half_area(nodes.low[root], nodes.high[root], nodes.scale)), wp.float64(leaf_area)
    )


COLLAPSE_KERNELS = (choose_kernel, count_nodes_kernel, write_kernel)


def choose_node_children(nodes: BinaryNodes, order: HeightOrder | None, cost: CollapseCost, leaf_max: int) -> Choices:
    """Choices for every inner node, of which there are none without an `order`; leaves will list at most `leaf_max` (1
    .. 3) each.
    """
    device, count = nodes.low.device, nodes.leaf_count
    choices = Choices()
    choices.cost = wp.empty(count - 1, dtype=vec7, device=device)
    choices.choice = wp.empty(count - 1, dtype=wp.uint64, device=device)
    choices.node_cost, choices.unit_cost, choices.leaf_max = cost.node, cost.unit, leaf_max
    if order is not None:
        launches = RepeatedLaunches(device)
        for first, end in zip(order.first, order.first[1:]):
            launches.launch(choose_kernel, end - first, nodes, choices, order.node, first)
    choices.cost = None
    return choices


def collapse(nodes: BinaryNodes, choices: Choices, centre: np.ndarray) -> WideNodes:
    """The wide tree that was chosen, its boxes relative to `centre`."""
    device, count = nodes.low.device, nodes.leaf_count
    order = wp.empty(count, dtype=int, device=device)
    binary = wp.full(1, 2 * count - 2, dtype=int, device=device)
    level_first, leaf_count, unit_count = [0], 0, 0
    # surfaces of each level: a tree of so many is the highest there can be
    blocks, areas = [], wp.zeros(min(count, 1 << HEIGHT_BITS), dtype=wp.vec2d, device=device)
    while binary.size:
        level = Level()
        size = binary.size
        level.binary, level.order, level.centre = binary, order, wp.vec3(*centre.tolist())
        level.counts, level.offsets = (wp.empty(size, dtype=wp.vec3i, device=device) for _ in range(2))
        wp.launch(count_nodes_kernel, size, [nodes, choices, level], device=device)
        wp.utils.array_scan(level.counts, level.offsets, inclusive=False)
        inner, leaves, units = (to_numpy(level.offsets[size - 1 :]) + to_numpy(level.counts[size - 1 :]))[0].tolist()
        level.next_first, level.order_first = level_first[-1] + size, unit_count
        level.next_binary = wp.empty(inner, dtype=int, device=device)
        level.nodes = wp.empty(VECTORS_PER_NODE * size, dtype=wp.vec4, device=device)
        level.area = wp.empty(size, dtype=wp.vec2d, device=device)
        wp.launch(write_kernel, size, [nodes, choices, level], device=device)
        wp.utils.array_sum(level.area, out=areas[len(blocks) : len(blocks) + 1])
        blocks.append(level.nodes)
        level_first.append(level.next_first)
        leaf_count += leaves
        unit_count += units
        binary = level.next_binary
    together = wp.empty(VECTORS_PER_NODE * level_first[-1], dtype=wp.vec4, device=device)
    for first, block in zip(level_first, blocks):
        wp.copy(together, block, VECTORS_PER_NODE * first)
    by_level = to_numpy(areas[: len(blocks)])
    steps, tests = (by_level.sum(0) / by_level[0, 0]).tolist()
    return WideNodes(together, order, level_first, leaf_count, steps, tests)
