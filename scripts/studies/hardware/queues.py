"""Queues at treelets: a ray that comes to another treelet waits there, and processors serve one treelet at a time.

Aila and Karras 2010 ("Architecture considerations for tracing incoherent rays"): treelets by surface area, queues in
memory, two schedulers. LAZY leaves a processor with its treelet until no ray waits there; BALANCED takes processors off
a treelet that several of them serve once its queue is shorter than the mean. STRaTA (Kopta, Shkurko, Spjut, Brunvand
and Davis 2013, "An energy and bandwidth efficient ray tracing architecture"): streams of rays at treelets lie on the
chip, in memory that would be the second-level cache, and a ray ends with a treelet before it leaves it.

Modelled are the places of all rays, what moves a ray to another queue, and the bytes of its state, each time written
and read. Not modelled: how queues are laid out, their own caches and overflow; that a ray visits other nodes when its
order of treelets is another (`grouped` puts what it read into another order, no more); targets of queue lengths as
BALANCED has them, of which the mean stands in; special pipelines of STRaTA.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from studies.hardware.machine import LAZY, QUEUES, Cache, Machine, Plan
from studies.hardware.plain import Subject
from studies.hardware.traces import Traces
from studies.hardware.treelets import Treelets


@wp.kernel(**KERNEL_OPTIONS)
def _group(
    items: wp.array(dtype=int),
    owner: wp.array(dtype=int),  # treelet of each item
    first: wp.array(dtype=wp.int64),
    done: wp.array(dtype=int),  # 0 before
    grouped: wp.array(dtype=int),
):
    """By ray."""
    ray = wp.tid()
    begin = first[ray]
    count = int(first[ray + 1] - begin)
    written = begin
    for i in range(count):
        here = begin + wp.int64(i)
        if done[here] == 0:
            for j in range(i, count):
                there = begin + wp.int64(j)
                if owner[there] == owner[here]:
                    done[there] = 1
                    grouped[written] = items[there]
                    written = written + wp.int64(1)


def grouped(traces: Traces, treelets: Treelets) -> Traces:
    """The same with all that a ray reads of a treelet together, when it first comes there: nearly the order of two
    stacks, of a treelet and of those behind it.
    """
    items = traces.items
    owner = np.where(items >= 0, treelets.of_node[np.maximum(items, 0)], treelets.of_triangle[np.maximum(~items, 0)])
    found = wp.zeros(len(items), dtype=int, device="cpu")
    inputs = [
        *(wp.array(values, dtype=int, device="cpu") for values in (items, owner)),
        wp.array(traces.first, dtype=wp.int64, device="cpu"),
        wp.zeros(len(items), dtype=int, device="cpu"),
        found,
    ]
    wp.launch(_group, traces.ray_count, inputs, device="cpu")
    return replace(traces, items=found.numpy())


@dataclass(frozen=True, kw_only=True)
class TreeletQueues:
    """A scheduler of queues."""

    name: str
    rule: str  # of treelets (`plain.RULES`)
    share: float = 0.5  # of the first-level cache that a treelet fills
    selection: int = LAZY
    alive: int  # rays
    ray_bytes: int
    in_memory: bool  # queues; otherwise on the chip
    grouped: bool = False  # rays end with a treelet before they leave it
    second_level: bool = True  # whether there is a second-level cache beside

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        size = int(self.share * machine.l1.size)
        treelets = subject.treelets(self.rule, size)
        own = machine if self.second_level else replace(machine, l2=Cache(0, machine.l2.ways))
        return Plan(
            traces=grouped(traces, treelets) if self.grouped else traces,
            addresses=subject.treelet_addresses(self.rule, size),
            machine=own,
            rays=traces.ray_count,
            mode=QUEUES,
            treelets=treelets,
            selection=self.selection,
            alive=self.alive,
            ray_bytes=self.ray_bytes,
            in_memory=self.in_memory,
        )
