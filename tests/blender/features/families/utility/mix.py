"""Mixing, colours, ramps and curves, alone."""

from tests.blender.features.families.utility.values import operations
from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature


def _pair(graph: Graph) -> tuple:
    """Two colours that vary, in and out of 0..1."""
    first = graph.unit
    second = graph.vector_math("MULTIPLY_ADD", graph.point, (-0.375, 0.25, 0.5), (0.5, 0.625, 0.25))
    return first, second


@feature(
    "Mix: colours", "Utility", "node", variants=operations("ShaderNodeMix", "blend_type"), quick=True, offset=128.0
)
def mix_color(graph: Graph, blend: str):
    first, second = _pair(graph)
    inputs = {"A_Color": first, "B_Color": second, "Factor_Float": 0.7}
    return graph.value("ShaderNodeMix", inputs, "Result_Color", data_type="RGBA", blend_type=blend)


@feature("Mix: colours, clamped, linked factor", "Utility", "node", variants=("MIX", "ADD", "LINEAR_LIGHT", "DIVIDE"))
def mix_color_clamped(graph: Graph, blend: str):
    first, second = _pair(graph)
    inputs = {"A_Color": first, "B_Color": second, "Factor_Float": graph.y}
    clamps = {"clamp_result": True, "clamp_factor": blend != "ADD"}
    return graph.value("ShaderNodeMix", inputs, "Result_Color", data_type="RGBA", blend_type=blend, **clamps)


@feature("Mix: numbers", "Utility", "node", variants=(True, False), quick=True)
def mix_float(graph: Graph, clamp: bool):
    inputs = {"A_Float": graph.x, "B_Float": graph.z, "Factor_Float": graph.y}
    return graph.value("ShaderNodeMix", inputs, "Result_Float", data_type="FLOAT", clamp_factor=clamp)


@feature(
    "Mix: vectors",
    "Utility",
    "node",
    variants=(("UNIFORM", True), ("NON_UNIFORM", True), ("NON_UNIFORM", False)),
    quick=True,
)
def mix_vector(graph: Graph, variant: tuple):
    mode, clamp = variant
    first, second = _pair(graph)
    inputs = {
        "A_Vector": first,
        "B_Vector": second,
        "Factor_Vector" if mode == "NON_UNIFORM" else "Factor_Float": graph.point,
    }
    return graph.value(
        "ShaderNodeMix", inputs, "Result_Vector", data_type="VECTOR", factor_mode=mode, clamp_factor=clamp
    )


@feature("Mix Color (legacy)", "Utility", "node", variants=(("OVERLAY", False), ("ADD", True)))
def mix_legacy(graph: Graph, variant: tuple):
    first, second = _pair(graph)
    return graph.value(
        "ShaderNodeMixRGB", {0: graph.y, 1: first, 2: second}, blend_type=variant[0], use_clamp=variant[1]
    )


RAMPS = (
    [("RGB", each) for each in ("LINEAR", "EASE", "B_SPLINE", "CARDINAL", "CONSTANT")]
    + [("HSV", each) for each in ("NEAR", "FAR", "CW", "CCW")]
    + [("HSL", each) for each in ("NEAR", "FAR", "CW", "CCW")]
)


@feature("Color Ramp", "Utility", "node", variants=RAMPS, quick=True)
def color_ramp(graph: Graph, variant: tuple):
    mode, interpolation = variant
    factor = graph.math(
        "MULTIPLY_ADD", graph.math("ADD", graph.x, graph.math("MULTIPLY", graph.y, 0.0625)), 0.3125, 0.5
    )
    node = graph.node("ShaderNodeValToRGB", {0: factor})
    ramp = node.color_ramp
    ramp.color_mode = mode
    if mode == "RGB":
        ramp.interpolation = interpolation
    else:
        ramp.hue_interpolation = interpolation
    ramp.elements[0].color, ramp.elements[1].color = (0.9, 0.2, 0.1, 1.0), (0.1, 0.3, 0.8, 0.4)
    ramp.elements[0].position, ramp.elements[1].position = 0.1, 0.9
    ramp.elements.new(0.4).color = (0.2, 0.8, 0.3, 0.6)
    return graph.outputs(node)


