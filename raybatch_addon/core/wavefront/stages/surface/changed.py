"""Closures as one path has them: blurred by Filter Glossy, or glass without one kind of caustics."""

from __future__ import annotations

import functools

import warp as wp

from ....shading.bsdf.materials import ClosureFeatures, ClosureRecord
from ...rays import Paths, visibility_of
from ..limits import PathLimits
from .caustics import darken_glass, is_half_dark
from .filter_glossy import blur_alpha, make_blur


@functools.cache
def make_change(kinds: ClosureFeatures, filter_glossy: bool) -> wp.Function:
    """Function (limits, paths, path: int, status: int, bounce: int, closures, first, end, own) -> bool: whether the
    closures, which have been looked at, are others to this path. If so they are copied to the begin of `own` and
    changed there.
    """
    blur = make_blur(kinds)

    @wp.func
    def change(
        limits: PathLimits,
        paths: Paths,
        path: int,
        status: int,
        bounce: int,
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        own: wp.array(dtype=ClosureRecord),
    ) -> bool:
        least_alpha = float(0.0)  # 0 where a path has not scattered yet, or only by likely directions
        if wp.static(filter_glossy):
            if bounce > 0 and paths.least_density.shape[0] > 0 and limits.filter_glossy > 0.0:
                least_alpha = blur_alpha(limits.filter_glossy, paths.least_density[path])
        darkens = bool(False)
        if wp.static(kinds.half_glass):
            darkens = is_half_dark(limits, visibility_of(status))
        if not (least_alpha > 0.0 or darkens):
            return False
        for c in range(first, end):
            own[c - first] = closures[c]
        if wp.static(filter_glossy):
            if least_alpha > 0.0:
                blur(own, end - first, least_alpha)
        if wp.static(kinds.half_glass):
            if darkens:
                darken_glass(limits, own, end - first)
        return True

    return change
