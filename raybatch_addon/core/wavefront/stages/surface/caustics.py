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

_K = ClosureKind
_REFLECTING = MIRROR_KINDS | {_K.ASHIKHMIN_SHIRLEY}
_TOON = wp.constant(int(_K.TOON))


@functools.cache
def make_leave_out_caustics(features: ClosureFeatures, reflective: bool, refractive: bool) -> wp.Function:
    """Function (closures, first, end, lobes, ray_kind: int): takes away the lobes of facets where a ray of that
    `Visibility` is diffuse. `reflective`, `refractive`: which of the two are kept. Glass counts as refractive.
    """
    none = frozenset()
    is_left_out = features.test((none if reflective else _REFLECTING) | (none if refractive else PASSING_KINDS))
    without_toon = not reflective and features.has(_K.TOON)

    @wp.func
    def leave_out_caustics(
        closures: wp.array(dtype=ClosureRecord), first: int, end: int, lobes: wp.array(dtype=Lobe), ray_kind: int
    ):
        if ray_kind == wp.static(int(Visibility.DIFFUSE)):
            for c in range(first, end):
                gone = is_left_out(closures[c].kind)
                if wp.static(without_toon):
                    gone = gone or (closures[c].kind == _TOON and closures[c].distribution == 1)
                if gone:
                    lobes[c - first].scale = wp.vec3(0.0)
                    lobes[c - first].selection = 0.0

    return leave_out_caustics
