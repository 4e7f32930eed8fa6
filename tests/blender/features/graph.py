"""Builder of shader graphs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import bpy

SNAP = 1 / 8  # coordinates and their offset are multiples of it
OFFSET = (11 / 64, 19 / 64, 5 / 64)


class Graph:
    """A node tree under construction, for the object `obj` (None: a world's)."""

    def __init__(self, tree: bpy.types.NodeTree, obj: bpy.types.Object | None = None) -> None:
        self.tree = tree
        self.obj = obj

    def node(self, kind: str, inputs: Mapping[str | int, Any] | None = None, **properties) -> bpy.types.Node:
        """A new node.

        `inputs` are by index, identifier or name: a socket to link, or a value (colours may leave out alpha).
        """
        made = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(made, name, value)
        for key, value in (inputs or {}).items():
            self.set(socket_of(made.inputs, key), value)
        return made

    def value(
        self, kind: str, inputs: Mapping[str | int, Any] | None = None, output: str | int = 0, **properties
    ) -> bpy.types.NodeSocket:
        """An output of a new node."""
        return socket_of(self.node(kind, inputs, **properties).outputs, output)

    def set(self, socket: bpy.types.NodeSocket, value: Any) -> None:
        """Link or set an input."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif socket.type == "RGBA" and len(value) == 3:
            socket.default_value = (*value, 1)
        else:
            socket.default_value = value

    def fill(self, node: bpy.types.Node, values: Mapping[str, Any]) -> bpy.types.Node:
        """Link or set the inputs, by identifier, that the node has in use; returns `node`."""
        for socket in node.inputs:
            if socket.enabled and socket.identifier in values:
                self.set(socket, values[socket.identifier])
        return node

    def math(self, operation: str, *operands, clamp: bool = False) -> bpy.types.NodeSocket:
        """A Math node's result."""
        return self.value("ShaderNodeMath", dict(enumerate(operands)), operation=operation, use_clamp=clamp)

    def vector_math(self, operation: str, *operands, output: str = "Vector") -> bpy.types.NodeSocket:
        """A Vector Math node's result."""
        return self.value("ShaderNodeVectorMath", dict(enumerate(operands)), output, operation=operation)

    @cached_property
    def point(self) -> bpy.types.NodeSocket:
        """Coordinates in -2..2.3, the same bits in every engine, and on no cell's border."""
        coordinates = self.value("ShaderNodeTexCoord", output="Object")
        cells = self.vector_math("SNAP", coordinates, (SNAP,) * 3)
        return self.vector_math("ADD", cells, OFFSET)

    @cached_property
    def _parts(self) -> bpy.types.Node:
        return self.node("ShaderNodeSeparateXYZ", {0: self.point})

    @property
    def x(self) -> bpy.types.NodeSocket:
        """First coordinate of `point`; multiples of 1/64 from -1.8 to 2.1."""
        return self._parts.outputs[0]

    @property
    def y(self) -> bpy.types.NodeSocket:
        """Second coordinate of `point`; multiples of 1/64 from -1.7 to 2.2."""
        return self._parts.outputs[1]

    @property
    def z(self) -> bpy.types.NodeSocket:
        """Third coordinate of `point`; multiples of 1/64 from -1.4 to 1.6."""
        return self._parts.outputs[2]

    @cached_property
    def unit(self) -> bpy.types.NodeSocket:
        """`point` mapped to 0..1, for colours."""
        return self.vector_math("MULTIPLY_ADD", self.point, (0.234375, 0.234375, 0.234375), (0.4375, 0.4375, 0.4375))

    def outputs(self, node: bpy.types.Node) -> dict[str, bpy.types.NodeSocket]:
        """All available outputs of a node, by identifier."""
        return {
            socket.identifier: socket
            for socket in node.outputs
            if socket.enabled and not getattr(socket, "is_unavailable", False)
        }


def socket_of(sockets, key: str | int) -> bpy.types.NodeSocket:
    """The socket by index, by identifier, or by name among those in use."""
    if isinstance(key, int):
        return sockets[key]
    for socket in sockets:
        if socket.identifier == key:
            return socket
    return next((socket for socket in sockets if socket.name == key and socket.enabled), None) or sockets[key]
