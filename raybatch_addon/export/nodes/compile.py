"""Compilation of a shader graph: to closures if they are constant, or to a program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ...core.programs.op import op_named
from ...core.scene.description import Closure, ClosureKind
from ...core.scene.program import Program
from ...core.shading.bsdf.materials import constant_closure
from .collections import Collections
from .inlined import Inlined, is_inlinable
from .inputs.normals import bump_from_displacement
from .node import Graph, deep_recursion
from .survey import surveyed

# Most closures of a point: Cycles' own limit
CLOSURES_MOST = 64


@dataclass(frozen=True)
class Compiled:
    """Result for a graph: `closures`, or a `program` that makes them at every point."""

    closures: tuple[Closure, ...]
    program: Program | None
    kinds: tuple[ClosureKind, ...]  # all kinds that the graph can have, whatever its values
    notes: tuple[str, ...]  # parts that are left out or approximated
    varying: tuple[str, ...] = ()  # names of nodes whose outputs are not constants


def compile_graph(socket, owner: Any, collections: Collections, displaced: bool = False) -> Compiled:
    """The graph that feeds the shader input `socket` of an output node of `owner`.

    `collections` gets the images and attributes that it refers to. With `displaced` the displacement of the same node
    bends the surface's normal.
    """
    graph = Graph(owner, collections, keeps_values=is_inlinable(owner))
    if socket is None:
        return _compiled(graph)
    graph.survey = surveyed(socket.node, graph.note, graph.links)
    inlined = Inlined(owner, socket.node)  # kept while its nodes are read
    if inlined.output is not None:
        socket = next(other for other in inlined.output.inputs if other.identifier == socket.identifier)
    with deep_recursion():
        if displaced:
            bump_from_displacement(graph, socket.node)
        graph.surface(socket)
    return _compiled(graph)


def _compiled(graph: Graph) -> Compiled:
    kinds = tuple(sorted(graph.kinds))
    records = graph.builder.constant_closures()
    if records is not None:
        _note_left_out(graph, len(records))
        return Compiled(
            tuple(constant_closure(record) for record in records[:CLOSURES_MOST]), None, kinds, tuple(graph.notes)
        )
    program = graph.builder.finish()
    _note_left_out(graph, sum(op_named(step.op).closures_most for step in program.instructions))
    # kernels drop closures that their arrays cannot hold
    program = replace(program, closure_count=min(program.closure_count, CLOSURES_MOST))
    return Compiled((), program, kinds, tuple(graph.notes), tuple(graph.varying))


def _note_left_out(graph: Graph, count: int) -> None:
    if count > CLOSURES_MOST:
        graph.note(
            f"its shaders make up to {count} closures, of which a point has {CLOSURES_MOST} at most, as in Cycles: the "
            "last are left out"
        )
