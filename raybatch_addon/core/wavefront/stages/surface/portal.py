"""Portals: a ray that meets a closure RAY_PORTAL goes on elsewhere, and counts as passing a transparent surface.

Shadow rays do not go there: a portal hides what is behind it. So light that is met behind one is found by paths alone.
"""

from __future__ import annotations

import warp as wp

from ....rays import Rays
from ....shading.bsdf.materials import PORTAL, BsdfSample, ClosureRecord
from ....shading.surface import SurfacePoint
from ...rays import Paths
from .history import history_behind_portal


@wp.func
def pass_portal(
    paths: Paths,
    rays: Rays,
    path: int,
    surface: SurfacePoint,
    closures: wp.array(dtype=ClosureRecord),
    scattered: BsdfSample,
):
    """Sends the ray of a path on to elsewhere that leaves a `surface` by a portal; leaves other rays as they are."""
    if (scattered.lobe & PORTAL) == 0:
        return
    paths.pdf[path] = 0.0
    paths.passed_t[path] = 0.0
    if paths.history.shape[0] > 0:
        paths.history[path] = history_behind_portal(paths.history[path])
    rays.t_max[path] = wp.inf
    position = closures[scattered.closure].edge
    moved = position - surface.position
    if closures[scattered.closure].distribution == 1:
        # what lies within the error of the surface's point is that point, which the ray has left already
        for axis in range(3):
            if wp.abs(moved[axis]) > surface.error[axis]:
                rays.origin[path] = position
