"""Procedural textures except Voronoi and Gabor: Noise, White Noise, Wave, Magic, Gradient, Checker and Brick."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.textures.gradient import GradientKind
from ....core.programs.ops.textures.noise import FractalKind
from ....core.programs.ops.textures.wave import WaveKind, WaveProfile
from ..node import Node
from ..registry import values
from .mapping import texture_coordinates

_FRACTAL = ("Scale", "Detail", "Roughness", "Lacunarity", "Offset", "Gain", "Distortion")
_PROFILES = {"SIN": WaveProfile.SINE, "SAW": WaveProfile.SAW, "TRI": WaveProfile.TRIANGLE}


@values("ShaderNodeTexNoise", family="Textures")
def noise(node: Node) -> dict[str, Value]:
    """Fractal noise of 1 to 4 dimensions."""
    dimensions = int(node.node.noise_dimensions[0])
    operands = [texture_coordinates(node)] if dimensions > 1 else []
    if dimensions in (1, 4):
        operands.append(node.number("W"))
    operands += [node.number(name) for name in _FRACTAL]
    factor, color = node.op(f"noise_{dimensions}d", FractalKind[node.node.noise_type], node.node.normalize, *operands)
    return {"Fac": factor, "Color": color}


@values("ShaderNodeTexWhiteNoise", family="Textures")
def white_noise(node: Node) -> dict[str, Value]:
    """Random numbers by coordinates of 1 to 4 dimensions; coordinates without link are 0, not generated ones."""
    dimensions = int(node.node.noise_dimensions[0])
    vector = node.vector("Vector") if dimensions > 1 else node.constant((0.0, 0.0, 0.0))
    number = node.number("W") if dimensions in (1, 4) else node.constant(0.0)
    value, color = node.op("white_noise", dimensions, vector, number)
    return {"Value": value, "Color": color}


@values("ShaderNodeTexWave", family="Textures")
def wave(node: Node) -> dict[str, Value]:
    """Bands or rings."""
    settings = node.node
    direction = settings.bands_direction if settings.wave_type == "BANDS" else settings.rings_direction
    kind = WaveKind[f"{settings.wave_type}_{direction}"]
    numbers = [
        node.number(name)
        for name in ("Scale", "Phase Offset", "Distortion", "Detail", "Detail Scale", "Detail Roughness")
    ]
    factor, color = node.op("wave", kind, _PROFILES[settings.wave_profile], texture_coordinates(node), *numbers)
    return {"Fac": factor, "Color": color}


@values("ShaderNodeTexMagic", family="Textures")
def magic(node: Node) -> dict[str, Value]:
    """Sines of sums of sines."""
    factor, color = node.op(
        "magic", node.node.turbulence_depth, texture_coordinates(node), node.number("Scale"), node.number("Distortion")
    )
    return {"Fac": factor, "Color": color}


@values("ShaderNodeTexGradient", family="Textures")
def gradient(node: Node) -> dict[str, Value]:
    """Gradient by the position of a point."""
    factor, color = node.op("gradient", GradientKind[node.node.gradient_type], texture_coordinates(node))
    return {"Fac": factor, "Color": color}


@values("ShaderNodeTexChecker", family="Textures")
def checker(node: Node) -> dict[str, Value]:
    """Cubes in two colours."""
    factor, color = node.op(
        "checker", texture_coordinates(node), node.color("Color1"), node.color("Color2"), node.number("Scale")
    )
    return {"Fac": factor, "Color": color}


@values("ShaderNodeTexBrick", family="Textures")
def brick(node: Node) -> dict[str, Value]:
    """Rows of bricks in mortar."""
    settings = node.node
    colors = [node.color(name) for name in ("Color1", "Color2", "Mortar")]
    numbers = [
        node.number(name) for name in ("Scale", "Mortar Size", "Mortar Smooth", "Bias", "Brick Width", "Row Height")
    ]
    laid = (settings.offset, settings.offset_frequency, settings.squash, settings.squash_frequency)
    factor, color = node.op("brick", texture_coordinates(node), *colors, *numbers, *laid)
    return {"Fac": factor, "Color": color}
