"""Worlds by programs: an image of which one texel is lit, a sun far brighter than its sky, white all around."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.scene.description import Image, Scene, World
from raybatch_addon.core.shading.images.textures import Interpolation
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.uniform import ROUNDING, STATISTICS, UNIT_ROUNDOFF, add_mean, floor_of

# Directions and their image coordinates are rounded a dozen times: relative to the height of a row of 8192 columns, pi
# / 4096
EDGE = 12 * UNIT_ROUNDOFF / (math.pi / 4096)


def under_image(pixels: np.ndarray, size: int) -> Scene:
    """A white floor under an image in longitudes and latitudes, the bottom row first.

    The world is sampled by a table `size` texels wide.
    """
    builder = ProgramBuilder()
    projection = int(EnvironmentProjection.EQUIRECTANGULAR)
    color, _ = builder.value("environment", 0, int(Interpolation.CLOSEST), projection, 0, builder.value("position", 0))
    builder.closure("emission", color)
    return dataclasses.replace(
        floor_of(), world=World(program=builder.finish(), sampling_size=size), images=(Image("sky", pixels),)
    )


def irradiance_over_pi(rows: np.ndarray, height: int, columns: int, width: int) -> float:
    """Irradiance over pi of a floor under texels of radiance 1, all above the horizon.

    The texels are in `rows` (from below) of `height`, and in `columns` of `width` columns.
    """
    low = rows / height * math.pi - math.pi / 2
    high = (rows + 1) / height * math.pi - math.pi / 2
    # the integral of sin(elevation) cos(elevation) over a row's elevations
    return float(((np.sin(high) ** 2 - np.sin(low) ** 2) / 2).sum()) * 2 * math.pi * columns / width / math.pi


@case(
    "one lit texel of 8192 x 4096",
    "worlds",
    "A black image of 8192 x 4096 texels but for one, at elevations of 1 and 45 degrees; the floor's irradiance is "
    "the integral of the cosine over the texel.",
    f"{STATISTICS}; 64 roundings; and what rounding moves across the texel's edges: {EDGE:.1g} of its height.",
)
def one_lit_texel(bench: Bench) -> Outcome:
    """Sweep over elevations."""
    sweep = Sweep()
    height, width = 4096, 8192
    pixels = np.zeros((height, width, 1), np.uint8)
    for degrees in (1.0, 45.0):
        row = int((degrees + 90) / 180 * height)
        pixels[row, 1234] = 255
        picture = bench.render(under_image(pixels.copy(), width), sample_count=64)
        pixels[row, 1234] = 0
        add_mean(
            sweep,
            picture,
            irradiance_over_pi(np.array([row]), height, 1, width),
            ROUNDING + 4 * EDGE,
            f"{degrees:g} degrees",
        )
    return sweep.outcome()


@case(
    "a sun of 1e5 times its sky",
    "worlds",
    "A sky of radiance 1 in 4096 x 2048 texels, of which a square of 6 x 6 at an elevation of 50 degrees has 1e5, "
    "sampled by tables of 4096, 512 and 64 texels: irradiance is pi and the integral over the sun.",
    f"{STATISTICS}; 64 roundings; and what rounding moves across the sun's edges: {EDGE:.1g} of a texel of six.",
    quick=True,
)
def bright_sun(bench: Bench) -> Outcome:
    """Sweep over sizes of tables."""
    sweep = Sweep()
    height, width = 2048, 4096
    rows = np.arange(6) + int((50 + 90) / 180 * height)
    pixels = np.ones((height, width, 1), np.float32)
    pixels[rows, 100:106] = 1e5
    expected = 1.0 + (1e5 - 1) * irradiance_over_pi(rows, height, 6, width)
    for size in (4096, 512, 64):
        picture = bench.render(under_image(pixels, size), sample_count=256)
        add_mean(sweep, picture, expected, ROUNDING + EDGE, f"{size} texels")
    return sweep.outcome()


@case(
    "white worlds by programs",
    "worlds",
    "A white floor under an image that is white everywhere has radiance 1, whatever the size of the table, down to "
    "one texel, and however light is found.",
    f"{STATISTICS}, and 64 roundings.",
    quick=True,
)
def white_world(bench: Bench) -> Outcome:
    """Sweep over sizes and ways of sampling."""
    sweep = Sweep()
    pixels = np.full((2, 4, 1), 255, np.uint8)
    for size in (1, 2, 1000):
        for change in ({}, {"mis": "OFF"}, {"nee": "OFF"}):
            picture = bench.render(under_image(pixels, size), sample_count=64, **change)
            add_mean(sweep, picture, 1.0, ROUNDING, f"{size} texels {change}")
    return sweep.outcome()
