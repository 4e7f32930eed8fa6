"""A binary tree over boxes, built on the device by merging clusters in Morton order.

Boxes are sorted along a Morton curve of their middles. Then, round by round, each cluster looks for the neighbour
within `_RADIUS` positions with which its common box is smallest, and pairs that choose each other merge: PLOC (Meister
and Bittner 2018, "Parallel locally-ordered clustering for bounding volume hierarchy construction"). Every round
compacts the clusters by a scan, so the tree never depends on which thread came first.

What plain PLOC does not bound is bounded here. Equal areas pair clusters whose positions differ in the lowest bit, so
that a million copies of one box make a balanced tree. A round that merges little, as on a strip of steadily growing
triangles where each cluster prefers the smaller side, is followed by one within short blocks, each of which must merge
a pair. After `round_limit` rounds every pair (2 i, 2 i + 1) merges, which bounds the height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....errors import SceneError
from ....native.structs import to_numpy

# Places to either side in which a cluster looks for its neighbour
_RADIUS = 16
# Rounds before pairs are forced; real scenes need 30 to 70
ROUND_LIMIT = 160
# Forced pairs need one round for each bit of the count
ROUND_COUNT_MAX = ROUND_LIMIT + 32
# A round that merges fewer than one cluster in so many is followed by one within blocks of CLUSTERS_OF_BLOCK
FEW_MERGES = 16
CLUSTERS_OF_BLOCK = 8
# The host reads the number of clusters after so many rounds: the wait would cost more than idle threads when there are
# few
ROUNDS_PER_READ = 6
CLUSTERS_LARGE = 1 << 20
# Threads that reduce the bounds; the host ends the reduction
BOUND_LANES = 2048
# Added to each side of a box before its area is taken, in units of the scaled scene. Stored boxes are grown by about as
# much, so that none is without area; and among flat or equal boxes, shorter ones and fewer nodes are still the cheaper
# ones.
SIDE_MIN = 2.0**-24

# Entries of the round state
COUNT, NODE, BLOCK, ROUND = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)


@wp.struct
class BinaryNodes:
    """Nodes of a binary tree: leaves [0, leaf_count) in Morton order, then inner nodes, children before parents."""

    low: wp.array(dtype=wp.vec3)  # least corner of each node's box [m], shape [2 * leaf_count - 1]
    high: wp.array(dtype=wp.vec3)  # greatest corner
    children: wp.array(dtype=wp.vec2i)  # of inner node `leaf_count + k` at k
    primitive: wp.array(dtype=int)  # which box a leaf is, shape [leaf_count]
    leaf_count: int
    scale: float  # power of two that brings the scene's extent to about 1, so that areas stay within float32


@wp.struct
class Clusters:
    """The clusters of one round, in Morton order."""

    node: wp.array(dtype=int)  # node of each cluster
    node_next: wp.array(dtype=int)  # the same after the round
    neighbour: wp.array(dtype=int)  # index of the cluster that each would merge with
    keep: wp.array(dtype=int)  # 0 for the second of a merging pair
    index_next: wp.array(dtype=int)  # exclusive sum of `keep`: index of each in the next round


@dataclass
class ClusterTree:
    """A tree on the device; the root is the last node."""

    nodes: BinaryNodes
    box: np.ndarray  # lowest and highest corner of everything [m], float32, shape [2, 3]
    round_count: int = 0  # of merging


@wp.func
def half_area(low: wp.vec3, high: wp.vec3, scale: float) -> float:
    """Half the surface of a box in units of the scaled scene, above 0."""
    d = (high - low) * scale + wp.vec3(SIDE_MIN, SIDE_MIN, SIDE_MIN)
    return d[0] * d[1] + d[1] * d[2] + d[2] * d[0]


@wp.kernel(**KERNEL_OPTIONS)
def triangle_boxes_kernel(
    positions: wp.array(dtype=wp.vec3),
    triangles: wp.array(dtype=wp.vec3i),
    triangle_first: int,
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
):
    """Box of each triangle."""
    i = wp.tid()
    triangle = triangles[triangle_first + i]
    a, b, c = positions[triangle[0]], positions[triangle[1]], positions[triangle[2]]
    low[i] = wp.min(wp.min(a, b), c)
    high[i] = wp.max(wp.max(a, b), c)
    # minimum and maximum may pass over what is not a number
    if not (wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)):
        low[i] = wp.vec3(-wp.inf, -wp.inf, -wp.inf)


@wp.kernel(**KERNEL_OPTIONS)
def bounds_kernel(
    low: wp.array(dtype=wp.vec3), high: wp.array(dtype=wp.vec3), lanes: int, bounds: wp.array2d(dtype=wp.vec3)
):
    """Row `lane` of `bounds`: the box of every `lanes`-th box, and that of their middles."""
    lane = wp.tid()
    first = wp.vec3(wp.inf, wp.inf, wp.inf)
    last = -first
    middle_first = wp.vec3(wp.inf, wp.inf, wp.inf)
    middle_last = -middle_first
    for i in range(lane, low.shape[0], lanes):
        a, b = wp.vec3(low[i]), wp.vec3(high[i])
        if not (wp.isfinite(a) and wp.isfinite(b)):
            a = wp.vec3(-wp.inf, -wp.inf, -wp.inf)
        middle = 0.5 * a + 0.5 * b
        first, last = wp.min(first, a), wp.max(last, b)
        middle_first, middle_last = wp.min(middle_first, middle), wp.max(middle_last, middle)
    bounds[lane, 0] = first
    bounds[lane, 1] = last
    bounds[lane, 2] = middle_first
    bounds[lane, 3] = middle_last


@wp.func
def spread_bits(x: wp.uint64) -> wp.uint64:
    """The low 21 bits of `x`, two zeros between each and the next."""
    x = (x | (x << wp.uint64(32))) & wp.uint64(0x001F00000000FFFF)
    x = (x | (x << wp.uint64(16))) & wp.uint64(0x001F0000FF0000FF)
    x = (x | (x << wp.uint64(8))) & wp.uint64(0x100F00F00F00F00F)
    x = (x | (x << wp.uint64(4))) & wp.uint64(0x10C30C30C30C30C3)
    return (x | (x << wp.uint64(2))) & wp.uint64(0x1249249249249249)


@wp.kernel(**KERNEL_OPTIONS)
def morton_kernel(
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    first: wp.vec3,
    extent: float,
    keys: wp.array(dtype=wp.uint64),
    order: wp.array(dtype=int),
):
    """63-bit Morton code of each box's middle within the cube of side `extent` at `first`."""
    i = wp.tid()
    key = wp.uint64(0)
    if extent > 0.0:
        point = (0.5 * low[i] + 0.5 * high[i] - first) / extent
        for axis in range(3):
            cell = wp.clamp(int(point[axis] * 2097152.0), 0, 2097151)
            key = key | (spread_bits(wp.uint64(cell)) << wp.uint64(2 - axis))
    keys[i] = key
    order[i] = i


