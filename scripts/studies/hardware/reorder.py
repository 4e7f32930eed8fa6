"""Reorder buffers: so many rays are collected, sorted by a key, and begin in that order; at each bounce again.

GPUs of the Turing era and later are given rays, or what is to be done with their hits, sorted: rays by origin and
direction before they are traced (Garanzha and Loop 2010, "Fast ray sorting and breadth-first packet traversal for GPU
ray tracing"; Moon et al. 2010, "Cache-oblivious ray reordering"), or threads by what they hit (shader execution
reordering, NVIDIA 2022), so that the rays that leave from there begin close together. Modelled: the order of the keys
within each buffer, and for buffers in memory the bytes of a ray, once written and once read. Rays that were sorted at
the camera alone come to later bounces in the order of their paths, which is what the plain policy has. Not modelled:
the time of the sort, warps, and what sorting saves in shading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from benchmarking.orders import MORTON_BITS, sort_keys

from studies.hardware.machine import Machine, Plan
from studies.hardware.plain import Subject
from studies.hardware.traces import Traces


def buffer_order(traces: Traces, size: int, by_origin: bool) -> np.ndarray:
    """Indices of rays, sorted within each `size` of them by the octant of the direction and then the Morton code of the
    origin; `by_origin`: the code first.
    """
    keys = sort_keys(traces.origin, traces.direction).astype(np.int64)
    if by_origin:
        codes = 1 << 3 * MORTON_BITS
        keys = keys % codes * 8 + keys // codes
    return np.lexsort((keys, np.arange(traces.ray_count) // size))


@dataclass(frozen=True)
class ReorderBuffer:
    """A buffer of `size` rays."""

    name: str
    size: int
    by_origin: bool = False
    sorted_bytes: int = 0  # of a ray, to memory and back; 0: the buffer is on the chip

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        return Plan(
            traces=traces.taken(buffer_order(traces, self.size, self.by_origin)),
            addresses=subject.addresses,
            machine=machine,
            rays=traces.ray_count,
            sorted_bytes=self.sorted_bytes,
        )
