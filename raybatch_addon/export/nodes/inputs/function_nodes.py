"""Inputs that node trees of all kinds have in common; Blender puts some into the trees that it simplifies."""

from __future__ import annotations

from ....core.programs.builder import Constant, three_numbers
from ..node import Node
from ..registry import values


@values("FunctionNodeInputVector", family="Inputs")
def vector(node: Node) -> Constant:
    """The first three of a vector's one to four numbers."""
    return three_numbers(node.node.vector)


@values("FunctionNodeInputInt", family="Inputs")
def integer(node: Node) -> Constant:
    """A whole number."""
    return float(node.node.integer)


@values("FunctionNodeInputBool", family="Inputs")
def boolean(node: Node) -> Constant:
    """1 or 0."""
    return float(node.node.boolean)
