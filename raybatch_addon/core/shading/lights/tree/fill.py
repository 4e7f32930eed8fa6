"""The tree over all emitters with a place, filled into the blocks that the choice among them reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import warp as wp

from ....device.bulk import in_slices, large_empty
from ....device.devices import load_module
from ....device.launches import RepeatedLaunches
from ....native.structs import to_numpy
from ..choice_table import BLOCK_WIDTH, FIELDS, ChoiceTable
from ..tree.kernels import (
    EmitterBoxes,
    LightBlocks,
    TreeNode,
    fill_block_kernel,
    fill_blocks_kernel,
    find_blocks_kernel,
    join_kernel,
    place_leaves_kernel,
)
from .topology import Alike, Topology, topology_on_cpu, topology_on_cuda

# Items that are worth a thread of the CPU
_ITEMS_A_THREAD = 1 << 16
# Inner nodes from which on threads of a CPU look for blocks side by side, and how many one of them takes at a time
_NODES_APART, _NODES_TOGETHER = 512, 16
# Nodes of the top between whose spheres there is less than this part of the extent of all are hidden together, about
_NEAR = 0.1


def fill_blocks(choice: ChoiceTable, boxes: EmitterBoxes, alike: Sequence[Alike] = ()) -> None:
    """Fill in the blocks of `choice`, whose emitters with a place are `boxes`, and their entries of `leaf`.

    `alike`: runs of emitters that a CPU joins alike.
    """
    count, device = boxes.nodes.size, boxes.nodes.device
    if count <= BLOCK_WIDTH:
        _allocate(choice, 1, device)
        if count:
            wp.launch(fill_block_kernel, count, [boxes, choice], device=device)
        _group(choice)
        return
    if device.is_cuda:
        topology = topology_on_cuda(boxes.low, boxes.high)
    else:
        topology = topology_on_cpu(to_numpy(boxes.low), to_numpy(boxes.high), alike)
    tree = LightBlocks()
    tree.leaf_count, tree.root = count, topology.root
    tree.nodes = _joined(topology, boxes)
    tree.block_of = wp.zeros(count - 1, dtype=int, device=device)
    block_count = _find_blocks(tree)
    _allocate(choice, block_count, device)
    launch_parts(fill_blocks_kernel, block_count, lambda at: [tree, choice, at], device)
    _group(choice)


def _joined(topology: Topology, boxes: EmitterBoxes) -> wp.array:
    """All nodes of the tree over `boxes`, `TreeNode`."""
    joints, order, device = topology.joints, topology.order, boxes.nodes.device
    nodes = large_empty(joints.low.size, TreeNode, device)
    for kernel in (place_leaves_kernel, join_kernel):
        load_module(kernel, device)  # before threads

    def join(part: slice) -> None:
        launches = RepeatedLaunches(device)
        for each in topology.subtrees[part]:
            launches.launch(place_leaves_kernel, each.leaf_count, boxes, joints, each.leaf_first, nodes)
            for first, end in pairwise(each.level_first):
                launches.launch(join_kernel, end - first, joints, order, first, nodes)

    in_slices(len(topology.subtrees), join, 1)
    for begin, end in topology.leaves:
        launch_parts(
            place_leaves_kernel, end - begin, lambda at, first=begin: [boxes, joints, first + at, nodes], device
        )
    for begin, end in pairwise(topology.level_first):
        launch_parts(join_kernel, end - begin, lambda at, first=begin: [joints, order, first + at, nodes], device)
    return nodes


def _find_blocks(tree: LightBlocks) -> int:
    """Fill in which blocks `tree` has; their number."""
    device, most = tree.nodes.device, tree.leaf_count
    found, first, end = _go_down(tree, np.array([tree.root], np.int32), _NODES_APART if device.is_cpu else most)
    if first == end:
        tree.block_node = found.block_node
        return end
    # threads of a CPU go on side by side, and count by themselves
    parts = np.array_split(to_numpy(found.block_node)[first:end], _NODES_APART // _NODES_TOGETHER)
    lower: list[np.ndarray] = [parts[0]] * len(parts)

    def go_on(which: slice) -> None:
        for k in range(which.start, which.stop):
            below, _, last = _go_down(tree, parts[k], most)
            lower[k] = to_numpy(below.block_node)[len(parts[k]) : last].copy()

    in_slices(len(parts), go_on, 1)
    blocks, block_of = [to_numpy(found.block_node)[:end], *lower], to_numpy(tree.block_of)
    for nodes in lower:
        block_of[nodes - tree.leaf_count] = np.arange(end, end + len(nodes))
        end += len(nodes)
    tree.block_node = wp.array(np.concatenate(blocks), dtype=int, device=device, copy=False)
    return end


def _go_down(tree: LightBlocks, begin: np.ndarray, enough: int) -> tuple[LightBlocks, int, int]:
    """The blocks of `tree` at and below the inner nodes `begin`, down to a level of `enough` or more; and the first
    block of that level, and behind its last one.
    """
    device, found = tree.nodes.device, LightBlocks()
    found.nodes, found.leaf_count, found.root, found.block_of = tree.nodes, tree.leaf_count, tree.root, tree.block_of
    most = tree.leaf_count - 1
    found.block_node = wp.array(begin, dtype=int, device=device)
    found.block_count = wp.array([len(begin)], dtype=int, device=device)
    first, end = 0, len(begin)
    while 0 < end - first < enough:
        needed = min(end + BLOCK_WIDTH * (end - first), most)
        if found.block_node.size < needed:
            # threads of a CPU go down side by side, each with room for little more than its part
            room = large_empty(min(2 * needed, most) if device.is_cpu else most, int, device)
            wp.copy(room, found.block_node, count=end)
            found.block_node = room
        wp.launch(find_blocks_kernel, end - first, [found, first], device=device)
        first, end = end, int(to_numpy(found.block_count)[0])
    return found, first, end


def launch_parts(kernel: wp.Kernel, count: int, inputs: Callable[[int], list], device: wp.Device) -> None:
    """Launch `kernel` for `count` items; its `inputs` name the first one. A launch on the CPU runs on one thread, so
    many items are parted.
    """
    if not device.is_cpu:
        wp.launch(kernel, count, inputs(0), device=device)
        return
    load_module(kernel, device)

    def launch(part: slice) -> None:
        wp.launch(kernel, part.stop - part.start, inputs(part.start), device=device)

    in_slices(count, launch, _ITEMS_A_THREAD)


def _allocate(choice: ChoiceTable, block_count: int, device: wp.Device) -> None:
    choice.blocks = large_empty(block_count * BLOCK_WIDTH * len(FIELDS), float, device, zeros=True)
    choice.below = wp.full(block_count * BLOCK_WIDTH, -1, dtype=int, device=device)
    choice.above = wp.full(block_count, -1, dtype=int, device=device)


def _group(choice: ChoiceTable) -> None:
    """Find the groups of the topmost nodes of `choice`, whose blocks are filled in."""
    top = to_numpy(choice.blocks[: BLOCK_WIDTH * len(FIELDS)])
    groups, there = top_groups(top)
    choice.hidden_with = wp.array(groups, dtype=int, device=choice.blocks.device)
    choice.group_count, choice.top_count = len(np.unique(groups[there])), len(there)


def top_groups(fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The groups of nodes of the topmost block that are near each other, or near to what is: the first node of each
    one's group, int32, shape [BLOCK_WIDTH]; and which nodes there are, int, shape [n].

    `fields`: the block's part of `ChoiceTable.blocks`, float32, shape [FIELDS * BLOCK_WIDTH].
    """
    rows = dict(zip(FIELDS, fields.astype(np.float64).reshape(len(FIELDS), BLOCK_WIDTH)))
    there = np.flatnonzero(rows["power"] > 0)
    centre = np.stack([rows[axis][there] for axis in "xyz"], 1)
    radius = rows["radius"][there]
    apart = np.linalg.norm(centre[:, None] - centre, axis=2)
    reach = radius[:, None] + radius
    near = apart - reach <= _NEAR * (apart + reach).max(initial=0)
    for k in range(len(there)):
        near |= near[:, k, None] & near[k]
    group = np.arange(BLOCK_WIDTH, dtype=np.int32)
    if len(there):
        group[there] = there[near.argmax(1)]
    return group, there
