"""Which pages of geometry are brought to the device next, and which make room for them: pure policy, without Warp or a
device.

Most waiting first (Pharr et al. 1997, "Rendering complex scenes with memory-coherent ray tracing"): a page is copied
once for all rays that wait for it, so the one with most rays costs the fewest bytes a ray. Time is counted in pages
loaded, and a *sweep* is as many as the scene has, so that the figures below suit scenes of any size.
"""

from __future__ import annotations

import numpy as np

from ....bvh.pages.facts import PageFacts

# A page's rays count twice when they have waited for so many sweeps
AGE_SWEEPS = 4.0
# Rays that have waited longer than so many sweeps go first, few as they are
AGE_SWEEPS_MOST = 16.0
# A page is worth half when so many times the pool's pages were loaded after it
KEEP_POOLS = 2.0

# Copies from pinned memory to a device, 64 MB at a time (H200, PCIe 5 x16; 53 to 55 measured) [bytes/s]
COPY_RATE = 55e9
# Rays that go on to their end through pinned memory, in no order: with all of the geometry there, and with the
# triangles alone (H200, Dragon grid of 125 million triangles: 7.9 and 19 million measured; rays in their natural order
# 17 and 55) [rays/s]
ZERO_COPY_RATE, ZERO_COPY_RATE_NODES_THERE = 7.9e6, 19e6


def choose_pages(facts: PageFacts, count: int) -> list[int]:
    """At most `count` absent pages that rays wait for, the most urgent first; ties go to the lower number."""
    pages = np.flatnonzero(facts.absent & (facts.waiting > 0))
    if count <= 0 or not len(pages):
        return []
    sweeps = (facts.clock - facts.since[pages]) / max(1, len(facts.waiting))
    urgency = facts.waiting[pages] * (1.0 + sweeps / AGE_SWEEPS)
    overdue = sweeps > AGE_SWEEPS_MOST
    # the overdue in the order of their waiting
    order = np.lexsort((pages, np.where(overdue, -sweeps, -urgency), ~overdue))
    return pages[order[:count]].tolist()


def choose_victims(facts: PageFacts, count: int, forced: bool = False) -> list[int]:
    """At most `count` pages that make room: those that nobody waits for, the least wanted of late first; only if
    `forced` others too, the least waited for first.

    How much a page is wanted shows in how fast rays came to wait for it while it was away; that halves with time, so
    that of pages wanted alike the one loaded longest ago leaves.
    """
    usable = facts.evictable if forced else facts.evictable & (facts.waiting == 0)
    pages = np.flatnonzero(usable)
    if count <= 0 or not len(pages):
        return []
    away = np.maximum(1, facts.loaded_at[pages] - facts.left_at[pages])
    age = (facts.clock - facts.loaded_at[pages]) / (KEEP_POOLS * max(1, facts.pool))
    wanted = facts.served[pages] / away * np.exp2(-np.minimum(age, 1000.0))
    order = np.lexsort((facts.loaded_at[pages], wanted, facts.waiting[pages]))
    return pages[order[:count]].tolist()


def copies_pay(waiting: int, page_bytes: int, nodes_there: bool) -> bool:
    """Whether it is quicker to copy a page of `page_bytes` for `waiting` rays than to let these go on through pinned
    memory.
    """
    rate = ZERO_COPY_RATE_NODES_THERE if nodes_there else ZERO_COPY_RATE
    return waiting / rate > page_bytes / COPY_RATE
