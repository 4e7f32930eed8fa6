"""Caustics that are left out: what a diffuse ray met reflects or refracts no light sharply.

Light that a glossy surface throws on a diffuse one is found by chance alone, and noisy. Without it the picture is
darker: switches that are on unless chosen otherwise, as those of Cycles.
"""

from __future__ import annotations

import functools

import warp as wp

from ....scene.description import ClosureKind, Visibility
from ....shading.bsdf.lobes import Lobe
from ....shading.bsdf.materials import MIRROR_KINDS, PASSING_KINDS, ClosureFeatures, ClosureRecord
from ..limits import PathLimits

_K = ClosureKind
_REFLECTING = MIRROR_KINDS | {_K.ASHIKHMIN_SHIRLEY}
_TOON = wp.constant(int(_K.TOON))


@functools.cache
def make_leave_out_caustics(features: ClosureFeatures, reflective: bool, refractive: bool) -> wp.Function:
    """Function (limits, closures, first, end, lobes, ray_kind: int): takes away the lobes of facets where a ray of that
    `Visibility` is diffuse, as far as `limits` leave them out. `reflective`, `refractive`: which of the two are always
    kept. Glass counts as refractive.
    """
    is_reflecting, is_passing = features.test(_REFLECTING), features.test(PASSING_KINDS)
    without_toon = not reflective and features.has(_K.TOON)

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
                if wp.static(not refractive):
                    if limits.caustics_refractive == 0:
                        gone = gone or is_passing(closures[c].kind)
                if gone:
                    lobes[c - first].scale = wp.vec3(0.0)
                    lobes[c - first].selection = 0.0

    return leave_out_caustics
