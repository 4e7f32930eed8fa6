"""Counters of traversals, for those that are compiled with them.

A tracer that lets rays wait works on a ray in several launches: the first sets its counts to 0, each adds to them, and
they hold when the ray is finished.
"""

from __future__ import annotations

import warp as wp

# Pairs of `TraceCounts.lanes`
LANE_PARTS = ("turns", "nodes", "triangles")


@wp.struct
class TraceCounts:
    """Written by traversals: of each ray up to its end, and of the lanes of warps."""

    node_steps: wp.array(dtype=int)  # nodes visited, by ray slot
    box_tests: wp.array(dtype=int)  # child boxes tested, by ray slot; empty places of a node do not count
    triangle_tests: wp.array(dtype=int)  # triangles tested, by ray slot
    # of tracers that batch; otherwise without entries
    treelet_visits: wp.array(dtype=int)  # treelets entered with their triangles there, by ray slot
    queued: wp.array(dtype=int)  # times put into a queue, by ray slot
    # Added up over all warps (CUDA), int64: lanes that had a ray, and lanes there were, in each turn of the loop; lanes
    # that visited a node, and all lanes of warps in which any did; the same of triangle tests
    lanes: wp.array(dtype=wp.int64)  # shape [2 * len(LANE_PARTS)]


NO_COUNTS = TraceCounts()
"""For kernels without counters: no array has entries."""


def counts_of(ray_count: int, device: wp.Device, waits: bool = False) -> TraceCounts:
    """Counters, all 0, of a traversal by so many rays: of the whole tree, or where a ray `waits` at treelets."""
    counts = TraceCounts()
    for name in ("node_steps", "box_tests", "triangle_tests", *(("treelet_visits", "queued") if waits else ())):
        setattr(counts, name, wp.zeros(ray_count, dtype=int, device=device))
    counts.lanes = wp.zeros(2 * len(LANE_PARTS), dtype=wp.int64, device=device)
    return counts
