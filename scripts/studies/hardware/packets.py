"""Packets: rays that go through the tree together, so that what several of them want is fetched once.

SaarCOR (Schmittler, Wald and Slusallek 2002, "SaarCOR: a hardware architecture for ray tracing") and the RPU (Woop,
Schmittler and Slusallek 2005, "RPU: a programmable ray processing unit for realtime ray tracing"): packets of four rays
that lie next to each other. Larger ones are here for comparison. Modelled is who fetches what: a ray waits at an item
until no ray of its packet has it still before itself, and then all that are there read it at once. Where rays want the
same things in different orders (they come from other octants) one goes on alone and the others fetch again later. So
packets never fetch more than their rays would, and a mask of active rays is free. Not modelled: kd-trees, and that rays
of a packet share one order of visits, which makes some of them visit more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from studies.hardware.machine import Machine, Plan
from studies.hardware.plain import Subject
from studies.hardware.traces import Traces


@wp.kernel(**KERNEL_OPTIONS)
def _merge(
    items: wp.array(dtype=int),
    first: wp.array(dtype=wp.int64),
    at: wp.array(dtype=wp.int64),  # by ray, where it is; its first item before
    ahead: wp.array(dtype=int),  # by item, rays of the packet that have it before them, or are there
    there: wp.array(dtype=int),  # by item, rays of the packet that are there
    size: int,
    merged: wp.array(dtype=int),
    packet_first: wp.array(dtype=wp.int64),
):
    """By one thread. An item i is item 2 i of the two tables, a triangle ~t item 2 t + 1."""
    count = first.shape[0] - 1
    written = wp.int64(0)
    for packet in range(packet_first.shape[0] - 1):
        low = packet * size
        high = wp.min(low + size, count)
        for ray in range(low, high):
            for i in range(int(first[ray + 1] - first[ray])):
                own = items[first[ray] + wp.int64(i)]
                place = wp.where(own >= 0, 2 * own, 2 * ~own + 1)
                ahead[place] = ahead[place] + 1
            if at[ray] < first[ray + 1]:
                item = items[at[ray]]
                place = wp.where(item >= 0, 2 * item, 2 * ~item + 1)
                there[place] = there[place] + 1
        go = int(1)
        while go != 0:
            chosen = int(-1)
            blocked = int(-1)
            for ray in range(low, high):
                if chosen < 0 and at[ray] < first[ray + 1]:
                    item = items[at[ray]]
                    place = wp.where(item >= 0, 2 * item, 2 * ~item + 1)
                    if there[place] == ahead[place]:
                        chosen = ray
                    elif blocked < 0:
                        blocked = ray
            if chosen < 0:
                chosen = blocked
            go = 0
            if chosen >= 0:
                go = 1
                now = items[at[chosen]]
                merged[written] = now
                written = written + wp.int64(1)
                for ray in range(low, high):
                    if at[ray] < first[ray + 1]:
                        if items[at[ray]] == now:
                            place = wp.where(now >= 0, 2 * now, 2 * ~now + 1)
                            ahead[place] = ahead[place] - 1
                            there[place] = there[place] - 1
                            at[ray] = at[ray] + wp.int64(1)
                            if at[ray] < first[ray + 1]:
                                item = items[at[ray]]
                                place = wp.where(item >= 0, 2 * item, 2 * ~item + 1)
                                there[place] = there[place] + 1
        packet_first[packet + 1] = written


def packed(traces: Traces, size: int) -> Traces:
    """What packets of `size` rays in a row read; origins and directions are those of their first rays."""
    packets = -(-traces.ray_count // size)
    tables = [wp.zeros(2 * max(traces.node_count, traces.triangle_count), dtype=int, device="cpu") for _ in range(2)]
    merged = wp.zeros(len(traces.items), dtype=int, device="cpu")
    first = wp.zeros(packets + 1, dtype=wp.int64, device="cpu")
    inputs = [
        wp.array(traces.items, dtype=int, device="cpu"),
        wp.array(traces.first, dtype=wp.int64, device="cpu"),
        wp.array(traces.first[:-1].copy(), dtype=wp.int64, device="cpu"),
        *tables,
        size,
        merged,
        first,
    ]
    wp.launch(_merge, 1, inputs, device="cpu")
    begins = first.numpy().copy()
    heads = np.arange(packets) * size
    return replace(
        traces,
        items=merged.numpy()[: begins[-1]].copy(),
        first=begins,
        origin=traces.origin[heads],
        direction=traces.direction[heads],
    )


@dataclass(frozen=True)
class Packets:
    """Packets of `size` rays, as many rays in flight as without."""

    name: str
    size: int

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        own = replace(machine, slots=max(1, machine.slots // self.size), chunk=max(1, machine.chunk // self.size))
        merged = packed(traces, self.size)
        return Plan(traces=merged, addresses=subject.addresses, machine=own, rays=traces.ray_count)
