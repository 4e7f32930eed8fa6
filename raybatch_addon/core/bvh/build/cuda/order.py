"""Boxes, heights and a bottom-up order of a binary tree on the device, whatever the numbers of its nodes.

One thread a leaf climbs; of two that meet in a node the second goes on, when both children have their boxes (Karras
2012, "Maximizing parallelism in the construction of BVHs, octrees and k-d trees"). What is written does not depend on
which it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....native.build import native_source
from ....native.structs import to_numpy
from .clusters import BinaryNodes

# Higher trees are given up; their bits are sorted
HEIGHT_BITS = 10


@wp.struct
class ParentLinks:
    """Arrays that climbing from leaves to the root needs."""

    parent: wp.array(dtype=int)  # of each node; -1 of the root, shape [2 * leaf_count - 1]
    arrived: wp.array(dtype=int)  # children of each inner node that are done
    height: wp.array(dtype=int)  # of each inner node: 1 above leaves


@dataclass
class HeightOrder:
    """Inner nodes by height, the lowest first."""

    node: wp.array  # int32, shape [leaf_count - 1]
    first: list[int]  # index in `node` of the first of each height, then their count


@wp.kernel(**KERNEL_OPTIONS)
def parent_kernel(nodes: BinaryNodes, links: ParentLinks):
    """Parents from children."""
    k = wp.tid()
    node = nodes.leaf_count + k
    children = nodes.children[k]
    links.parent[children[0]] = node
    links.parent[children[1]] = node
    if k == nodes.leaf_count - 2:
        links.parent[node] = -1


@wp.func_native(native_source("binary/climb.h"))
def climb(nodes: BinaryNodes, links: ParentLinks, leaf: int): ...


@wp.kernel(**KERNEL_OPTIONS)
def refit_kernel(nodes: BinaryNodes, links: ParentLinks):
    """Boxes and heights of all inner nodes."""
    climb(nodes, links, wp.tid())


@wp.kernel(**KERNEL_OPTIONS)
def height_kernel(nodes: BinaryNodes, links: ParentLinks, keys: wp.array(dtype=int), order: wp.array(dtype=int)):
    """Heights as keys of a sort, and the nodes that have them."""
    k = wp.tid()
    keys[k] = links.height[k]
    order[k] = nodes.leaf_count + k


@wp.kernel(**KERNEL_OPTIONS)
def run_first_kernel(keys: wp.array(dtype=int), first: wp.array(dtype=int)):
    """First index of each number among the sorted `keys`."""
    i = wp.tid()
    if i == 0:
        first[keys[0]] = 0
    elif keys[i] != keys[i - 1]:
        first[keys[i]] = i


ORDER_KERNELS = (parent_kernel, refit_kernel, height_kernel, run_first_kernel)


def find_parents(nodes: BinaryNodes) -> ParentLinks:
    """Links of a tree with at least one inner node."""
    device, count = nodes.low.device, nodes.leaf_count
    links = ParentLinks()
    links.parent = wp.empty(2 * count - 1, dtype=int, device=device)
    links.arrived, links.height = (wp.empty(count - 1, dtype=int, device=device) for _ in range(2))
    wp.launch(parent_kernel, count - 1, [nodes, links], device=device)
    return links


def refit(nodes: BinaryNodes, links: ParentLinks) -> None:
    """Make boxes and heights of inner nodes from their children's."""
    links.arrived.zero_()
    wp.launch(refit_kernel, nodes.leaf_count, [nodes, links], device=nodes.low.device)


def order_by_height(nodes: BinaryNodes, links: ParentLinks) -> HeightOrder | None:
    """Inner nodes by the heights of `links`; None for a tree too high."""
    device, count = nodes.low.device, nodes.leaf_count - 1
    highest = int(to_numpy(links.height[count - 1 :])[0])
    if highest >= 1 << HEIGHT_BITS:
        return None
    keys, order = (wp.empty(2 * count, dtype=int, device=device) for _ in range(2))
    wp.launch(height_kernel, count, [nodes, links, keys, order], device=device)
    wp.utils.radix_sort_pairs(keys, order, count, 0, HEIGHT_BITS)
    first = wp.empty(highest + 1, dtype=int, device=device)
    wp.launch(run_first_kernel, count, [keys, first], device=device)
    return HeightOrder(order[:count], [*to_numpy(first)[1:].tolist(), count])
