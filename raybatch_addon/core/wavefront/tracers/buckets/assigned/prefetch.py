"""Treelets are asked for before rays visit them."""

from __future__ import annotations

import numpy as np
import warp as wp

from .....bvh.treelets.tree import TreeletTree
from .....device.kernel import KERNEL_OPTIONS
from .....native.build import native_source

# Threads that ask for a treelet on CUDA; a CPU has one
_THREADS = 64


@wp.func_native(native_source("prefetch/block.h"))
def ask_for(address: wp.uint64, bytes: wp.int64, first: int, stride: int):
    """Ask for a block of memory (`prefetch/block.h`)."""


@wp.kernel(**KERNEL_OPTIONS)
def prefetch_kernel(
    treelets: wp.array(dtype=int),
    nodes: wp.array(dtype=wp.uint64),
    triangles: wp.array(dtype=wp.uint64),
    node_bytes: wp.array(dtype=wp.int64),
    triangle_bytes: wp.array(dtype=wp.int64),
    stride: int,
):
    """Ask for nodes and triangles of treelets; `stride` threads for each."""
    i, first = wp.tid()
    treelet = treelets[i]
    ask_for(nodes[treelet], node_bytes[treelet], first, stride)
    ask_for(triangles[treelet], triangle_bytes[treelet], first, stride)


class TreeletPrefetch:
    """Asks for the treelets that are likely next, while rays visit others: those of the fullest buckets that are not
    served now, as many as are (the thesis's 6.6; Lee, Lakshminarayana, Kim and Vuduc 2010, "Many-thread aware
    prefetching mechanisms for GPGPU applications", on when that helps and when it harms).
    """

    def __init__(self, treelet_tree: TreeletTree):
        """Of a tree whose treelets are all in memory."""
        treelets, words = treelet_tree.treelets, treelet_tree.layout
        self._treelets, self._device, self._count = treelets, treelets.nodes.device, treelet_tree.treelet_count
        self._threads = _THREADS if self._device.is_cuda else 1
        below = np.maximum(treelet_tree.treelet_sizes - 1, 0)  # the root lies elsewhere, and is always there
        self._bytes = [
            wp.array(4 * each, dtype=wp.int64, device=self._device)
            for each in (words.node_words * below, words.triangle_words * treelet_tree.treelet_units)
        ]

    def ask(self, entering: np.ndarray, served: np.ndarray) -> np.ndarray:
        """Ask for treelets by the rays that wait to enter them, `entering` [buckets], where the buckets `served` are
        served; which.
        """
        others = entering[: self._count].copy()
        others[served[served < self._count]] = 0
        filled = np.flatnonzero(others)
        likely = filled[np.argsort(-others[filled], kind="stable")][: len(served)]
        if len(likely):
            listed = wp.array(likely.astype(np.int32), dtype=int, device=self._device)
            blocks = self._treelets.nodes, self._treelets.triangles
            inputs = [listed, *blocks, *self._bytes, self._threads]
            wp.launch(prefetch_kernel, (len(likely), self._threads), inputs, device=self._device)
        return likely
