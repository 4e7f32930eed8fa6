"""Emission, Background, Mix Shader and Add Shader."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.scene.description import ClosureKind
from ..node import Node
from ..registry import shader


@shader("ShaderNodeEmission", kinds=(ClosureKind.EMISSION,))
def emission(node: Node, weight: Value) -> None:
    """Emission of a colour times a strength."""
    strength = node.number("Strength")
    if strength.known and strength.number() < 0:
        node.warn("negative Strength, taken as 0,")
    node.closure("emission", node.times(weight, node.times(node.color("Color"), strength)))


@shader("ShaderNodeBackground", kinds=(ClosureKind.EMISSION,))
def background(node: Node, weight: Value) -> None:
    """Emission of a world; Cycles shows none of it on surfaces."""
    if type(node.graph.owner).__name__ != "Material":
        emission(node, weight)


@shader("ShaderNodeMixShader")
def mix(node: Node, weight: Value) -> None:
    """Two shaders, shared by a factor."""
    first, second = node.op("mix_weights", weight, node.number(0))
    node.shader(1, first)
    node.shader(2, second)


@shader("ShaderNodeAddShader")
def add(node: Node, weight: Value) -> None:
    """Sum of two shaders."""
    node.shader(0, weight)
    node.shader(1, weight)
