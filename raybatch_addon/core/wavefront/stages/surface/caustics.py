"""Caustics that are left out: what a diffuse ray met reflects or refracts no light sharply.

Light that a glossy surface throws on a diffuse one is found by chance alone, and noisy. Without it the picture is
darker: switches that are on unless chosen otherwise, as those of Cycles.
"""

from __future__ import annotations

import functools

import warp as wp

from ....scene.description import ClosureKind, Visibility
from ....shading.bsdf.lobes import Lobe
from ....shading.bsdf.materials import MIRROR_KINDS, NO_REFLECTION, ClosureFeatures, ClosureRecord
from ..limits import PathLimits

_K = ClosureKind
_REFLECTING = MIRROR_KINDS | {_K.ASHIKHMIN_SHIRLEY}
_GLASS = wp.constant(int(_K.GLASS))
_REFRACTION = wp.constant(int(_K.REFRACTION))
_TOON = wp.constant(int(_K.TOON))


@functools.cache
def make_leave_out_caustics(features: ClosureFeatures, reflective: bool, refractive: bool) -> wp.Function:
    """Function (limits, closures, first, end, lobes, ray_kind: int): takes away the lobes of facets where a ray of that
    `Visibility` is diffuse, as far as `limits` leave them out. `reflective`, `refractive`: which of the two are always
    kept. Glass goes where both are left out; `darken_glass` is for one of the two.
    """
    is_reflecting = features.test(_REFLECTING)
    without_toon = not reflective and features.has(_K.TOON)
    without_glass = not (reflective or refractive) and features.has(_K.GLASS)
    without_refraction = not refractive and features.has(_K.REFRACTION)

    @wp.func
    def leave_out_caustics(
        limits: PathLimits,
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        ray_kind: int,
    ):
        if ray_kind == wp.static(int(Visibility.DIFFUSE)):
            for c in range(first, end):
                gone = bool(False)
                if wp.static(not reflective):
                    if limits.caustics_reflective == 0:
                        gone = is_reflecting(closures[c].kind)
                        if wp.static(without_toon):
                            gone = gone or (closures[c].kind == _TOON and closures[c].distribution == 1)
                        if wp.static(without_glass):
                            gone = gone or (closures[c].kind == _GLASS and limits.caustics_refractive == 0)
                if wp.static(without_refraction):
                    if limits.caustics_refractive == 0:
                        gone = gone or closures[c].kind == _REFRACTION
                if gone:
                    lobes[c - first].scale = wp.vec3(0.0)
                    lobes[c - first].selection = 0.0

    return leave_out_caustics


@wp.func
def is_half_dark(limits: PathLimits, ray_kind: int) -> bool:
    """Whether glass that a ray of that `Visibility` has met reflects alone, or refracts alone."""
    return ray_kind == wp.static(int(Visibility.DIFFUSE)) and limits.caustics_reflective != limits.caustics_refractive


@wp.func
def darken_glass(limits: PathLimits, closures: wp.array(dtype=ClosureRecord), count: int):
    """Take from the first `count` closures, which belong to the path and have been looked at, what glass reflects or
    what it refracts, whichever is left out. The light that would go there is lost.
    """
    for c in range(count):
        if closures[c].kind == _GLASS:
            if limits.caustics_reflective == 0:
                closures[c].multiscatter = NO_REFLECTION
            else:
                closures[c].refraction = wp.vec3(0.0)
