"""Shader graphs as sums of closures.

A file a family of nodes; each file registers its handlers by `bl_idname`. A handler gets a `ShaderNode` and returns
its `Mixture`; it raises `NotUnderstood` for what it cannot express, and calls `leave_out` for what it leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .graph import NotUnderstood, constant_color, constant_float, find_source, node_label
from .mixture import Mixture

Handler = Callable[["ShaderNode"], Mixture]
_handlers: dict[str, Handler] = {}


def handles(bl_idname: str) -> Callable[[Handler], Handler]:
    """Registers the decorated function for nodes of type `bl_idname`."""

    def register(handler: Handler) -> Handler:
        _handlers[bl_idname] = handler
        return handler

    return register


@dataclass
class ShaderNode:
    """A node as its handler sees it: its inputs as constants, whatever groups are around it."""

    node: Any
    output: str = ""  # identifier of the socket that is asked for
    groups: tuple[Any, ...] = ()
    left_out: list[str] = field(default_factory=list)  # what is not rendered, in words; shared by the graph

    def socket(self, name: str):
        """The input called or identified as `name`, or None where this Blender has none."""
        inputs = self.node.inputs
        return next((s for s in inputs if s.identifier == name), None) or inputs.get(name)

    def number(self, name: str, default: float = 0.0) -> float:
        """The constant input `name`; `default` where there is no such input."""
        socket = self.socket(name)
        return default if socket is None else constant_float(socket, self.groups)

    def color(self, name: str) -> tuple[float, float, float]:
        """The constant colour at input `name`, linear, no channel below 0."""
        return constant_color(self.socket(name), self.groups)

    def shader(self, index: int) -> Mixture:
        """The closures that come in at input number `index`."""
        return shader_at(self.node.inputs[index], self.groups, self.left_out)

    def leave_out(self, text: str) -> None:
        """Notes that `text` is not rendered."""
        self.left_out.append(f"{text} of {node_label(self.node)}")

    def leave_out_links(self, *names: str) -> None:
        """Notes every input of `names` that something is linked to: only unlinked ones mean nothing."""
        for name in names:
            socket = self.socket(name)
            if socket is not None and find_source(socket, self.groups)[0] is not None:
                self.leave_out(name)


def shader_at(socket, groups: tuple[Any, ...] = (), left_out: list[str] | None = None) -> Mixture:
    """The closures that feed the shader input `socket`; none where nothing is linked. Raises `NotUnderstood`."""
    source, _ = find_source(socket, groups)
    if source is None:
        return Mixture()
    handler = _handlers.get(source.node.bl_idname)
    if handler is None:
        raise NotUnderstood(node_label(source.node))
    left_out = [] if left_out is None else left_out
    return handler(ShaderNode(source.node, source.socket.identifier, source.groups, left_out))


from . import bsdf, gabor, image, inputs, mixing, principled, shaders_basic, sky, voronoi  # noqa: E402, F401  (they register their handlers)
from . import colours, converters, curves, maths, textures_procedural  # noqa: E402, F401
from .node import Node  # noqa: E402, F401
from .registry import shader, values  # noqa: E402, F401