@wp.kernel(**KERNEL_OPTIONS)
def leaves_kernel(
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=int),
    nodes: BinaryNodes,
    clusters: Clusters,
):
    """Leaves in Morton order, each a cluster."""
    i = wp.tid()
    primitive = order[i]
    nodes.primitive[i] = primitive
    nodes.low[i] = low[primitive]
    nodes.high[i] = high[primitive]
    clusters.node[i] = i


@wp.kernel(**KERNEL_OPTIONS)
def neighbour_kernel(nodes: BinaryNodes, clusters: Clusters, state: wp.array2d(dtype=int), parity: int):
    """Each cluster's best partner: least area, then least difference of index in the sense of exclusive or.

    Both are the same from either side, so that the best pair of all always chooses each other.
    """
    i = wp.tid()
    count = state[parity, COUNT]
    if i >= count:
        return
    first = wp.max(i - _RADIUS, 0)
    end = wp.min(i + _RADIUS + 1, count)
    block = state[parity, BLOCK]
    if block > 0:
        # the blocks of odd rounds are shifted by half, so that no border stays
        shift = (state[parity, ROUND] & 1) * (block / 4) * 2
        block_first = ((i + shift) / block) * block - shift
        first = wp.max(first, block_first)
        end = wp.min(end, block_first + block)
    node = clusters.node[i]
    low, high = nodes.low[node], nodes.high[node]
    best = int(-1)
    best_area = float(wp.inf)
    for j in range(first, end):
        if j != i:
            other = clusters.node[j]
            area = half_area(wp.min(low, nodes.low[other]), wp.max(high, nodes.high[other]), nodes.scale)
            if best < 0 or area < best_area or (area == best_area and (i ^ j) < (i ^ best)):
                best = j
                best_area = area
    clusters.neighbour[i] = best


