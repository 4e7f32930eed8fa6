"""A shader graph as closures, where they are constant, or as a program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...core.scene.description import Closure, ClosureKind
from ...core.scene.program import Program
from .collections import Collections
from .node import Graph, deep_recursion


@dataclass(frozen=True)
class Compiled:
    """What a graph becomes: `closures`, or a `program` that makes them at every point."""

    closures: tuple[Closure, ...]
    program: Program | None
    kinds: tuple[ClosureKind, ...]  # that it can have, whatever its values
    notes: tuple[str, ...]  # what is left out or approximated


def compile_graph(socket, owner: Any, collections: Collections) -> Compiled:
    """The graph that feeds the shader input `socket` of an output node of `owner`; `collections` gets what it refers to."""
    graph = Graph(owner, collections)
    with deep_recursion():
        graph.surface(socket)
    kinds = tuple(sorted(graph.kinds))
    records = graph.builder.constant_closures()
    if records is not None:
        return Compiled(tuple(constant_closure(record) for record in records), None, kinds, tuple(graph.notes))
    return Compiled((), graph.builder.finish(), kinds, tuple(graph.notes))


def constant_closure(record) -> Closure:
    """A record of the device as the description has it."""
    kind = ClosureKind(record.kind)
    scale = float(record.colour_scale)
    return Closure(
        kind, _color(record.weight), float(record.roughness), float(record.ior), _color(record.edge), _color(record.refraction),
        share=1.0 / scale if scale > 0 else 1.0, multiscatter=scale > 0,
    )  # fmt: skip


def _color(values) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
