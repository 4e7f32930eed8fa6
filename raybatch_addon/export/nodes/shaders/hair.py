"""Hair BSDF and Principled Hair BSDF."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.spaces import Space, VectorKind
from ....core.programs.ops.values.vector_math import VectorOperation
from ....core.scene.description import ClosureKind
from ..inputs.attributes import mesh_attribute
from ..node import Node
from ..registry import shader

_K = ClosureKind


@shader(
    "ShaderNodeBsdfHair",
    kinds=lambda node: (_K.HAIR_REFLECTION if node.node.component == "Reflection" else _K.HAIR_TRANSMISSION,),
    note="on meshes, where no tangent is linked, the fibres run in no particular direction",
)
def hair(node: Node, weight: Value) -> None:
    """A lobe that reflects, or one that passes light."""
    op = "hair_reflection" if node.node.component == "Reflection" else "hair_transmission"
    tangent = node.vector("Tangent") if node.linked("Tangent") else node.constant((0.0, 0.0, 0.0))
    widths = node.number("RoughnessU"), node.number("RoughnessV")
    node.closure(op, node.times(weight, node.color("Color")), *widths, node.number("Offset"), tangent)


@shader(
    "ShaderNodeBsdfHairPrincipled",
    kinds=lambda node: (_K.FACET_HAIR, _K.TRANSPARENT) if node.node.model == "HUANG" else (_K.PRINCIPLED_HAIR,),
    note="on meshes the fibres, and on particle hair the ellipses, lie in no particular direction",
)
def principled_hair(node: Node, weight: Value) -> None:
    """A fibre that absorbs."""
    random = node.number("Random") if node.linked("Random") else mesh_attribute(node, "CURVE", "random")[1]

    def varied(value: Value, by: str) -> Value:
        """`value` times a random factor from 1 - `by` to 1 + `by`."""
        if not node.used(by):
            return value
        amount = node.op("clamp", 0, node.number(by), 0.0, 1.0) if by == "Random Color" else node.number(by)
        spread = _math(node, "MULTIPLY", _math(node, "SUBTRACT", _math(node, "MULTIPLY", random, 2.0), 1.0), amount)
        return _math(node, "MULTIPLY", value, _math(node, "ADD", spread, 1.0))

    along = varied(node.number("Roughness"), "Random Roughness")
    huang = node.node.model == "HUANG"
    around = along if huang else varied(node.number("Radial Roughness"), "Random Roughness")
    kind = node.node.parametrization
    if kind == "ABSORPTION":
        sigma = node.vector("Absorption Coefficient")
    elif kind == "MELANIN":
        amount = varied(node.number("Melanin"), "Random Color")
        of_melanin = node.op("hair_absorption_of_melanin", amount, node.number("Melanin Redness"))
        tint = node.op("hair_absorption_of_color", node.color("Tint"), around)
        sigma = node.op("vector_math", VectorOperation.ADD, of_melanin, tint, (0.0, 0.0, 0.0), 1.0)[0]
    else:
        sigma = node.op("hair_absorption_of_color", node.color("Color"), around)
    if huang:
        factors = [node.number(name, 1.0) for name in ("Reflection", "Transmission", "Secondary Reflection")]
        ellipse = node.number("Aspect Ratio", 1.0), node.number("IOR"), node.number("Offset")
        own = mesh_attribute(node, "CURVE", "normal")[0]
        major = node.op("vector_transform", VectorKind.NORMAL, Space.OBJECT, Space.WORLD, own)
        node.closure("facet_hair", weight, sigma, along, *ellipse, node.op("combine_xyz", *factors), major)
        return
    coat = node.number("Coat")
    node.closure("principled_hair", weight, sigma, along, around, coat, node.number("IOR"), node.number("Offset"))


def _math(node: Node, operation: str, a: Value | float, b: Value | float) -> Value:
    return node.op("math", MathOperation[operation], False, a, b, 0.0)
