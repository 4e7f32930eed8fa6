"""Filter Glossy: facets are rougher to paths that came by unlikely directions, so that their light is less noisy.

It is biased, and off unless chosen. As in Cycles: a path remembers the least density of its directions so far, and
where that is below the setting, facets are at least as rough as it says.
"""

from __future__ import annotations

import functools

import warp as wp

from ....scene.description import ClosureKind
from ....shading.bsdf.materials import MICROFACET_KINDS, ClosureFeatures, ClosureRecord


@functools.cache
def make_blur(features: ClosureFeatures) -> wp.Function:
    """Function (closures, count, least_alpha: float): the facets of the first `count` closures, which belong to the
    path, get at least that alpha along either axis.
    """
    is_facets = features.test(MICROFACET_KINDS - {ClosureKind.SUBSURFACE})

    @wp.func
    def blur(closures: wp.array(dtype=ClosureRecord), count: int, least_alpha: float):
        for c in range(count):
            if is_facets(closures[c].kind):
                alpha = closures[c].roughness * closures[c].roughness
                aspect = closures[c].aspect
                along = wp.max(alpha * aspect, least_alpha)
                across = wp.max(alpha / aspect, least_alpha)
                if along > alpha * aspect or across > alpha / aspect:
                    closures[c].roughness = wp.min(wp.sqrt(wp.sqrt(along * across)), 1.0)
                    closures[c].aspect = wp.sqrt(along / across)

    return blur


@wp.func
def blur_alpha(filter_glossy: float, least_density: float) -> float:
    """The least alpha of facets to a path whose least density so far is `least_density` [1/sr]; 0: as they are."""
    likely = least_density / filter_glossy
    alpha = float(0.0)
    if likely < 1.0:
        alpha = 0.5 * wp.sqrt(1.0 - likely)
    return alpha
