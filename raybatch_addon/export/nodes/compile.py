"""A shader graph as closures, where they are constant, or as a program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...core.scene.description import Closure, ClosureKind
from ...core.scene.program import Program
from ...core.shading.materials import constant_closure
from .collections import Collections
from .node import Graph, deep_recursion
from .normals import bump_from_displacement


@dataclass(frozen=True)
class Compiled:
    """What a graph becomes: `closures`, or a `program` that makes them at every point."""

    closures: tuple[Closure, ...]
    program: Program | None
    kinds: tuple[ClosureKind, ...]  # that it can have, whatever its values
    notes: tuple[str, ...]  # what is left out or approximated
    varying: tuple[str, ...] = ()  # names of nodes whose outputs are not constants


def compile_graph(socket, owner: Any, collections: Collections, displaced: bool = False) -> Compiled:
    """The graph that feeds the shader input `socket` of an output node of `owner`; `collections` gets what it refers to.

    With `displaced` the displacement of the same node bends the surface's normal.
    """
    graph = Graph(owner, collections)
    with deep_recursion():
        if displaced:
            bump_from_displacement(graph, socket.node)
        if socket is not None:
            graph.surface(socket)
    kinds = tuple(sorted(graph.kinds))
    records = graph.builder.constant_closures()
    if records is not None:
        return Compiled(tuple(constant_closure(record) for record in records), None, kinds, tuple(graph.notes))
    return Compiled((), graph.builder.finish(), kinds, tuple(graph.notes), tuple(graph.varying))