def _bend(mapping, curve: int, points: list[tuple[float, float]]) -> None:
    for x, y in points:
        mapping.curves[curve].points.new(x, y)
    mapping.update()


@feature("RGB Curves", "Utility", "node", variants=(1.0, 0.4), quick=True)
def rgb_curves(graph: Graph, factor: float):
    node = graph.node("ShaderNodeRGBCurve", {"Fac": factor, "Color": graph.unit})
    _bend(node.mapping, 0, [(0.3, 0.6)])
    _bend(node.mapping, 1, [(0.6, 0.2), (0.8, 0.9)])
    _bend(node.mapping, 3, [(0.5, 0.4)])
    return node.outputs[0]


@feature("RGB Curves: beyond the ends", "Utility", "node", variants=("HORIZONTAL", "EXTRAPOLATED"))
def rgb_curves_beyond(graph: Graph, extend: str):
    node = graph.node("ShaderNodeRGBCurve", {"Fac": 1.0, "Color": graph.point})
    node.mapping.extend = extend
    _bend(node.mapping, 2, [(0.5, 0.8)])
    return node.outputs[0]


@feature("Float Curve", "Utility", "node", variants=(1.0, 0.6), quick=True)
def float_curve(graph: Graph, factor: float):
    node = graph.node(
        "ShaderNodeFloatCurve", {"Factor": factor, "Value": graph.math("MULTIPLY_ADD", graph.x, 0.3, 0.5)}
    )
    _bend(node.mapping, 0, [(0.3, 0.7), (0.7, 0.2)])
    return node.outputs[0]


@feature("Vector Curves", "Utility", "node", variants=(1.0, 0.6), quick=True)
def vector_curves(graph: Graph, factor: float):
    node = graph.node(
        "ShaderNodeVectorCurve",
        {"Fac": factor, "Vector": graph.vector_math("MULTIPLY", graph.point, (0.45, 0.45, 0.45))},
    )
    _bend(node.mapping, 0, [(0.3, 0.7)])
    _bend(node.mapping, 2, [(-0.4, 0.3)])
    return node.outputs[0]


@feature(
    "Hue/Saturation/Value",
    "Utility",
    "node",
    variants=((0.5, 1.0, 1.0, 1.0), (0.2, 1.6, 0.7, 1.0), (0.9, 0.3, 1.5, 0.4)),
    quick=True,
)
def hue_saturation(graph: Graph, values: tuple):
    inputs = dict(zip(("Hue", "Saturation", "Value", "Fac"), values))
    return graph.value("ShaderNodeHueSaturation", inputs | {"Color": graph.unit})


@feature("Bright/Contrast", "Utility", "node", variants=((0.2, 0.5), (-0.4, -0.3)), quick=True)
def bright_contrast(graph: Graph, values: tuple):
    return graph.value("ShaderNodeBrightContrast", {0: graph.unit, 1: values[0], 2: values[1]})


@feature("Gamma", "Utility", "node", variants=(2.2, 0.4), quick=True)
def gamma(graph: Graph, value: float):
    return graph.value("ShaderNodeGamma", {0: graph.point, 1: value})


@feature("Invert Color", "Utility", "node", variants=(1.0, 0.3), quick=True)
def invert(graph: Graph, factor: float):
    return graph.value("ShaderNodeInvert", {"Fac": factor, "Color": graph.point})


@feature("RGB and Value", "Inputs", "node", flat=True, quick=True)
def rgb_and_value(graph: Graph):
    color, value = graph.node("ShaderNodeRGB"), graph.node("ShaderNodeValue")
    color.outputs[0].default_value, value.outputs[0].default_value = (0.25, 0.5, 1.75, 1), 0.625
    return {"RGB": color.outputs[0], "Value": value.outputs[0]}
