"""Kernels of the tree over all emitters with a place, which the choice among them goes down.

Boxes of emitters are joined by the builders of the scene's trees, on the device; each node then gets the sphere, the
cone of directions and the power of what lies below it (Conty Estevez and Kulla 2018, section 4.1).
"""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....scene.geometry import Geometry, triangle_vertices
from ..choice_table import BLOCK_WIDTH, FIELDS, ChoiceTable
from .joints import Joints, widen_leaves_kernel

# Where the numbers of a block of one kind begin
_ROWS = {name: place * BLOCK_WIDTH for place, name in enumerate(FIELDS)}
# Nodes that are compared as fast as fewer, on a CPU
_FEW = wp.constant(4)
# Rounding of an angle whose cosine is stored [rad]
_ANGLE_ERROR = wp.constant(5.0e-4)


@wp.struct
class LightNode:
    """A node of the light tree, with all that shines below it: one emitter, or two nodes. Units as of `FIELDS`."""

    centre: wp.vec3
    radius: float
    axis: wp.vec3
    cos_axis: float
    cos_edge: float
    two_sided: int
    power: float
    emitter: int


@wp.struct
class TreeNode:
    """A node of the binary tree."""

    held: LightNode
    first: int  # nodes below; -1: an emitter
    second: int
    count: int  # emitters


@wp.struct
class EmitterBoxes:
    """Emitters with a place, in the order of their numbers."""

    nodes: wp.array(dtype=LightNode)
    low: wp.array(dtype=wp.vec3)  # least corner of each one's box [m]
    high: wp.array(dtype=wp.vec3)


@wp.struct
class EmittingTriangles:
    """Triangles that emit."""

    instance: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    power: wp.array(dtype=float)  # as `LightNode.power`
    emitter_first: int  # number of the first one among all emitters
    node_first: int  # and among those with a place


@wp.kernel(**KERNEL_OPTIONS)
def bound_triangles_kernel(geometry: Geometry, triangles: EmittingTriangles, boxes: EmitterBoxes, first: int):
    """Sphere, direction and box of each triangle from `first` on."""
    i = first + wp.tid()
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
        node.two_sided = 1
    else:
        node.cos_axis = -1.0
    node.power = triangles.power[i]
    node.emitter = triangles.emitter_first + i
    at = triangles.node_first + i
    boxes.nodes[at] = node
    boxes.low[at] = low
    boxes.high[at] = high


@wp.kernel(**KERNEL_OPTIONS)
def place_leaves_kernel(boxes: EmitterBoxes, joints: Joints, first: int, nodes: wp.array(dtype=TreeNode)):
    """Emitters from `first` on become leaves."""
    i = first + wp.tid()
    emitter = joints.which[i]
    joints.low[i] = boxes.low[emitter]
    joints.high[i] = boxes.high[emitter]
    node = TreeNode()
    node.held = boxes.nodes[emitter]
    node.first = -1
    node.second = -1
    node.count = 1
    nodes[i] = node


@wp.func
def _any_direction(node: LightNode) -> LightNode:
    node.cos_axis = -1.0
    node.two_sided = 0
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
    if a.two_sided != 0 and cosine < 0.0:
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
    low = wp.min(joints.low[children[0]], joints.low[children[1]])
    high = wp.max(joints.high[children[0]], joints.high[children[1]])
    joints.low[number] = low
    joints.high[number] = high
    held.centre = 0.5 * low + 0.5 * high
    held.radius = wp.length(0.5 * high - 0.5 * low)
    held.power = a.held.power + b.held.power
    node = TreeNode()
    node.held = join_directions(held, a.held, b.held)
    node.first = children[0]
    node.second = children[1]
    node.count = a.count + b.count
    nodes[number] = node


@wp.struct
class LightBlocks:
    """The binary tree made wide: inner nodes whose successors fill a block."""

    nodes: wp.array(dtype=TreeNode)
    leaf_count: int
    root: int  # its topmost node
    block_node: wp.array(dtype=int)  # inner node of each block, those nearer to the root first
    block_of: wp.array(dtype=int)  # block of each inner node
    block_count: wp.array(dtype=int)  # shape [1]


@wp.func
def _extent(tree: LightBlocks, node: int) -> float:
    """How much is gained where `node` is replaced by its two; -1: an emitter."""
    if node < tree.leaf_count:
        return -1.0
    held = tree.nodes[node].held
    return held.power * held.radius