@wp.kernel(**KERNEL_OPTIONS)
def keep_kernel(clusters: Clusters, state: wp.array2d(dtype=int), parity: int):
    """Marks of the clusters that go on: all but the second of each pair that merges."""
    i = wp.tid()
    keep = int(0)
    if i < state[parity, COUNT]:
        neighbour = clusters.neighbour[i]
        if neighbour < 0 or neighbour > i or clusters.neighbour[neighbour] != i:
            keep = 1
    clusters.keep[i] = keep


@wp.kernel(**KERNEL_OPTIONS)
def merge_kernel(nodes: BinaryNodes, clusters: Clusters, state: wp.array2d(dtype=int), parity: int, round_limit: int):
    """New nodes for the pairs that merge, clusters moved up, and the state of the next round."""
    i = wp.tid()
    count = state[parity, COUNT]
    if i >= count:
        return
    node_base = state[parity, NODE]
    if clusters.keep[i] == 1:
        node = clusters.node[i]
        neighbour = clusters.neighbour[i]
        if neighbour > i and clusters.neighbour[neighbour] == i:
            other = clusters.node[neighbour]
            # as many merged before as second ones stand before the second of this pair
            merged = node_base + neighbour - clusters.index_next[neighbour]
            nodes.children[merged - nodes.leaf_count] = wp.vec2i(node, other)
            nodes.low[merged] = wp.min(nodes.low[node], nodes.low[other])
            nodes.high[merged] = wp.max(nodes.high[node], nodes.high[other])
            node = merged
        clusters.node_next[clusters.index_next[i]] = node
    if i == count - 1:  # the last cluster knows how many are left
        left = clusters.index_next[i] + clusters.keep[i]
        merges = count - left
        number = state[parity, ROUND]
        if count > 1:
            number += 1
        block = int(0)
        if number >= round_limit or (merges == 0 and count > 1):
            block = 2
        elif merges * FEW_MERGES < count:
            block = CLUSTERS_OF_BLOCK
        state[1 - parity, COUNT] = left
        state[1 - parity, NODE] = node_base + merges
        state[1 - parity, BLOCK] = block
        state[1 - parity, ROUND] = number


CLUSTER_KERNELS = (
    triangle_boxes_kernel,
    bounds_kernel,
    morton_kernel,
    leaves_kernel,
    neighbour_kernel,
    keep_kernel,
    merge_kernel,
)


def triangle_boxes(positions: wp.array, triangles: wp.array, first: int, count: int) -> tuple[wp.array, wp.array]:
    """Boxes (low and high corners [m]) of triangles [first, first + count)."""
    device = positions.device
    low, high = (wp.empty(count, dtype=wp.vec3, device=device) for _ in range(2))
    wp.launch(triangle_boxes_kernel, count, [positions, triangles, first, low, high], device=device)
    return low, high


