"""Prefetching of treelets by a vote of the rays in flight.

Chou, Nowicki and Aamodt 2023 ("Treelet prefetching for ray tracing"): small treelets, each in one piece in memory; rays
end with a treelet before they leave it; at each processor the treelet in which most rays in flight are is found again
and again, and brought to the first-level cache as a whole, always or where enough of them are there. Modelled: treelets
of 512 bytes made level by level, a vote each 64 cycles, and bytes that came unasked, read or not. Not modelled: the
voter's own delay, parts of a treelet, warps, and that rays visit other nodes in the order of two stacks (see
`queues.grouped`). A node of ours with its triangles has up to 1,232 bytes, so that many treelets are one node; theirs
had smaller ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from studies.hardware.machine import Machine, Plan
from studies.hardware.plain import Plain, Subject
from studies.hardware.queues import grouped
from studies.hardware.traces import Traces


@dataclass(frozen=True, kw_only=True)
class TreeletPrefetch:
    """A prefetcher; with `vote_cycles` 0 the control: the same treelets and order of rays without it."""

    name: str
    size: int = 512  # bytes of a treelet
    vote_cycles: int = 64
    threshold: float = 0.0  # share of the rays in flight that must be in a treelet

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        treelets = subject.treelets("breadth", self.size)
        plan = Plain(treelet=self.size).plan(subject, grouped(traces, treelets), machine)
        return replace(plan, treelets=treelets, vote_cycles=self.vote_cycles, threshold=self.threshold)
