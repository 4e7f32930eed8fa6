"""Improves a binary tree on the device by moving subtrees to where they cost less.

Parallel reinsertion (Meister and Bittner 2018, "Parallel reinsertion for bounding volume hierarchy optimization"). In
each round every node looks for the sibling beside which it would lower the sum of all areas most. Of moves that change
the same nodes the one that gains most is made, equal ones by their numbers, so that rounds give the same tree each
time. Boxes are made anew after each.

Clusters in Morton order (`clusters.py`) make trees whose upper nodes overlap; ten rounds take a tenth off
their cost, and a quarter off the steps of rays in buildings.
"""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....native.structs import to_numpy
from .clusters import BinaryNodes, half_area
from .order import ParentLinks, refit

ROUND_MAX = 10
# The last round is the one in which fewer than one node in so many moved
FEW_MOVES = 1000
# Nodes that a search may have waiting; it goes no deeper where there are more
STACK_SIZE = wp.constant(48)
# Nodes that a search looks at: scenes need 50 to 400, but where everything overlaps it would be all of them
CANDIDATE_MAX = wp.constant(1000)
# Gains below this share of the area that a removal saves are rounding
GAIN_LEAST = wp.constant(2.0**-20)


@wp.struct
class NodeMoves:
    """The move that each node asks for."""

    target: wp.array(dtype=int)  # the node whose sibling it would become, or -1
    pivot: wp.array(dtype=int)  # the lowest node above both
    gain: wp.array(dtype=float)  # by how much the sum of areas would fall
    best: wp.array(dtype=wp.uint64)  # the best move that changes each node
    won: wp.array(dtype=wp.uint8)  # whether that is so of all nodes that this one's move changes
    count: wp.array(dtype=int)  # moves made, shape [1]


@wp.func
def sibling_of(nodes: BinaryNodes, parent: int, node: int) -> int:
    """The other child of `parent`."""
    children = nodes.children[parent - nodes.leaf_count]
    return wp.where(children[0] == node, children[1], children[0])


@wp.func
def area_of(nodes: BinaryNodes, node: int) -> float:
    """Half the surface of a node's box."""
    return half_area(nodes.low[node], nodes.high[node], nodes.scale)


@wp.kernel(**KERNEL_OPTIONS)
def search_kernel(nodes: BinaryNodes, links: ParentLinks, moves: NodeMoves):
    """The best new sibling of each node, by branch and bound: first below its parent, then below each node above.

    A node's removal saves its parent's area, and lets the boxes above shrink up to the pivot, below which it comes
    back. There it costs the growth of the boxes on its way down, and the box around it and its new sibling.
    """
    node = wp.tid()
    moves.target[node] = -1
    moves.won[node] = wp.uint8(0)
    parent = links.parent[node]
    if parent < 0:
        return
    if links.parent[parent] < 0:
        return
    low, high = wp.vec3(nodes.low[node]), wp.vec3(nodes.high[node])
    area = half_area(low, high, nodes.scale)
    saved = area_of(nodes, parent)
    best = saved * GAIN_LEAST
    best_target = int(-1)
    best_pivot = int(-1)
    stack_node = wp.zeros(shape=STACK_SIZE, dtype=int)
    stack_saved = wp.zeros(shape=STACK_SIZE, dtype=float)
    pivot = int(parent)
    below = int(node)
    looked = int(0)
    rest_low = wp.vec3(wp.inf, wp.inf, wp.inf)  # of the pivot without the node
    rest_high = -rest_low
    while pivot >= 0:
        other = sibling_of(nodes, pivot, below)
        stack_node[0] = other
        stack_saved[0] = saved
        size = int(1)
        while size > 0:
            size -= 1
            if stack_saved[size] - area > best and looked < CANDIDATE_MAX:
                looked += 1
                candidate = stack_node[size]
                gain = stack_saved[size] - half_area(
                    wp.min(low, nodes.low[candidate]), wp.max(high, nodes.high[candidate]), nodes.scale
                )
                if gain > best and (pivot != parent or candidate != other):  # beside its sibling it is already
                    best = gain
                    best_target = candidate
                    best_pivot = pivot
                saved_below = gain + area_of(nodes, candidate)
                # the box around both is at least as large as the node
                if candidate >= nodes.leaf_count and saved_below - area > best and size + 2 <= STACK_SIZE:
                    children = nodes.children[candidate - nodes.leaf_count]
                    for i in range(2):
                        stack_node[size] = children[i]
                        stack_saved[size] = saved_below
                        size += 1
        rest_low = wp.min(rest_low, nodes.low[other])
        rest_high = wp.max(rest_high, nodes.high[other])
        if pivot != parent:
            saved += area_of(nodes, pivot) - half_area(rest_low, rest_high, nodes.scale)
        below = pivot
        pivot = links.parent[pivot]
    moves.target[node] = best_target
    moves.pivot[node] = best_pivot
    moves.gain[node] = best


@wp.struct
class Changed:
    """The nodes that a move changes, and what orders moves."""

    parent: int
    sibling: int
    grandparent: int
    above: int  # parent of the target
    key: wp.uint64


