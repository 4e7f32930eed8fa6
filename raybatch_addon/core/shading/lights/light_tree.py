"""The tree over all emitters with a place, which the choice among them goes down.

Boxes of emitters are joined by the builders of the scene's trees, on the device; each node then gets the sphere, the
cone of directions and the power of what lies below it (Conty Estevez and Kulla 2018, section 4.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...bvh.build.binary import BuildOptions
from ...bvh.build.cpu.build import build_binary_from_boxes
from ...bvh.build.cuda.clusters import merge_leaves, sort_leaves
from ...bvh.build.cuda.order import find_parents, order_by_height, refit
from ...device.kernel import KERNEL_OPTIONS
from ...scene.geometry import Geometry, triangle_vertices
from .choice_table import WIDTH, ChoiceTable, LightNode

# Rounding of an angle whose cosine is stored [rad]
_ANGLE_ERROR = wp.constant(5.0e-4)


@wp.struct
class TreeNode:
    """A node of the binary tree."""

    held: LightNode  # where there are nodes below, without where these are
    first: int  # nodes below; -1: an emitter
    second: int


@wp.struct
class EmitterBoxes:
    """Emitters with a place, in the order of their numbers."""

    nodes: wp.array(dtype=LightNode)  # `below` says which
    low: wp.array(dtype=wp.vec3)  # least corner of each one's box [m]
    high: wp.array(dtype=wp.vec3)


@wp.struct
class Joints:
    """A binary tree over emitters: leaves [0, leaf_count) first, inner node `leaf_count + k` at k."""

    leaf_count: int
    low: wp.array(dtype=wp.vec3)  # of boxes of all nodes [m]
    high: wp.array(dtype=wp.vec3)
    children: wp.array(dtype=wp.vec2i)
    which: wp.array(dtype=int)  # which emitter a leaf is


@dataclass(frozen=True)
class _Topology:
    joints: Joints
    order: wp.array  # inner nodes, those below others first, int
    level_first: list[int]  # index in `order` of the first of each level, then their count
    root: int


@wp.struct
class EmittingTriangles:
    """Triangles that emit."""

    instance: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    power: wp.array(dtype=float)  # as `LightNode.power`
    emitter_first: int  # number of the first one among all emitters
    node_first: int  # and among those with a place


@wp.kernel(**KERNEL_OPTIONS)
def bound_triangles_kernel(geometry: Geometry, triangles: EmittingTriangles, boxes: EmitterBoxes):
    """Sphere, direction and box of each triangle."""
    i = wp.tid()
    a, b, c = triangle_vertices(geometry, triangles.instance[i], triangles.primitive[i])
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    node = LightNode()
    node.centre = 0.5 * low + 0.5 * high
    node.radius = wp.length(0.5 * high - 0.5 * low)
    normal = wp.cross(b - a, c - a)
    length = wp.length(normal)
    if length > 0.0 and length < wp.inf:
        node.axis = normal / length
        node.cos_axis = 1.0
        node.two_sided = wp.uint8(1)
    else:
        node.cos_axis = -1.0
    node.power = triangles.power[i]
    node.below = -1 - (triangles.emitter_first + i)
    at = triangles.node_first + i
    boxes.nodes[at] = node
    boxes.low[at] = low
    boxes.high[at] = high


@wp.kernel(**KERNEL_OPTIONS)
def place_leaves_kernel(boxes: EmitterBoxes, joints: Joints, nodes: wp.array(dtype=TreeNode)):
    """Emitters become leaves."""
    i = wp.tid()
    node = TreeNode()
    node.held = boxes.nodes[joints.which[i]]
    node.first = -1
    node.second = -1
    nodes[i] = node


@wp.func
def _any_direction(node: LightNode) -> LightNode:
    node.cos_axis = -1.0
    node.two_sided = wp.uint8(0)
    return node


@wp.func
def join_directions(node: LightNode, a: LightNode, b: LightNode) -> LightNode:
    """`node` with a cone that holds those of `a` and `b`, widened by what the cosine of a small angle is rounded by."""
    if a.power <= 0.0 or b.power <= 0.0:
        one = a
        if a.power <= 0.0:
            one = b
        node.axis = one.axis
        node.cos_axis = one.cos_axis
        node.cos_edge = one.cos_edge
        node.two_sided = one.two_sided
        return node
    node.cos_edge = wp.min(a.cos_edge, b.cos_edge)
    if a.cos_axis <= -1.0 or b.cos_axis <= -1.0 or a.two_sided != b.two_sided:
        return _any_direction(node)
    node.two_sided = a.two_sided
    other = b.axis
    cosine = wp.dot(a.axis, other)
    if a.two_sided != wp.uint8(0) and cosine < 0.0:
        other = -other
    half_a = wp.acos(a.cos_axis)
    half_b = wp.acos(b.cos_axis)
    between = 2.0 * wp.atan2(wp.length(a.axis - other), wp.length(a.axis + other))
    if between + half_b <= half_a:
        node.axis = a.axis
        node.cos_axis = wp.cos(wp.min(half_a + _ANGLE_ERROR, wp.PI))
        return node
    if between + half_a <= half_b:
        node.axis = b.axis
        node.cos_axis = wp.cos(wp.min(half_b + _ANGLE_ERROR, wp.PI))
        return node
    half = 0.5 * (half_a + between + half_b) + _ANGLE_ERROR
    across = other - wp.dot(other, a.axis) * a.axis
    length = wp.length(across)
    if half >= wp.PI or length <= 0.0:
        return _any_direction(node)
    turn = half - half_a
    node.axis = wp.normalize(wp.cos(turn) * a.axis + (wp.sin(turn) / length) * across)
    node.cos_axis = wp.cos(half)
    return node


@wp.kernel(**KERNEL_OPTIONS)
def join_kernel(joints: Joints, order: wp.array(dtype=int), first: int, nodes: wp.array(dtype=TreeNode)):
    """Inner nodes of one level, from the two below each."""
    number = order[first + wp.tid()]
    children = joints.children[number - joints.leaf_count]
    a = nodes[children[0]]
    b = nodes[children[1]]
    held = LightNode()
    low = joints.low[number]
    high = joints.high[number]
    held.centre = 0.5 * low + 0.5 * high
    held.radius = wp.length(0.5 * high - 0.5 * low)
    held.power = a.held.power + b.held.power
    node = TreeNode()
    node.held = join_directions(held, a.held, b.held)
    node.first = children[0]
    node.second = children[1]
    nodes[number] = node


@wp.struct
class Level:
    """Inner nodes of the binary tree that become nodes of the wide one, at the same distance from its root."""

    node: wp.array(dtype=int)
    place: wp.array(dtype=int)  # in the wide tree; -1: the whole of it
    count: wp.array(dtype=int)  # of entries, shape [1]


@wp.kernel(**KERNEL_OPTIONS)
def widen_kernel(
    nodes: wp.array(dtype=TreeNode), level: Level, following: Level, choice: ChoiceTable, used: wp.array(dtype=int)
):
    """Give each node of a level up to `WIDTH` nodes below it: of those that are open, the one of the most power over
    the widest sphere is replaced by its two, again and again. `used` counts places of the wide tree.
    """
    i = wp.tid()
    open = wp.zeros(wp.static(WIDTH), dtype=int)
    open[0] = level.node[i]
    found = int(1)
    going = bool(True)
    while going and found < wp.static(WIDTH):
        widest = int(-1)
        extent = float(-1.0)
        for k in range(found):
            node = nodes[open[k]]
            if node.first >= 0 and node.held.power * node.held.radius > extent:
                widest = k
                extent = node.held.power * node.held.radius
        if widest < 0:
            going = False
        else:
            node = nodes[open[widest]]
            open[widest] = node.first
            open[found] = node.second
            found = found + 1
    base = wp.atomic_add(used, 0, found)
    place = level.place[i]
    if place >= 0:
        above = choice.nodes[place]
        above.below = base
        above.count = wp.uint8(found)
        choice.nodes[place] = above
    for k in range(found):
        node = nodes[open[k]]
        choice.nodes[base + k] = node.held
        choice.parent[base + k] = place
        if node.first < 0:
            choice.leaf[-1 - node.held.below] = base + k
        else:
            entry = wp.atomic_add(following.count, 0, 1)
            following.node[entry] = open[k]
            following.place[entry] = base + k


LIGHT_TREE_KERNELS = (bound_triangles_kernel, place_leaves_kernel, join_kernel, widen_kernel)


def fill_nodes(choice: ChoiceTable, boxes: EmitterBoxes) -> None:
    """Fill in the nodes of `choice`, whose emitters with a place are `boxes`, and their entries of `leaf`."""
    count, device = boxes.nodes.size, boxes.nodes.device
    choice.parent = wp.full(2 * count, -1, dtype=int, device=device)
    if count <= WIDTH:
        choice.nodes, choice.root_count = boxes.nodes, count
        emitters = -1 - boxes.nodes.numpy()["below"]
        leaf = choice.leaf.numpy()
        leaf[emitters] = np.arange(count)
        choice.leaf = wp.array(leaf, dtype=int, device=device)
        return
    topology = _built_on_cuda(boxes) if device.is_cuda else _built_on_cpu(boxes)
    joints, order = topology.joints, topology.order
    nodes = wp.empty(joints.low.size, dtype=TreeNode, device=device)
    wp.launch(place_leaves_kernel, count, [boxes, joints, nodes], device=device)
    for first, end in zip(topology.level_first[:-1], topology.level_first[1:]):
        wp.launch(join_kernel, end - first, [joints, order, first, nodes], device=device)
    _widen(choice, nodes, topology.root)


def _widen(choice: ChoiceTable, nodes: wp.array, root: int) -> None:
    """Where a node lies depends on the order of threads; what is chosen does not."""
    device = nodes.device
    choice.nodes = wp.empty(nodes.size, dtype=LightNode, device=device)
    used = wp.zeros(1, dtype=int, device=device)

    def level_of(size: int) -> Level:
        level = Level()
        level.node, level.place = (wp.full(size, root - k * (root + 1), dtype=int, device=device) for k in range(2))
        level.count = wp.zeros(1, dtype=int, device=device)
        return level

    level, count = level_of(1), 1
    while count:
        following = level_of(count * WIDTH)
        wp.launch(widen_kernel, count, [nodes, level, following, choice, used], device=device)
        level, count = following, int(following.count.numpy()[0])
        choice.root_count = choice.root_count or int(used.numpy()[0])


def _joints(low: wp.array, high: wp.array, children: wp.array, which: wp.array) -> Joints:
    joints = Joints()
    joints.leaf_count = which.size
    joints.low, joints.high, joints.children, joints.which = low, high, children, which
    return joints


def _built_on_cuda(boxes: EmitterBoxes) -> _Topology:
    tree, clusters = sort_leaves(boxes.low, boxes.high)
    merge_leaves(tree, clusters)
    nodes = tree.nodes
    links = find_parents(nodes)
    refit(nodes, links)
    heights = order_by_height(nodes, links)
    if heights is None:
        raise RuntimeError("the tree of emitters is too high, though merging bounds its height")
    joints = _joints(nodes.low, nodes.high, nodes.children, nodes.primitive)
    return _Topology(joints, heights.node, heights.first, 2 * nodes.leaf_count - 2)


def _built_on_cpu(boxes: EmitterBoxes) -> _Topology:
    built = build_binary_from_boxes(boxes.low.numpy(), boxes.high.numpy(), BuildOptions(leaf_group=1, leaf_max=1))
    below, size = built.links
    leaves, inner = np.flatnonzero(size > 0), np.flatnonzero(size == 0)
    number = np.empty(len(size), np.int32)  # of each node here
    number[leaves] = np.arange(len(leaves))
    number[inner] = len(leaves) + np.arange(len(inner))
    rows = built.nodes[np.concatenate([leaves, inner])]
    children = number[np.stack([below[inner], below[inner] + 1], 1)]
    levels, level = [], np.zeros(1, np.int64)
    while len(level := level[size[level] == 0]):
        levels.append(number[level])
        level = np.concatenate([below[level], below[level] + 1]).astype(np.int64)
    levels.reverse()
    firsts = np.cumsum([0, *map(len, levels)]).tolist()

    def upload(values: np.ndarray, dtype) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu")

    low, high = upload(rows[:, :3], wp.vec3), upload(rows[:, 4:7], wp.vec3)
    joints = _joints(low, high, upload(children, wp.vec2i), upload(built.references[below[leaves]], int))
    return _Topology(joints, upload(np.concatenate(levels), int), firsts, int(number[0]))
