"""Handlers of nodes, by `bl_idname`. A file a family registers its own; `docs/nodes.md` is made of this."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ...core.scene.description import ClosureKind


@dataclass(frozen=True)
class Handled:
    """A kind of node that is understood."""

    bl_idname: str
    family: str  # Shaders, Textures, Inputs, Utilities
    handler: Callable[..., Any]
    # closures that a shader can become whatever its values: always these, or as a function of its `Node`
    kinds: tuple[ClosureKind, ...] | Callable[[Any], Iterable[ClosureKind]] = ()
    note: str = ""  # what is approximated or left out


value_nodes: dict[str, Handled] = {}
shader_nodes: dict[str, Handled] = {}


def values(*bl_idnames: str, family: str, note: str = "") -> Callable[[Callable], Callable]:
    """Registers a function of a `Node` that returns its output, or a dictionary of outputs by identifier, as `Value`s or constants."""

    def register(handler: Callable) -> Callable:
        for name in bl_idnames:
            value_nodes[name] = Handled(name, family, handler, note=note)
        return handler

    return register


def shader(
    bl_idname: str, kinds: tuple[ClosureKind, ...] | Callable[[Any], Iterable[ClosureKind]] = (), family: str = "Shaders", note: str = ""
) -> Callable[[Callable], Callable]:
    """Registers a function (Node, weight: Value), which adds the closures of a shader node of that weight, a vector."""

    def register(handler: Callable) -> Callable:
        shader_nodes[bl_idname] = Handled(bl_idname, family, handler, kinds, note)
        return handler

    return register
