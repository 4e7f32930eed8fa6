"""Nodes as their handlers see them, and the walk over a graph that calls the handlers."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

from ...core.programs.builder import Constant, ProgramBuilder, Value, three_numbers
from ...core.programs.ops.values.vector_math import VectorOperation
from ...core.scene.description import ClosureKind
from ...core.scene.notice import Notice
from .collections import Collections
from .graph import SocketLinks, Source, find_source, is_group, node_label, node_name
from .registry import shader_nodes, value_nodes
from .survey import Survey

WHITE = Value.of((1.0, 1.0, 1.0))
BLACK = Value.of((0.0, 0.0, 0.0))
_VECTORS = {"VECTOR", "RGBA", "ROTATION"}
# Recursion limit; Python's own would end chains of a few hundred nodes
_RECURSION_LIMIT = 40_000


@dataclass
class Graph:
    """One graph, and the program that it is compiled to."""

    owner: Any = None  # Blender's material, world or light
    collections: Collections = field(default_factory=Collections)
    builder: ProgramBuilder = field(default_factory=ProgramBuilder)
    _: KW_ONLY
    kinds: set[ClosureKind] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)  # messages about parts that are left out or approximated
    # nodes whose outputs are not constants, in the order in which the walk meets them
    varying: list[str] = field(default_factory=list)
    bumped: Value | None = None  # the surface's normal as the displacement of the material bends it
    shift: int = 0  # bump mapping evaluates its height three times: here, and one step aside along either axis
    links: SocketLinks = field(default_factory=SocketLinks)
    keeps_values: bool = False  # see `find_source`
    survey: Survey = field(default_factory=Survey)
    _known: dict[tuple, dict[str, Value]] = field(default_factory=dict)
    _open: set[tuple] = field(default_factory=set)  # nodes being evaluated: meeting one again means a cycle
    _sources: dict[tuple, tuple[Source | None, Any]] = field(default_factory=dict)
    _uses: Counter = field(default_factory=Counter)  # for each shader node: links that lead from it to the output
    _shaded: Counter = field(default_factory=Counter)  # ... and how many times its closures were asked for
    # shader nodes, weights and links so far
    _waiting: dict[tuple, tuple[Node, Value, int]] = field(default_factory=dict)

    def source(self, socket, groups: tuple[Any, ...] = ()) -> tuple[Source | None, Any]:
        """The output that feeds the input `socket`; see `find_source`."""
        key = (socket.as_pointer(), *(group.as_pointer() for group in groups))
        if key not in self._sources:
            self._sources[key] = find_source(socket, groups, self.note, self.links, self.keeps_values)
        return self._sources[key]

    def surface(self, socket) -> None:
        """Add the closures that feed the shader input `socket` of an output node.

        A shader that is used several times adds its closures once, with the sum of its weights.
        """
        self._count_uses(socket)
        self.shade(socket, WHITE)
        while self._waiting:  # shaders that were asked for fewer times than they are linked
            node, weight, _ = self._waiting.pop(next(iter(self._waiting)))
            self._add_shader(node, weight)

    def _count_uses(self, socket) -> None:
        waiting = [(socket, ())]
        while waiting:
            source, _ = self.source(*waiting.pop())
            if source is None or source.socket.type != "SHADER":
                continue
            node = Node(self, source.node, source.groups)
            self._uses[node.key] += 1
            if self._uses[node.key] == 1:
                waiting += [(inner, node.groups) for inner in self._shader_inputs(node)]

    def _shader_inputs(self, node: Node) -> list[Any]:
        """Linked shader inputs that count; a node that is not understood has the first alone."""
        inputs = [s for s in node.node.inputs if s.type == "SHADER" and self.source(s, node.groups)[0] is not None]
        return inputs if node.node.bl_idname in shader_nodes else inputs[:1]

    def shade(self, socket, weight: Value, groups: tuple[Any, ...] = ()) -> None:
        """Add the closures that feed the shader input `socket`, times `weight`."""
        source, _ = self.source(socket, groups)
        if source is None:
            return
        node = Node(self, source.node, source.groups)
        if source.socket.type != "SHADER":  # a number or colour in place of a shader emits, as in Cycles
            self.kinds.add(ClosureKind.EMISSION)
            node.closure("emission", node.times(weight, self.value(source)))
            return
        _, earlier, count = self._waiting.pop(node.key, (node, None, 0))
        if earlier is not None:
            weight = node.op("vector_math", VectorOperation.ADD, earlier, weight, (0.0, 0.0, 0.0), 0.0)[0]
        if count + 1 < self._uses[node.key]:
            self._waiting[node.key] = (node, weight, count + 1)
        else:
            self._add_shader(node, weight)

    def _add_shader(self, node: Node, weight: Value) -> None:
        self._shaded[node.key] += 1
        with self._inside(node, "surface") as new:
            if not new or self._shaded[node.key] > self._uses[node.key]:
                self.note(f"{node_label(node.node)} is linked to itself: the link is ignored")
                return
            handled = shader_nodes.get(node.node.bl_idname)
            if handled is None:
                self._unknown_shader(node, weight)
                return
            step = self.builder.step_count
            try:
                self.kinds.update(handled.kinds(node) if callable(handled.kinds) else handled.kinds)
                handled.handler(node, weight)
            except Exception as error:
                self.builder.drop_closures(step)
                self._viewport_color(node, weight, f"cannot be read ({error_text(error)})")

    def value(self, source) -> Value:
        """Value of the socket `source.socket`."""
        node = Node(self, source.node, source.groups)
        key = (*node.key, self.shift)
        if key not in self._known:
            with self._inside(node, "value") as new:
                if not new:
                    self.note(f"{node_label(node.node)} is linked to itself: the link is ignored")
                    return Value.of(0.0)
                try:
                    self._known[key] = self._outputs(node)
                except Exception as error:
                    self.note(f"{node_label(node.node)} cannot be read ({error_text(error)}); it gives 0")
                    self._known[key] = {"": Value.of(0.0)}
                label = node_label(node.node)
                if label not in self.varying and not all(value.known for value in self._known[key].values()):
                    self.varying.append(label)
        outputs = self._known[key]
        return outputs.get(source.socket.identifier) or outputs.get("") or Value.of(0.0)

    def bend(self, normal: Value) -> None:
        """Give the surface another normal; values computed from the former one are dropped."""
        self.bumped = normal
        self._known.clear()

    def note(self, text: str, node: Node | None = None) -> None:
        """Remember a message about a part that is not rendered as it is, and the node that it is about."""
        if text not in self.notes:
            self.notes.append(Notice(text, nodes=[] if node is None else [node_name(node.node)]))

    def _outputs(self, node: Node) -> dict[str, Value]:
        handled = value_nodes.get(node.node.bl_idname)
        if handled is None:
            self.note(f"{node_label(node.node)} is not supported; {node.pass_through_words()}", node)
            return {"": node.passed_through()}
        result = handled.handler(node)
        if isinstance(result, dict):
            return {name: Value.of(value) for name, value in result.items()}
        return {"": Value.of(result)}

    def _unknown_shader(self, node: Node, weight: Value) -> None:
        for inner in self._shader_inputs(node):
            self.note(f"{node_label(node.node)} is not supported; its first linked shader passes through", node)
            self.shade(inner, weight, node.groups)
            return
        self._viewport_color(node, weight, "is not supported")

    def _viewport_color(self, node: Node, weight: Value, why: str) -> None:
        """Replace a shader by a surface or light of the viewport's colour."""
        color = getattr(self.owner, "diffuse_color", getattr(self.owner, "color", (0.8, 0.8, 0.8)))
        red, green, blue = (max(float(c), 0.0) for c in color[:3])
        if type(self.owner).__name__ in ("Material", "NoneType"):
            self.note(f"{node_label(node.node)} {why}; it is a diffuse surface in the viewport colour", node)
            self.kinds.add(ClosureKind.DIFFUSE)
            node.closure("diffuse", node.times(weight, (red, green, blue)), BLACK)
        else:
            self.note(f"{node_label(node.node)} {why}; it gives no light", node)

    @contextmanager
    def _inside(self, node: Node, what: str) -> Iterator[bool]:
        key = (*node.key, what, self.shift)
        if key in self._open:
            yield False
            return
        self._open.add(key)
        try:
            yield True
        finally:
            self._open.discard(key)


