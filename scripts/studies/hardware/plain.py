"""Policies, what they are asked about, and the plain one: rays of their own, each through the tree as it comes.

The plain policy is that of machines of many instruction streams: TRaX (Spjut, Kensler, Kopta and Brunvand 2009, "TRaX:
a multicore hardware architecture for real-time ray tracing") and RayCore (Nah et al. 2014, "RayCore: a ray-tracing
hardware architecture for mobile devices"). Modelled are single rays in flight and caches of lines without sectors; not
the pipelines, nor the caches of nodes and of triangles apart that RayCore has, nor its kd-tree. The sizes of their
caches are of the order of what such chips have, and chosen here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

from studies.hardware.machine import Cache, Machine, Plan
from studies.hardware.traces import Addresses, Traces, tree_addresses
from studies.hardware.treelets import Treelets, TreeShape, breadth_first, by_area

RULES = {"breadth": breadth_first, "area": by_area}


@dataclass
class Subject:
    """A tree, and its treelets, each made once."""

    shape: TreeShape
    addresses: Addresses
    _treelets: dict[tuple[str, int], Treelets] = field(default_factory=dict)
    _addresses: dict[tuple[str, int], Addresses] = field(default_factory=dict)

    def treelets(self, rule: str, size: int) -> Treelets:
        """By `RULES`, of so many bytes."""
        if (rule, size) not in self._treelets:
            self._treelets[rule, size] = RULES[rule](self.shape, size)
        return self._treelets[rule, size]

    def treelet_addresses(self, rule: str, size: int) -> Addresses:
        """With each of these treelets in one piece."""
        if (rule, size) not in self._addresses:
            self._addresses[rule, size] = self.treelets(rule, size).addresses()
        return self._addresses[rule, size]


def subject_of(shape: TreeShape) -> Subject:
    """A tree as it lies on a device."""
    return Subject(shape, tree_addresses(len(shape.parent), len(shape.triangle_node)))


class Policy(Protocol):
    """How rays are brought through a tree."""

    @property
    def name(self) -> str:
        """Unique among policies."""

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """What is simulated for `traces`, rays in the order of their paths."""


@dataclass(frozen=True)
class Plain:
    """Single rays, `order` of `Traces.order`; with `treelet` bytes the tree lies treelet by treelet."""

    name: str = "plain"
    order: str = "natural"
    treelet: int = 0

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        addresses = subject.treelet_addresses("breadth", self.treelet) if self.treelet else subject.addresses
        taken = traces if self.order == "natural" else traces.taken(traces.order(self.order))
        return Plan(traces=taken, addresses=addresses, machine=machine, rays=traces.ray_count)


@dataclass(frozen=True, kw_only=True)
class OwnCaches:
    """Single rays on another machine: with lines that come whole, and first-level caches of its own."""

    name: str
    line: int
    l1: Cache
    slots: int

    def plan(self, subject: Subject, traces: Traces, machine: Machine) -> Plan:
        """See `Policy.plan`."""
        own = replace(machine, line=self.line, sector=self.line, l1=self.l1, slots=self.slots)
        return replace(Plain().plan(subject, traces, machine), machine=own)


TRAX = OwnCaches(name="TRaX", line=64, l1=Cache(32 << 10, 1), slots=32)
RAYCORE = OwnCaches(name="RayCore", line=64, l1=Cache(16 << 10, 2), slots=64)
