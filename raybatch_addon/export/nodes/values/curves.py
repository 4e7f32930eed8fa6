"""Color Ramp and the curves, which Blender evaluates into tables."""

from __future__ import annotations

import numpy as np

from ....core.programs.builder import Value
from ....core.programs.ops.values.curves import CURVE_SIZE
from ....core.programs.ops.values.ramp import RAMP_SIZE
from ..node import Node
from ..registry import values


@values("ShaderNodeValToRGB", family="Utilities")
def color_ramp(node: Node) -> dict[str, Value]:
    """A colour and an alpha for each number from 0 to 1."""
    ramp = node.node.color_ramp
    table = [channel for x in _positions(0.0, 1.0, RAMP_SIZE) for channel in ramp.evaluate(x)]
    # Blender keeps the interpolation that ramps of HSV and HSL do not offer; Cycles uses it whatever the mode
    color, alpha = node.op("color_ramp", ramp.interpolation != "CONSTANT", node.number("Fac"), table)
    return {"Color": color, "Alpha": alpha}


@values("ShaderNodeRGBCurve", family="Utilities")
def rgb_curves(node: Node) -> Value:
    """A curve for each channel, after one for all."""
    mapping = node.node.mapping
    red, green, blue, all_channels = _curves(mapping, 4)
    low, high = _range(mapping, 4)
    table = []
    for x in _positions(low, high, CURVE_SIZE):
        common = mapping.evaluate(all_channels, x)
        table += [mapping.evaluate(each, common) for each in (red, green, blue)]
    return node.op(
        "curves", mapping.extend == "EXTRAPOLATED", node.number("Fac"), node.color("Color"), low, high, table
    )


@values("ShaderNodeVectorCurve", family="Utilities")
def vector_curves(node: Node) -> Value:
    """A curve for each component."""
    mapping = node.node.mapping
    curves = _curves(mapping, 3)
    low, high = _range(mapping, 3)
    table = [mapping.evaluate(each, x) for x in _positions(low, high, CURVE_SIZE) for each in curves]
    return node.op(
        "curves", mapping.extend == "EXTRAPOLATED", node.number("Fac"), node.vector("Vector"), low, high, table
    )


@values("ShaderNodeFloatCurve", family="Utilities")
def float_curve(node: Node) -> Value:
    """A curve for a number."""
    mapping = node.node.mapping
    (curve,) = _curves(mapping, 1)
    low, high = _range(mapping, 1)
    table = [mapping.evaluate(curve, x) for x in _positions(low, high, CURVE_SIZE)]
    return node.op(
        "float_curve", mapping.extend == "EXTRAPOLATED", node.number("Factor"), node.number("Value"), low, high, table
    )


def _curves(mapping, count: int) -> list:
    mapping.update()
    return list(mapping.curves)[:count]


def _range(mapping, count: int) -> tuple[float, float]:
    """Positions of the outermost points of the curves."""
    ends = [(curve.points[0].location[0], curve.points[-1].location[0]) for curve in list(mapping.curves)[:count]]
    return min(first for first, _ in ends), max(last for _, last in ends)


def _positions(low: float, high: float, count: int) -> list[float]:
    """`count` numbers with even steps from `low` to `high`, float32."""
    span = np.float32(high) - np.float32(low)
    return (np.float32(low) + np.arange(count, dtype=np.float32) / np.float32(count - 1) * span).tolist()