def error_text(error: Exception) -> str:
    """An exception in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


@dataclass(frozen=True)
class Node:
    """A node and the group nodes around it."""

    graph: Graph
    node: Any
    groups: tuple[Any, ...] = ()

    @property
    def key(self) -> tuple:
        """Key of this use of the node."""
        return (self.node.as_pointer(), *(group.as_pointer() for group in self.groups))

    @property
    def shift(self) -> int:
        """Number of the step aside in bump mapping's three evaluations; 0: none."""
        return self.graph.shift

    @property
    def library(self):
        """Blender's library that the node's file paths are relative to; None: the open file."""
        return self.graph.survey.libraries.get(node_name(self.node))

    def socket(self, key: int | str):
        """The input with number, identifier or name `key`; None if this Blender has none."""
        inputs = self.node.inputs
        if isinstance(key, int):
            return inputs[key] if key < len(inputs) else None
        by_identifier = next((s for s in inputs if s.identifier == key), None)
        return by_identifier or next((s for s in inputs if s.name == key and s.enabled), None) or inputs.get(key)

    def has(self, key: int | str) -> bool:
        """Whether the input exists."""
        return self.socket(key) is not None

    def linked(self, key: int | str) -> bool:
        """Whether a node feeds the input."""
        socket = self.socket(key)
        if socket is None:
            return False
        source, own = self.graph.source(socket, self.groups)
        # a value that a group passes in counts as linked
        given = (
            self.graph.keeps_values and own is not None and own != socket and is_group(own.node) and not own.hide_value
        )
        return source is not None or given

    def used(self, key: int | str) -> bool:
        """Whether the input exists, and is linked, animated or not 0."""
        socket = self.socket(key)
        if socket is None:
            return False
        lively = (node_name(self.node), socket.identifier) in self.graph.survey.lively
        return lively or self.linked(key) or any(self._input(key, 0.0, 1).constant or (1.0,))

    def wants(self, output: str) -> bool:
        """Whether anything is linked to the output called or identified as `output`."""
        return any(s.is_linked for s in self.node.outputs if output in (s.identifier, s.name))

    def output(self, name: str) -> str:
        """The identifier of the enabled output called `name`."""
        named = [s for s in self.node.outputs if s.name == name]
        return next((s.identifier for s in named if s.enabled), named[0].identifier if named else name)

    def number(self, key: int | str, default: float = 0.0) -> Value:
        """The input as a number; `default` if there is no such input."""
        return self._input(key, default, 1)

    def vector(self, key: int | str, default: Constant = (0.0, 0.0, 0.0)) -> Value:
        """The input as a vector."""
        return self._input(key, default, 3)

    def color(self, key: int | str, default: Constant = (0.0, 0.0, 0.0)) -> Value:
        """The input as a colour, linear RGB."""
        return self._input(key, default, 3)

    def op(self, name: str, *operands) -> Any:
        """Compute a value; see `ProgramBuilder.value`."""
        return self.graph.builder.value(name, *operands)

    def closure(self, name: str, *operands) -> None:
        """Add a closure; the first operand is its weight."""
        self.graph.builder.closure(name, *operands)

    def shader(self, key: int | str, weight: Value) -> None:
        """Add the closures that feed a shader input, times `weight`."""
        self.graph.shade(self.socket(key), weight, self.groups)

    def constant(self, value: Constant) -> Value:
        """A constant as a value."""
        return Value.of(value)

    def times(self, a: Value | Constant, b: Value | Constant) -> Value:
        """The product of a vector with a number or vector."""
        if a is WHITE:  # the weight of an output's shader, the same object for all
            return self.as_vector(b)
        return self.op("multiply_colors", self.as_vector(a), self.as_vector(b))

    def as_vector(self, value: Value | Constant) -> Value:
        """`value` as a vector: a number three times."""
        value = Value.of(value)
        return value if value.width == 3 else self.op("splat", value)

    def as_number(self, value: Value | Constant, color: bool = True) -> Value:
        """`value` as a number: a colour's luminance, a vector's mean."""
        value = Value.of(value)
        return value if value.width == 1 else self.op("luminance" if color else "average", value)

    def warn(self, text: str) -> None:
        """Note a part of this node that is left out or approximated."""
        self.graph.note(f"{text} of {node_label(self.node)}", self)

    def coordinates(self) -> Value:
        """Generated texture coordinates, the input of textures without link."""
        return self.op("generated", self.shift)

    def normal(self, key: int | str = "Normal") -> Value:
        """A normal input; the shading normal if nothing is linked."""
        return self.vector(key) if self.linked(key) else self.surface_normal()

    def surface_normal(self) -> Value:
        """The shading normal."""
        return self.graph.bumped or self.op("normals")[0]

    def own_normal(self, key: int | str = "Normal") -> Value:
        """A normal input for closures; 0, which stands for the surface's normal, if nothing is linked."""
        if not self.linked(key):
            return BLACK
        self.graph.kinds.add(ClosureKind.OWN_NORMAL)
        return self.normal(key)

    def tangent(self, key: int | str = "Tangent") -> Value:
        """A tangent input; around the object's Z axis if nothing is linked."""
        return self.vector(key) if self.linked(key) else self.op("radial_tangent", 2, self.shift)

    def uv(self) -> Value:
        """The active UV map as a vector, the input of image textures without link."""
        return self.op("uv", -1, self.shift)

    def passed_through(self) -> Value:
        """The first linked input of the kind of the first output, else the output's own value."""
        kinds = {s.type for s in self.node.outputs}
        for i, socket in enumerate(self.node.inputs):
            if socket.type in kinds and self.linked(i):
                return self._input(i, 0.0, 3 if socket.type in _VECTORS else 1)
        return Value.of(0.0)

    def pass_through_words(self) -> str:
        """The effect of `passed_through`, in words."""
        kinds = {s.type for s in self.node.outputs}
        linked = [s.name for i, s in enumerate(self.node.inputs) if s.type in kinds and self.linked(i)]
        return f"its input {linked[0]} passes through" if linked else "it gives 0"

    def _input(self, key: int | str, default: Constant, width: int) -> Value:
        socket = self.socket(key)
        if socket is None:
            return self.as_vector(default) if width == 3 else Value.of(default)
        source, own = self.graph.source(socket, self.groups)
        if source is None:
            value, kind = (Value.of(0.0), socket.type) if own is None else (own_value(own), own.type)
            through: tuple[str, ...] = ()
        else:
            value, kind, through = self.graph.value(source), source.socket.type, source.through
        for step in (*through, socket.type):
            value, kind = self._converted(value, kind, step), step
        if width == 3:
            return self.as_vector(value)
        return self.as_number(value, kind == "RGBA")

    def _converted(self, value: Value, kind: str, to: str) -> Value:
        """`value` of a socket of type `kind` as Blender passes it to a socket of type `to`."""
        if to in _VECTORS:
            return self.as_vector(value)
        value = self.as_number(value, kind == "RGBA")
        if to in ("INT", "BOOLEAN") and kind not in ("INT", "BOOLEAN"):
            whole = to == "INT" or not self.graph.keeps_values  # up to 4.5 Cycles has no other kind
            return self.op("truncate" if whole else "is_positive", value)
        return value


def own_value(socket) -> Value:
    """The own value of an unlinked socket."""
    value: Any = getattr(socket, "default_value", 0.0)
    if isinstance(value, str):
        return Value.of(0.0)
    if hasattr(value, "__len__"):
        return Value.of(three_numbers(value))
    return Value.of(float(value))


@contextmanager
def deep_recursion() -> Iterator[None]:
    """Context in which long chains of nodes can be followed."""
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(max(before, _RECURSION_LIMIT))
    try:
        yield
    finally:
        sys.setrecursionlimit(before)
