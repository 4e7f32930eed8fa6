"""Math, Vector Math, Map Range, Clamp, and the mixes of numbers and vectors."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.map_range import RangeInterpolation
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.vector_math import VectorOperation
from ..node import Node
from ..registry import values


@values("ShaderNodeMath", family="Utilities")
def math(node: Node) -> Value:
    """One operation on up to three numbers."""
    settings = node.node
    return node.op(
        "math", MathOperation[settings.operation], settings.use_clamp, node.number(0), node.number(1), node.number(2)
    )


@values("ShaderNodeVectorMath", family="Utilities")
def vector_math(node: Node) -> dict[str, Value]:
    """One operation on up to three vectors and a number."""
    operands = node.vector(0), node.vector(1), node.vector(2), node.number("Scale")
    vector, number = node.op("vector_math", VectorOperation[node.node.operation], *operands)
    return {"Vector": vector, "Value": number}


@values("ShaderNodeClamp", family="Utilities")
def clamp(node: Node) -> Value:
    """A number between two others."""
    return node.op(
        "clamp", node.node.clamp_type == "RANGE", node.number("Value"), node.number("Min"), node.number("Max")
    )


_RANGE = ("From Min", "From Max", "To Min", "To Max", "Steps")
_RANGE_OF_VECTORS = ("From_Min_FLOAT3", "From_Max_FLOAT3", "To_Min_FLOAT3", "To_Max_FLOAT3", "Steps_FLOAT3")


@values("ShaderNodeMapRange", family="Utilities")
def map_range(node: Node) -> Value:
    """A number or a vector from one range to another."""
    settings = node.node
    how = RangeInterpolation[settings.interpolation_type], settings.clamp
    if settings.data_type == "FLOAT_VECTOR":
        return node.op(
            "map_range_vector", *how, node.vector("Vector"), *(node.vector(key) for key in _RANGE_OF_VECTORS)
        )
    return node.op("map_range", *how, node.number("Value"), *(node.number(key) for key in _RANGE))


@values("ShaderNodeSqueeze", family="Utilities", note="Cycles leaves it out; here it is what EEVEE makes of it")
def squeeze(node: Node) -> Value:
    """A number squeezed into 0..1 by a logistic curve."""

    def computed(operation: MathOperation, a: Value | float, b: Value | float = 0.0) -> Value:
        return node.op("math", operation, False, a, b, 0.0)

    from_center = computed(MathOperation.SUBTRACT, node.number("Center"), node.number("Value"))
    power = computed(MathOperation.EXPONENT, computed(MathOperation.MULTIPLY, from_center, node.number("Width")))
    return computed(MathOperation.DIVIDE, 1.0, computed(MathOperation.ADD, power, 1.0))
