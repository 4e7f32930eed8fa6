"""Accumulation: rays that miss the same line wait for it together.

SGRT (Lee, Shin, Lee, Kim, Nah, Jung, Lee, Park and Han 2013, "SGRT: a mobile GPU architecture for real-time ray
tracing"), whose traversal has the ray accumulation unit of Nah et al. 2011 ("T&I engine: traversal and intersection
engine for hardware accelerated ray tracing"): a ray that misses goes to a row of rays that miss the same line, others
go on, and when the line comes all of the row read it, even if it was replaced by then. A row asks for its line at once.
With few registers a line is asked for when one is free, that of the most rays first: more rays come together then. That
is not part of those papers. Not modelled: pipelines, separate caches of nodes and triangles, and how many rays a row
holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from studies.hardware.machine import ACCUMULATE, Machine, Plan
from studies.hardware.plain import Plain, Subject
from studies.hardware.traces import Traces


@dataclass(frozen=True)
class Accumulation:
    """Rows of rays, and so many registers of rows that are on their way, at each processor."""

    name: str
    rows: int
    registers: int
    slots: int = 0  # rays in flight at each processor, 0: as the machine has them

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        plan = Plain().plan(subject, traces, replace(machine, slots=self.slots or machine.slots))
        return replace(plan, mode=ACCUMULATE, rows=self.rows, registers=self.registers)