@wp.func
def _open(tree: LightBlocks, node: int, open: wp.array(dtype=int), extents: wp.array(dtype=float)) -> int:
    """Write up to `BLOCK_WIDTH` nodes that hold all emitters below `node` to `open`; their number. Of those that are
    open the one of the most power over the widest sphere is replaced by its two, again and again. `extents` has as many
    entries. Below the top, what fits into one block stays together once a few nodes are open: else most blocks would
    hold two or three emitters.
    """
    to_the_end = node == tree.root or tree.nodes[node].count <= wp.static(BLOCK_WIDTH)
    open[0] = node
    extents[0] = _extent(tree, node)
    count = int(1)
    going = bool(True)
    while going and count < wp.static(BLOCK_WIDTH):
        widest = int(-1)
        extent = float(-1.0)
        for k in range(count):
            is_large = to_the_end or count < _FEW or tree.nodes[open[k]].count > wp.static(BLOCK_WIDTH)
            if is_large and extents[k] > extent:
                widest = k
                extent = extents[k]
        if widest < 0:
            going = False
        else:
            parted = open[widest]
            open[widest] = tree.nodes[parted].first
            open[count] = tree.nodes[parted].second
            extents[widest] = _extent(tree, open[widest])
            extents[count] = _extent(tree, open[count])
            count = count + 1
    return count


@wp.kernel(**KERNEL_OPTIONS)
def find_blocks_kernel(tree: LightBlocks, first: int):
    """Give a block to each inner node right below the blocks from `first` on. Which number it gets depends on the order
    of threads; what is chosen does not depend on it.
    """
    open = wp.zeros(wp.static(BLOCK_WIDTH), dtype=int)
    extents = wp.zeros(wp.static(BLOCK_WIDTH), dtype=float)
    count = _open(tree, tree.block_node[first + wp.tid()], open, extents)
    for k in range(count):
        if open[k] >= tree.leaf_count:
            block = wp.atomic_add(tree.block_count, 0, 1)
            tree.block_node[block] = open[k]
            tree.block_of[open[k] - tree.leaf_count] = block


@wp.func
def _write_node(choice: ChoiceTable, block: int, k: int, held: LightNode):
    at = block * wp.static(BLOCK_WIDTH * len(FIELDS)) + k
    choice.blocks[at + wp.static(_ROWS["x"])] = held.centre[0]
    choice.blocks[at + wp.static(_ROWS["y"])] = held.centre[1]
    choice.blocks[at + wp.static(_ROWS["z"])] = held.centre[2]
    choice.blocks[at + wp.static(_ROWS["radius"])] = held.radius
    choice.blocks[at + wp.static(_ROWS["axis_x"])] = held.axis[0]
    choice.blocks[at + wp.static(_ROWS["axis_y"])] = held.axis[1]
    choice.blocks[at + wp.static(_ROWS["axis_z"])] = held.axis[2]
    choice.blocks[at + wp.static(_ROWS["cos_axis"])] = held.cos_axis
    choice.blocks[at + wp.static(_ROWS["sin_axis"])] = wp.sqrt(wp.max(1.0 - held.cos_axis * held.cos_axis, 0.0))
    choice.blocks[at + wp.static(_ROWS["cos_edge"])] = held.cos_edge
    choice.blocks[at + wp.static(_ROWS["two_sided"])] = float(held.two_sided)
    choice.blocks[at + wp.static(_ROWS["power"])] = held.power


@wp.func
def _write_leaf(choice: ChoiceTable, block: int, k: int, held: LightNode):
    _write_node(choice, block, k, held)
    choice.below[block * wp.static(BLOCK_WIDTH) + k] = -1 - held.emitter
    choice.leaf[held.emitter] = block * wp.static(BLOCK_WIDTH) + k


@wp.kernel(**KERNEL_OPTIONS)
def fill_blocks_kernel(tree: LightBlocks, choice: ChoiceTable, first: int):
    """Nodes of the blocks from `first` on."""
    block = first + wp.tid()
    open = wp.zeros(wp.static(BLOCK_WIDTH), dtype=int)
    extents = wp.zeros(wp.static(BLOCK_WIDTH), dtype=float)
    count = _open(tree, tree.block_node[block], open, extents)
    for k in range(count):
        held = tree.nodes[open[k]].held
        if open[k] < tree.leaf_count:
            _write_leaf(choice, block, k, held)
        else:
            _write_node(choice, block, k, held)
            lower = tree.block_of[open[k] - tree.leaf_count]
            choice.below[block * wp.static(BLOCK_WIDTH) + k] = lower
            choice.above[lower] = block * wp.static(BLOCK_WIDTH) + k


@wp.kernel(**KERNEL_OPTIONS)
def fill_block_kernel(boxes: EmitterBoxes, choice: ChoiceTable):
    """Few emitters, in the only block."""
    k = wp.tid()
    _write_leaf(choice, 0, k, boxes.nodes[k])


LIGHT_TREE_KERNELS = (
    widen_leaves_kernel,
    bound_triangles_kernel,
    place_leaves_kernel,
    join_kernel,
    find_blocks_kernel,
    fill_blocks_kernel,
    fill_block_kernel,
)