def sort_leaves(low: wp.array, high: wp.array) -> tuple[ClusterTree, Clusters]:
    """A tree without inner nodes over at least one box, whose leaves are in Morton order, and a cluster for each.

    `low` and `high` are the corners [m], wp.vec3. Raises `SceneError` where a coordinate is not finite.
    """
    count, device = low.size, low.device

    def empty(size: int, dtype=int) -> wp.array:
        return wp.empty(size, dtype=dtype, device=device)

    lanes = min(BOUND_LANES, count)
    partial = wp.empty((lanes, 4), dtype=wp.vec3, device=device)
    wp.launch(bounds_kernel, lanes, [low, high, lanes, partial], device=device)
    rows = to_numpy(partial)
    box = np.stack([rows[:, 0].min(0), rows[:, 1].max(0)])
    if not np.isfinite(box).all():
        raise SceneError(
            "a vertex has a coordinate that is not a finite number; remove it, or the triangles that use it"
        )
    middle_first, middle_last = rows[:, 2].min(0), rows[:, 3].max(0)

    keys, order = empty(2 * count, wp.uint64), empty(2 * count)
    extent = float((middle_last - middle_first).max())
    wp.launch(morton_kernel, count, [low, high, wp.vec3(*middle_first.tolist()), extent, keys, order], device=device)
    wp.utils.radix_sort_pairs(keys, order, count)
    del keys

    nodes = BinaryNodes()
    nodes.low, nodes.high = empty(2 * count - 1, wp.vec3), empty(2 * count - 1, wp.vec3)
    nodes.children = empty(count - 1, wp.vec2i)
    nodes.primitive = empty(count)
    nodes.leaf_count = count
    nodes.scale = _scale_of(box)
    clusters = Clusters()
    for name in ("node", "node_next", "neighbour", "keep", "index_next"):
        setattr(clusters, name, empty(count))
    wp.launch(leaves_kernel, count, [low, high, order, nodes, clusters], device=device)
    return ClusterTree(nodes, box), clusters


def _scale_of(box: np.ndarray) -> float:
    """The power of two that makes the largest side of `box` lie in [0.5, 1), as far as float32 has it."""
    side = float((box[1].astype(np.float64) - box[0]).max())
    exponent = int(np.frexp(side)[1]) if np.isfinite(side) and side > 0 else 0
    return 2.0 ** max(-126, min(126, -exponent))


def merge_leaves(tree: ClusterTree, clusters: Clusters, round_limit: int = ROUND_LIMIT) -> None:
    """Make the inner nodes of `tree`, whose `clusters` are its leaves; the height is at most `round_limit` and what a
    balanced tree has.
    """
    nodes = tree.nodes
    device, count = nodes.low.device, nodes.leaf_count
    start = np.zeros((2, 4), np.int32)
    start[0] = count, count, 2 if round_limit == 0 else 0, 0
    state = wp.array(start, dtype=int, device=device)
    parity, launched = 0, 0
    # rounds take turns in which array of clusters they read: each turn has structs and launches of its own
    turns = [(clusters, RepeatedLaunches(device)), (_other_turn(clusters), RepeatedLaunches(device))]
    while count > 1:
        if launched >= ROUND_COUNT_MAX:
            raise RuntimeError(f"the tree build did not end after {launched} rounds: {count} clusters are left")
        keep, index_next = clusters.keep[:count], clusters.index_next[:count]
        for _ in range(1 if count > CLUSTERS_LARGE else ROUNDS_PER_READ):
            own, launches = turns[parity]
            launches.launch(neighbour_kernel, count, nodes, own, state, parity)
            launches.launch(keep_kernel, count, own, state, parity)
            wp.utils.array_scan(keep, index_next, inclusive=False)
            launches.launch(merge_kernel, count, nodes, own, state, parity, round_limit)
            parity = 1 - parity
            launched += 1
        count, _, _, tree.round_count = to_numpy(state)[parity].tolist()


def _other_turn(clusters: Clusters) -> Clusters:
    """The same arrays for the rounds between, which read what `clusters` have written."""
    other = Clusters()
    other.node, other.node_next = clusters.node_next, clusters.node
    other.neighbour, other.keep, other.index_next = clusters.neighbour, clusters.keep, clusters.index_next
    return other
