"""Numbers that end or bound paths, and what several shading stages share."""

from __future__ import annotations

import warp as wp

from ...scene.description import Frame
from ...settings.settings import RenderSettings


@wp.struct
class PathLimits:
    """From `RenderSettings` and `Frame`, for kernels."""

    seed: wp.uint32
    bounce_max: int
    # bounces of a kind; a count of 511 stands for all above
    diffuse_bounce_max: int
    glossy_bounce_max: int
    transmission_bounce_max: int
    transparent_bounce_max: int
    roulette_bounce: int
    roulette_throughput: float
    clamp_direct: float  # 0: no limit
    clamp_indirect: float
    filter_glossy: float  # 0: off
    caustics_reflective: int  # 0: left out
    caustics_refractive: int
    glass_roughness: float  # most of glass that a transparent film shows through
    nee_end: int  # light is sampled left of this column of the frame


def half_seed(seed: int, half: int) -> int:
    """The seed of a half: the render's own for half 0, for half 1 another legal seed, mixed from it (two rounds of
    Wellons' hash).
    """
    if half == 0:
        return seed
    x = (seed + 0x9E3779B9) & 0xFFFFFFFF
    x = (x ^ x >> 16) * 0x21F0AAAD & 0xFFFFFFFF
    x = (x ^ x >> 15) * 0xD35A2D97 & 0xFFFFFFFF
    x = (x ^ x >> 15) & 0x7FFFFFFF
    return x if x != seed else x ^ 1


def path_limits(settings: RenderSettings, frame: Frame, half: int = 0) -> PathLimits:
    """The limits that `settings` ask for in `frame`, for samples of this half."""
    limits = PathLimits()
    limits.seed = half_seed(settings.seed, half)
    limits.bounce_max = settings.bounce_max
    limits.diffuse_bounce_max = settings.diffuse_bounce_max
    limits.glossy_bounce_max = settings.glossy_bounce_max
    limits.transmission_bounce_max = settings.transmission_bounce_max
    limits.transparent_bounce_max = settings.transparent_bounce_max
    limits.roulette_bounce = settings.roulette_bounce
    limits.roulette_throughput = settings.roulette_throughput
    limits.clamp_direct = settings.clamp_direct
    limits.clamp_indirect = settings.clamp_indirect
    limits.filter_glossy = settings.filter_glossy
    limits.caustics_reflective = int(settings.is_on("caustics_reflective"))
    limits.caustics_refractive = int(settings.is_on("caustics_refractive"))
    limits.glass_roughness = -1.0 if frame.glass_roughness is None else frame.glass_roughness
    limits.nee_end = {"ON": frame.width, "OFF": 0, "HALF": frame.width // 2}[settings.nee]
    return limits


@wp.func
def clamped(limits: PathLimits, light: wp.vec3, bounce: int) -> wp.vec3:
    """`light` that reaches the camera over `bounce` scattering events, scaled down to the limit for it."""
    limit = limits.clamp_indirect
    if bounce <= 1:
        limit = limits.clamp_direct
    largest = wp.max(light[0], wp.max(light[1], light[2]))
    if limit > 0.0 and largest > limit:
        return light * (limit / largest)
    return light


@wp.func
def survival_of(limits: PathLimits, throughput: wp.vec3) -> float:
    """Probability with which a path of this throughput goes on where Russian roulette is played."""
    largest = wp.max(throughput[0], wp.max(throughput[1], throughput[2]))
    return wp.min(largest / limits.roulette_throughput, 1.0)


@wp.func
def has_light(light: wp.vec3) -> bool:
    """Whether any channel is above 0, or not a number: that must reach the film, which counts it."""
    return not (light[0] <= 0.0 and light[1] <= 0.0 and light[2] <= 0.0)
