"""Handlers of nodes, by `bl_idname`.

Each family's file registers its own; `docs/nodes.md` is generated from the registry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ...core.scene.description import ClosureKind


@dataclass(frozen=True)
class Handled:
    """A kind of node that has a handler."""

    bl_idname: str
    family: str  # Shaders, Textures, Inputs, Utilities
    handler: Callable[..., Any]
    # closures that a shader can become whatever its values: always these, or as a function of its `Node`
    kinds: tuple[ClosureKind, ...] | Callable[[Any], Iterable[ClosureKind]] = ()
    note: str = ""  # parts that are approximated or left out


value_nodes: dict[str, Handled] = {}
shader_nodes: dict[str, Handled] = {}


def values(*bl_idnames: str, family: str, note: str = "") -> Callable[[Callable], Callable]:
    """Register a function of a `Node` that returns its output, a `Value` or constant.

    A node with several outputs returns a dictionary of them by identifier.
    """

    def register(handler: Callable) -> Callable:
        for name in bl_idnames:
            value_nodes[name] = Handled(name, family, handler, note=note)
        return handler

    return register


def shader(
    bl_idname: str,
    kinds: tuple[ClosureKind, ...] | Callable[[Any], Iterable[ClosureKind]] = (),
    family: str = "Shaders",
    note: str = "",
) -> Callable[[Callable], Callable]:
    """Register a function (Node, weight: Value) that adds the closures of a shader node, times `weight`, a vector."""

    def register(handler: Callable) -> Callable:
        shader_nodes[bl_idname] = Handled(bl_idname, family, handler, kinds, note)
        return handler

    return register
