"""Nodes whose values rays find: Ambient Occlusion and Bevel."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.inputs.ray_inputs import INSIDE, ONLY_LOCAL, ROUNDED, SAMPLES_SHIFT
from ....core.programs.ops.values.vector_math import VectorOperation
from ..node import Node
from ..registry import values
from ..volume_builder import is_in_volume

# Whether and where an op's requests are answered is decided before a render
_UNANSWERED = -1, -1
_NONE = (0.0, 0.0, 0.0)


def _is_on_surface(node: Node) -> bool:
    """Whether the graph is that of a surface: Cycles asks for no rays elsewhere."""
    return type(node.graph.owner).__name__ in ("Material", "NoneType") and not is_in_volume(node.graph)


@values("ShaderNodeAmbientOcclusion", family="Inputs", note="1 in lamps, worlds and volumes, and to light sampling")
def ambient_occlusion(node: Node) -> dict[str, Value]:
    """The share of light from around that arrives, and a colour times it."""
    color = node.color("Color")
    if not _is_on_surface(node) or node.node.samples < 1:
        return {"Color": color, "AO": node.constant(1.0)}
    distance = node.number("Distance")
    if not node.linked("Distance") and distance.number() == 0.0:
        distance = node.constant(node.graph.collections.occlusion_distance())
    bits = INSIDE * node.node.inside | ONLY_LOCAL * node.node.only_local | node.node.samples << SAMPLES_SHIFT
    seen = node.op("ambient_occlusion", node.normal(), distance, bits, *_UNANSWERED)
    return {"Color": node.times(color, seen), "AO": seen}


@values("ShaderNodeBevel", family="Inputs", note="flat in volumes, and to paths that scattered widely")
def bevel(node: Node) -> Value:
    """The normal of edges that are rounded."""
    flat = node.surface_normal()
    if not _is_on_surface(node) or node.node.samples < 1:
        return node.normal()
    rounded = node.op("bevel", flat, node.number("Radius"), ROUNDED | node.node.samples << SAMPLES_SHIFT, *_UNANSWERED)
    if not node.linked("Normal"):
        return rounded

    def maths(operation: VectorOperation, a: Value, b: Value) -> Value:
        return node.op("vector_math", operation, a, b, _NONE, 0.0)[0]

    # what bends the normal that is given bends it too
    bent = maths(VectorOperation.SUBTRACT, rounded, flat)
    summed = maths(VectorOperation.ADD, node.normal(), bent)
    return maths(VectorOperation.NORMALIZE, summed, Value.of(_NONE))
