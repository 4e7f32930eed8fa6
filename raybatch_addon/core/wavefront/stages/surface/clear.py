"""Clear glass: what a transparent film shows is transparent behind it too, where that is asked for.

As in Cycles a path stays as one of the camera while facets that are smooth enough send it to the other side; what it
meets then is shown as if it had met nothing before, but for its throughput.
"""

from __future__ import annotations

import functools

import warp as wp

from ....scene.features import SEEN_THROUGH
from ....shading.bsdf.bsdf import TRANSMISSION
from ....shading.bsdf.materials import BsdfSample, ClosureFeatures, ClosureRecord
from ...rays import Paths, is_clear
from ..limits import PathLimits


@functools.cache
def make_note_clear(features: ClosureFeatures) -> wp.Function:
    """Function (limits, paths, path, bounce, scattered, closures): notes whether the lobe of one of `closures` by
    which a path scatters after `bounce` scatterings leaves it clear.
    """
    is_glass = features.test(SEEN_THROUGH)

    @wp.func
    def note_clear(
        limits: PathLimits,
        paths: Paths,
        path: int,
        bounce: int,
        scattered: BsdfSample,
        closures: wp.array(dtype=ClosureRecord),
    ):
        clear = wp.uint8(0)
        if (scattered.lobe & TRANSMISSION) != 0:  # else there may be no closure
            closure = closures[scattered.closure]
            if is_glass(closure.kind) and closure.roughness <= limits.glass_roughness:
                if is_clear(paths, path, bounce):
                    clear = wp.uint8(1)
        paths.clear[path] = clear

    return note_clear
