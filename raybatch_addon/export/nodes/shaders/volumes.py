"""Volume Absorption, Volume Scatter, Volume Coefficients and Principled Volume."""

from __future__ import annotations

import math

from ....core.programs.builder import Value
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.spectrum import blackbody_table
from ....core.programs.ops.values.vector_math import VectorOperation
from ..node import Node
from ..registry import shader
from ..volume_builder import is_in_volume

# Radiance of a black body at 1 K: Stefan and Boltzmann's constant over pi, in Cycles' units [1e6 W/(m² sr K⁴)]
_RADIANCE = 5.670373e-8 * 1e-6 / math.pi
_ONE, _ZERO = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


def _math(node: Node, operation: MathOperation, a, b=0.0, c=0.0) -> Value:
    return node.op("math", operation, False, a, b, c)


def _vector(node: Node, operation: VectorOperation, a, b=_ZERO) -> Value:
    return node.op("vector_math", operation, a, b, _ZERO, 0.0)[0]


def _not_negative(node: Node, value: Value) -> Value:
    return _math(node, MathOperation.MAXIMUM, value, 0.0)


def _complement(node: Node, color: Value) -> Value:
    """1 - `color`, and nowhere below 0."""
    rest = _vector(node, VectorOperation.SUBTRACT, _ONE, color)
    return _vector(node, VectorOperation.MAXIMUM, rest, _ZERO)


def _scattering(node: Node, weight: Value) -> None:
    """Scattering of coefficient `weight` by the phase function of the node."""
    phase = node.node.phase
    if phase == "FOURNIER_FORAND":
        node.closure("volume_fournier_forand", weight, node.number("IOR"), node.number("Backscatter"))
    elif phase == "DRAINE":
        node.closure("volume_draine", weight, node.number("Anisotropy"), node.number("Alpha"))
    elif phase == "RAYLEIGH":
        node.closure("volume_rayleigh", weight)
    elif phase == "MIE":
        node.closure("volume_mie", weight, node.number("Diameter"))
    else:
        node.closure("volume_henyey_greenstein", weight, node.number("Anisotropy"))


@shader("ShaderNodeVolumeAbsorption")
def volume_absorption(node: Node, weight: Value) -> None:
    """What of a colour is lacking is absorbed, times a density."""
    if is_in_volume(node.graph):
        density = _not_negative(node, node.number("Density"))
        absorbed = node.times(_complement(node, node.color("Color")), density)
        node.closure("volume_absorption", node.times(weight, absorbed))


@shader("ShaderNodeVolumeScatter")
def volume_scatter(node: Node, weight: Value) -> None:
    """A colour is scattered, times a density."""
    if is_in_volume(node.graph):
        density = _not_negative(node, node.number("Density"))
        _scattering(node, node.times(weight, node.times(node.color("Color"), density)))


@shader("ShaderNodeVolumeCoefficients")
def volume_coefficients(node: Node, weight: Value) -> None:
    """Absorption, scattering and emission by their coefficients."""
    if is_in_volume(node.graph):
        node.closure("volume_absorption", node.times(weight, node.vector("Absorption Coefficients")))
        _scattering(node, node.times(weight, node.vector("Scatter Coefficients")))
        node.closure("emission", node.times(weight, node.vector("Emission Coefficients")))


@shader("ShaderNodeVolumePrincipled")
def principled_volume(node: Node, weight: Value) -> None:
    """Scattering and absorption times a density, and emission, which is not times it."""
    if not is_in_volume(node.graph):
        return
    density = _not_negative(node, node.number("Density"))
    density = _math(node, MathOperation.MULTIPLY, density, _not_negative(node, _grid(node, "Density Attribute")[1]))
    color = node.times(node.color("Color"), _grid(node, "Color Attribute")[0])
    node.closure("volume_henyey_greenstein", node.times(weight, node.times(color, density)), node.number("Anisotropy"))
    root = _vector(node, VectorOperation.POWER, node.color("Absorption Color"), (0.5, 0.5, 0.5))
    absorbed = node.times(_complement(node, color), _complement(node, root))
    node.closure("volume_absorption", node.times(weight, node.times(absorbed, density)))
    emitted = node.times(node.color("Emission Color"), _not_negative(node, node.number("Emission Strength")))
    node.closure("emission", node.times(weight, emitted))
    if node.used("Blackbody Intensity"):
        node.closure("emission", node.times(weight, _blackbody(node)))


def _grid(node: Node, socket: str) -> tuple[Value, Value, Value]:
    """Colour, number and alpha of the grid that is named by the input `socket`; 1 where an object has none."""
    named = node.socket(socket)
    name = named.default_value if named is not None else ""
    if not (name and node.graph.collections.grids()):
        return node.constant(_ONE), node.constant(1.0), node.constant(1.0)
    return node.op("volume_attribute", node.graph.collections.attribute("GRID", name), 1.0)


def _blackbody(node: Node) -> Value:
    """Radiance of a black body per metre."""
    temperature = _not_negative(node, node.number("Temperature"))
    of_grid = _not_negative(node, _grid(node, "Temperature Attribute")[1])
    temperature = _math(node, MathOperation.MULTIPLY, temperature, of_grid)
    squared = _math(node, MathOperation.MULTIPLY, temperature, temperature)
    fourth = _math(node, MathOperation.MULTIPLY, squared, squared)
    share = _not_negative(node, node.number("Blackbody Intensity"))
    # Blender's: between 1 and the fourth power by the intensity, and nothing where that is 0
    mixed = _math(node, MathOperation.MULTIPLY_ADD, share, _math(node, MathOperation.SUBTRACT, fourth, 1.0), 1.0)
    mixed = _math(node, MathOperation.MULTIPLY, mixed, _math(node, MathOperation.GREATER_THAN, share, 0.0))
    intensity = _math(node, MathOperation.MULTIPLY, _not_negative(node, mixed), _RADIANCE)
    color = node.times(node.color("Blackbody Tint"), node.op("blackbody", temperature, blackbody_table()))
    return node.times(color, intensity)
