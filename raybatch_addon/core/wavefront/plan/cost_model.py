"""The expected cost of a ray, batched and not: a small model with measured constants.

Tracing grows with how far the tree is beyond the cache that rays share: every doubling costs the same. Batching keeps
each treelet in the cache, but each visit to one costs a passage through a queue and the way back through the top level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class RayCosts:
    """Constants of one kind of device; times are of one worker."""

    trace_ns: float  # a bounced ray where the whole tree is in the cache
    doubling: float  # share of `trace_ns` that is added with every doubling of the tree beyond the cache
    cache_bytes: float
    visit_ns: float  # into a queue and out of it, and on through the top level, for each visit to a treelet
    visits_one: float = 1.0  # visits of a ray where there is one treelet
    visits_doubling: float = 0.35  # that are added with every doubling of their number


# First bounce, Dragon (0.87 million triangles) to 125 million; docs/experiments has the runs
COSTS_CUDA = RayCosts(trace_ns=0.39, doubling=0.15, cache_bytes=60e6, visit_ns=0.2)
COSTS_CPU = RayCosts(trace_ns=350.0, doubling=0.12, cache_bytes=2e6, visit_ns=120.0)


def costs_of(is_cuda: bool) -> RayCosts:
    """The constants of a device."""
    return COSTS_CUDA if is_cuda else COSTS_CPU


def unbatched_cost(costs: RayCosts, tree_bytes: float) -> float:
    """Time of a ray that visits the whole tree at once [ns]."""
    return costs.trace_ns * (1 + costs.doubling * math.log2(max(1.0, tree_bytes / costs.cache_bytes)))


def batching_cost(costs: RayCosts, tree_bytes: float, treelet_bytes: float) -> float:
    """Time of a ray that waits at treelets of `treelet_bytes` [ns]; what is in memory costs as if one treelet were the
    tree.
    """
    count = max(1.0, tree_bytes / treelet_bytes)
    visits = costs.visits_one + costs.visits_doubling * math.log2(count)
    return unbatched_cost(costs, min(tree_bytes, treelet_bytes)) + visits * costs.visit_ns


# On CPUs, of one processor. Splits took 2 to 3 microseconds a triangle in files with 0.2 to 0.5 million; they saved
# 60 ns of a bounced ray in Sponza (docs/experiments/traversal.md), and nothing to speak of in a car, a smithy and a
# living room
SPLIT_NS = 2500.0  # a triangle
SPLIT_SAVED_NS = 30.0  # a ray
RAYS_A_SAMPLE = 4.0  # in those files two to four: camera ray, bounces and shadow rays


def split_seconds(triangles: int, samples: float) -> tuple[float, float]:
    """What spatial splits of a tree are expected to cost, and to save in a render of so many samples [s]."""
    return triangles * SPLIT_NS * 1e-9, samples * RAYS_A_SAMPLE * SPLIT_SAVED_NS * 1e-9
