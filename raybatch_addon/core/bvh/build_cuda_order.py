"""Boxes, heights and a bottom-up order of a binary tree on the device, whatever the numbers of its nodes.

One thread a leaf climbs; of two that meet in a node the second goes on, when both children have their boxes (Karras 2012,
"Maximizing parallelism in the construction of BVHs, octrees and k-d trees"). What is written does not depend on which it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .build_cuda_clusters import BinaryNodes

# Higher trees are given up; their bits are sorted
HEIGHT_BITS = 10


@wp.struct
class Links:
    """What climbing needs."""

    parent: wp.array(dtype=int)  # of each node; -1 of the root, shape [2 * leaf_count - 1]
    arrived: wp.array(dtype=int)  # children of each inner node that are done
    height: wp.array(dtype=int)  # of each inner node: 1 above leaves


@dataclass
class HeightOrder:
    """Inner nodes, the lowest first."""

    node: wp.array  # int32, shape [leaf_count - 1]
    first: list[int]  # place in `node` of the first of each height, then their count


@wp.kernel(**KERNEL_OPTIONS)
def parent_kernel(nodes: BinaryNodes, links: Links):
    """Parents from children."""
    k = wp.tid()
    node = nodes.leaf_count + k
    children = nodes.children[k]
    links.parent[children[0]] = node
    links.parent[children[1]] = node
    if k == nodes.leaf_count - 2:
        links.parent[node] = -1


@wp.func_native("""
#if defined(__CUDA_ARCH__)
// what other threads wrote is in the second-level cache, not in this one's first
auto load = [](const float* p) { return __ldcg(p); };
auto load_int = [](const int* p) { return __ldcg(p); };
auto arrive = [](int* p) { __threadfence(); const int before = atomicAdd(p, 1); __threadfence(); return before; };
#else
auto load = [](const float* p) { return *p; };
auto load_int = [](const int* p) { return *p; };
auto arrive = [](int* p) { return (*p)++; };
#endif
const int first = nodes.leaf_count;
for (int node = links.parent.data[leaf]; node >= 0; node = links.parent.data[node]) {
    const int k = node - first;
    if (arrive(links.arrived.data + k) == 0) return;
    const int a = nodes.children.data[k][0], b = nodes.children.data[k][1];
    const float *low_a = (const float*)(nodes.low.data + a), *low_b = (const float*)(nodes.low.data + b);
    const float *high_a = (const float*)(nodes.high.data + a), *high_b = (const float*)(nodes.high.data + b);
    float *low = (float*)(nodes.low.data + node), *high = (float*)(nodes.high.data + node);
    for (int axis = 0; axis < 3; ++axis) {
        const float l = load(low_a + axis), m = load(low_b + axis);
        low[axis] = l < m ? l : m;
        const float h = load(high_a + axis), i = load(high_b + axis);
        high[axis] = h > i ? h : i;
    }
    const int height_a = a < first ? 0 : load_int(links.height.data + a - first);
    const int height_b = b < first ? 0 : load_int(links.height.data + b - first);
    links.height.data[k] = 1 + (height_a > height_b ? height_a : height_b);
}
""")
def climb(nodes: BinaryNodes, links: Links, leaf: int): ...


@wp.kernel(**KERNEL_OPTIONS)
def refit_kernel(nodes: BinaryNodes, links: Links):
    """Boxes and heights of all inner nodes."""
    climb(nodes, links, wp.tid())


@wp.kernel(**KERNEL_OPTIONS)
def height_kernel(nodes: BinaryNodes, links: Links, keys: wp.array(dtype=int), order: wp.array(dtype=int)):
    """What is sorted."""
    k = wp.tid()
    keys[k] = links.height[k]
    order[k] = nodes.leaf_count + k


@wp.kernel(**KERNEL_OPTIONS)
def height_first_kernel(keys: wp.array(dtype=int), first: wp.array(dtype=int)):
    """Where each height begins among the sorted `keys`."""
    i = wp.tid()
    if i == 0:
        first[keys[0]] = 0
    elif keys[i] != keys[i - 1]:
        first[keys[i]] = i


ORDER_KERNELS = (parent_kernel, refit_kernel, height_kernel, height_first_kernel)


def find_parents(nodes: BinaryNodes) -> Links:
    """Links of a tree with at least one inner node."""
    device, count = nodes.low.device, nodes.leaf_count
    links = Links()
    links.parent = wp.empty(2 * count - 1, dtype=int, device=device)
    links.arrived, links.height = (wp.empty(count - 1, dtype=int, device=device) for _ in range(2))
    wp.launch(parent_kernel, count - 1, [nodes, links], device=device)
    return links


def refit(nodes: BinaryNodes, links: Links) -> None:
    """Make boxes and heights of inner nodes from their children's."""
    links.arrived.zero_()
    wp.launch(refit_kernel, nodes.leaf_count, [nodes, links], device=nodes.low.device)


def order_by_height(nodes: BinaryNodes, links: Links) -> HeightOrder | None:
    """Inner nodes by the heights of `links`; None for a tree too high."""
    device, count = nodes.low.device, nodes.leaf_count - 1
    highest = int(links.height[count - 1 :].numpy()[0])
    if highest >= 1 << HEIGHT_BITS:
        return None
    keys, order = (wp.empty(2 * count, dtype=int, device=device) for _ in range(2))
    wp.launch(height_kernel, count, [nodes, links, keys, order], device=device)
    wp.utils.radix_sort_pairs(keys, order, count, 0, HEIGHT_BITS)
    first = wp.empty(highest + 1, dtype=int, device=device)
    wp.launch(height_first_kernel, count, [keys, first], device=device)
    return HeightOrder(order[:count], [*first.numpy()[1:].tolist(), count])
