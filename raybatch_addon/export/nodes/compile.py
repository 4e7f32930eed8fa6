"""Compilation of a shader graph: to closures if they are constant, or to a program."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ...core.programs.op import op_named
from ...core.programs.ops.values.math import MathOperation
from ...core.scene.description import Closure, ClosureKind, Volume
from ...core.scene.notice import about
from ...core.scene.program import Program
from ...core.shading.bsdf.materials import constant_closure
from .collections import Collections
from .graph import find_source
from .inlined import Inlined, is_inlinable
from .inputs.aovs import write_aovs
from .inputs.normals import bump_from_displacement
from .node import Graph, Node, deep_recursion
from .survey import surveyed
from .volume_builder import VolumeBuilder, reads_smoothly

if TYPE_CHECKING:
    import bpy

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


def compile_graph(socket, owner: bpy.types.ID, collections: Collections, displaced: bool = False) -> Compiled:
    """The graph that feeds the shader input `socket` of an output node of `owner`.

    `collections` gets the images and attributes that it refers to. With `displaced` the displacement of the same node
    bends the surface's normal.
    """
    return _compiled_from(Graph(owner, collections, keeps_values=is_inlinable(owner)), socket, displaced)


def compile_volume(socket, owner: bpy.types.ID, collections: Collections) -> tuple[Volume | None, tuple[str, ...]]:
    """What the volume input `socket` of an output node of `owner` describes, and messages about what is left out; None
    where nothing is there.
    """
    if socket is None or find_source(socket)[0] is None:
        return None, ()
    builder = VolumeBuilder(type(owner).__name__ == "World", collections.grids(), reads_smoothly(owner))
    compiled = _compiled_from(Graph(owner, collections, builder, keeps_values=is_inlinable(owner)), socket)
    volume = Volume(compiled.closures, compiled.program)
    return (volume if volume.closures or volume.program else None), tuple(
        about(note, "volume") for note in compiled.notes
    )


def default_volume(collections: Collections) -> Volume:
    """What Blender takes volume objects without material to be: the default Principled Volume."""
    builder = VolumeBuilder(False, collections.grids())
    found = builder.value("volume_attribute", collections.attribute("GEOMETRY", "density"), 1.0)
    assert isinstance(found, tuple)  # a colour and a number
    density = found[1]
    color = builder.value("splat", builder.value("math", MathOperation.MULTIPLY, False, density, 0.5, 0.0))
    builder.closure("volume_henyey_greenstein", color, 0.0)
    builder.closure("volume_absorption", color)
    return Volume(program=builder.finish())


def _compiled_from(graph: Graph, socket, displaced: bool = False) -> Compiled:
    if socket is None:
        return _compiled(graph)
    owner = graph.owner
    graph.survey = surveyed(socket.node, graph.note, graph.links)
    inlined = Inlined(owner, socket.node)  # kept while its nodes are read
    if inlined.output is not None:
        socket = next(other for other in inlined.output.inputs if other.identifier == socket.identifier)
    with deep_recursion():
        if displaced:
            bump_from_displacement(graph, socket.node)
        if hasattr(owner, "displacement_method"):
            write_aovs(graph, socket.node.id_data)
        graph.surface(socket)
    return _compiled(graph)


def compile_displacement(socket, owner: bpy.types.ID, collections: Collections) -> Compiled:
    """The graph that feeds the input `socket`, "Displacement", of an output node of `owner`: always a program."""
    graph = Graph(owner, collections, keeps_values=is_inlinable(owner))
    graph.survey = surveyed(socket.node, graph.note, graph.links)
    inlined = Inlined(owner, socket.node)  # kept while its nodes are read
    output = socket.node if inlined.output is None else inlined.output
    with deep_recursion():
        node = Node(graph, output)
        node.closure("vertex_offset", node.vector("Displacement"))
    return Compiled((), graph.builder.finish(), (), tuple(graph.notes), tuple(graph.varying))


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
