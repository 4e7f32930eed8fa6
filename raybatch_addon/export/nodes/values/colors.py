"""Mixes, and nodes that make and correct colours."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.color import ColorModel
from ....core.programs.ops.values.mixing import BlendMode
from ....core.programs.ops.values.spectrum import blackbody_table, wavelength_table
from ..node import Node
from ..registry import values


@values("ShaderNodeMix", family="Utilities")
def mix(node: Node) -> dict[str, Value]:
    """Two numbers, vectors or colours, mixed by a factor."""
    settings = node.node
    clamp = settings.clamp_factor
    if settings.data_type == "FLOAT":
        return {
            "Result_Float": node.op(
                "mix_float", clamp, node.number("Factor_Float"), node.number("A_Float"), node.number("B_Float")
            )
        }
    if settings.data_type == "VECTOR":
        factor = (
            node.vector("Factor_Vector")
            if settings.factor_mode == "NON_UNIFORM"
            else node.as_vector(node.number("Factor_Float"))
        )
        return {"Result_Vector": node.op("mix_vector", clamp, factor, node.vector("A_Vector"), node.vector("B_Vector"))}
    if settings.data_type == "RGBA":
        how = BlendMode[settings.blend_type], clamp, settings.clamp_result
        return {
            "Result_Color": node.op(
                "mix_color", *how, node.number("Factor_Float"), node.color("A_Color"), node.color("B_Color")
            )
        }
    node.warn(f"data type {settings.data_type}, of which the first is taken,")
    return {"": node.vector("A_Rotation")}


@values("ShaderNodeMixRGB", family="Utilities")
def mix_rgb(node: Node) -> Value:
    """Mix of colours of older Blender files; its factor is always clamped."""
    how = BlendMode[node.node.blend_type], True, node.node.use_clamp
    return node.op("mix_color", *how, node.number(0), node.color(1), node.color(2))


@values("ShaderNodeHueSaturation", family="Utilities")
def hue_saturation(node: Node) -> Value:
    """Change of hue, saturation and value."""
    numbers = (node.number(key) for key in ("Hue", "Saturation", "Value", "Fac"))
    return node.op("hue_saturation", *numbers, node.color("Color"))


@values("ShaderNodeBrightContrast", family="Utilities")
def bright_contrast(node: Node) -> Value:
    """Change of brightness and contrast."""
    return node.op("bright_contrast", node.color("Color"), node.number("Bright"), node.number("Contrast"))


@values("ShaderNodeGamma", family="Utilities")
def gamma(node: Node) -> Value:
    """Power of each channel."""
    return node.op("gamma", node.color("Color"), node.number("Gamma"))


@values("ShaderNodeInvert", family="Utilities")
def invert(node: Node) -> Value:
    """One minus the colour."""
    return node.op("invert", node.number("Fac"), node.color("Color"))


@values("ShaderNodeRGBToBW", family="Utilities")
def rgb_to_bw(node: Node) -> Value:
    """Luminance of a colour."""
    return node.as_number(node.color("Color"))


@values("ShaderNodeBlackbody", family="Utilities")
def blackbody(node: Node) -> Value:
    """The colour of a glowing body."""
    return node.op("blackbody", node.number("Temperature"), blackbody_table())


@values("ShaderNodeWavelength", family="Utilities")
def wavelength(node: Node) -> Value:
    """The colour of light of one wavelength."""
    return node.op("wavelength", node.number("Wavelength"), wavelength_table())


@values("ShaderNodeCombineColor", family="Utilities")
def combine_color(node: Node) -> Value:
    """A colour from three numbers."""
    return node.op("combine_color", ColorModel[node.node.mode], node.number(0), node.number(1), node.number(2))


@values("ShaderNodeSeparateColor", family="Utilities")
def separate_color(node: Node) -> dict[str, Value]:
    """A colour as three numbers."""
    return _parts(node, node.op("separate_color", ColorModel[node.node.mode], node.color(0)))


# handlers of nodes that Blender 4.5 still has
@values("ShaderNodeCombineRGB", family="Utilities")
def combine_rgb(node: Node) -> Value:
    """A colour from its channels."""
    return node.op("combine_color", ColorModel.RGB, node.number(0), node.number(1), node.number(2))


@values("ShaderNodeCombineHSV", family="Utilities")
def combine_hsv(node: Node) -> Value:
    """A colour from hue, saturation and value."""
    return node.op("combine_color", ColorModel.HSV, node.number(0), node.number(1), node.number(2))


@values("ShaderNodeSeparateRGB", family="Utilities")
def separate_rgb(node: Node) -> dict[str, Value]:
    """A colour's channels."""
    return _parts(node, node.op("separate_color", ColorModel.RGB, node.color(0)))


@values("ShaderNodeSeparateHSV", family="Utilities")
def separate_hsv(node: Node) -> dict[str, Value]:
    """A colour's hue, saturation and value."""
    return _parts(node, node.op("separate_color", ColorModel.HSV, node.color(0)))


def _parts(node: Node, parts: tuple[Value, Value, Value]) -> dict[str, Value]:
    return {socket.identifier: part for socket, part in zip(node.node.outputs, parts)}