@wp.func
def changed_by(nodes: BinaryNodes, links: ParentLinks, moves: NodeMoves, node: int) -> Changed:
    """The nodes that the move of `node`, which has a target, changes."""
    changed = Changed()
    changed.parent = links.parent[node]
    changed.sibling = sibling_of(nodes, changed.parent, node)
    changed.grandparent = links.parent[changed.parent]
    changed.above = links.parent[moves.target[node]]
    # gains are above 0: their bits are in the order of their values
    gain = wp.uint64(wp.cast(moves.gain[node], wp.uint32))
    changed.key = (gain << wp.uint64(32)) | wp.uint64(node)
    return changed


@wp.kernel(**KERNEL_OPTIONS)
def ask_kernel(nodes: BinaryNodes, links: ParentLinks, moves: NodeMoves):
    """Moves ask for the nodes that they change."""
    node = wp.tid()
    if moves.target[node] >= 0:
        changed = changed_by(nodes, links, moves, node)
        wp.atomic_max(moves.best, node, changed.key)
        wp.atomic_max(moves.best, moves.target[node], changed.key)
        wp.atomic_max(moves.best, changed.parent, changed.key)
        wp.atomic_max(moves.best, changed.sibling, changed.key)
        wp.atomic_max(moves.best, changed.grandparent, changed.key)
        wp.atomic_max(moves.best, changed.above, changed.key)


@wp.kernel(**KERNEL_OPTIONS)
def win_kernel(nodes: BinaryNodes, links: ParentLinks, moves: NodeMoves):
    """Which moves got all they asked for."""
    node = wp.tid()
    if moves.target[node] >= 0:
        changed = changed_by(nodes, links, moves, node)
        key = changed.key
        if (
            moves.best[node] == key
            and moves.best[moves.target[node]] == key
            and moves.best[changed.parent] == key
            and moves.best[changed.sibling] == key
            and moves.best[changed.grandparent] == key
            and moves.best[changed.above] == key
        ):
            moves.won[node] = wp.uint8(1)


@wp.kernel(**KERNEL_OPTIONS)
def ring_kernel(links: ParentLinks, moves: NodeMoves):
    """Gives up moves into a subtree that moves too, lest two go below each other.

    If no mover is between a pivot and a target, then a subtree that holds the target of a mover holds that mover too,
    so that a ring would have been one before.
    """
    node = wp.tid()
    if moves.won[node] == wp.uint8(1):
        above = int(moves.target[node])
        pivot = moves.pivot[node]
        while above != pivot:
            if moves.won[above] == wp.uint8(1):
                moves.target[node] = -1
                return
            above = links.parent[above]


@wp.func
def replace_child(nodes: BinaryNodes, parent: int, old: int, new: int):
    """Replace the child `old` by `new`."""
    k = parent - nodes.leaf_count
    children = nodes.children[k]
    if children[0] == old:
        nodes.children[k] = wp.vec2i(new, children[1])
    else:
        nodes.children[k] = wp.vec2i(children[0], new)


@wp.kernel(**KERNEL_OPTIONS)
def move_kernel(nodes: BinaryNodes, links: ParentLinks, moves: NodeMoves):
    """The sibling replaces the parent, and the parent, with the node, the target."""
    node = wp.tid()
    target = moves.target[node]
    if target >= 0 and moves.won[node] == wp.uint8(1):
        changed = changed_by(nodes, links, moves, node)
        replace_child(nodes, changed.grandparent, changed.parent, changed.sibling)
        links.parent[changed.sibling] = changed.grandparent
        replace_child(nodes, changed.above, target, changed.parent)
        links.parent[changed.parent] = changed.above
        nodes.children[changed.parent - nodes.leaf_count] = wp.vec2i(target, node)
        links.parent[target] = changed.parent
        wp.atomic_add(moves.count, 0, 1)


REINSERT_KERNELS = (search_kernel, ask_kernel, win_kernel, ring_kernel, move_kernel)


def reinsert(nodes: BinaryNodes, links: ParentLinks, round_max: int = ROUND_MAX) -> int:
    """Improve a tree with boxes in at most so many rounds; returns how many were made. Its root stays the last node."""
    device, count = nodes.low.device, 2 * nodes.leaf_count - 1
    moves = NodeMoves()
    moves.target, moves.pivot = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    moves.gain = wp.empty(count, dtype=float, device=device)
    moves.best = wp.empty(count, dtype=wp.uint64, device=device)
    moves.won = wp.empty(count, dtype=wp.uint8, device=device)
    moves.count = wp.empty(1, dtype=int, device=device)
    launches = RepeatedLaunches(device)
    for number in range(round_max):
        moves.best.zero_()
        moves.count.zero_()
        for kernel in (search_kernel, ask_kernel, win_kernel):
            launches.launch(kernel, count, nodes, links, moves)
        launches.launch(ring_kernel, count, links, moves)
        launches.launch(move_kernel, count, nodes, links, moves)
        refit(nodes, links)
        if int(to_numpy(moves.count)[0]) * FEW_MOVES < nodes.leaf_count:
            return number + 1
    return round_max
