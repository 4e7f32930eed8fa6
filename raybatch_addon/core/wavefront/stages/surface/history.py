"""How a path has scattered so far, in one word, for programs that ask."""

import warp as wp

from ....programs.point import DEPTH_BITS, DEPTH_SHIFT, PORTAL_SHIFT, PORTALS_MOST, HistoryBits
from ....shading.bsdf.bsdf import DELTA, DIFFUSE, TRANSMISSION
from ..limits import PathLimits

_MOST = (1 << DEPTH_BITS) - 1
DEPTHS = ~((1 << DEPTH_SHIFT) - 1)  # all but the bits of the last scattering


@wp.func
def is_spent(limits: PathLimits, history: int) -> bool:
    """Whether a path has scattered as often as paths may, by one of the kinds that are counted."""
    counts = history >> wp.static(DEPTH_SHIFT)
    return (
        (counts & wp.static(_MOST)) > limits.diffuse_bounce_max
        or ((counts >> wp.static(DEPTH_BITS)) & wp.static(_MOST)) > limits.glossy_bounce_max
        or ((counts >> wp.static(2 * DEPTH_BITS)) & wp.static(_MOST)) > limits.transmission_bounce_max
    )


@wp.func
def history_behind_portal(history: int) -> int:
    """`history` of a path that passes a portal. The count stays at its largest."""
    if ((history >> wp.static(PORTAL_SHIFT)) & wp.static(PORTALS_MOST)) < wp.static(PORTALS_MOST):
        return int(wp.uint32(history) + wp.uint32(wp.static(1 << PORTAL_SHIFT)))
    return history


@wp.func
def history_after(history: int, lobe: int) -> int:
    """`history` of a path that `lobe` (bits of `shading/bsdf/bsdf.py`) scatters. Counts stay at their largest."""
    place = int(1)
    kind = wp.static(int(HistoryBits.GLOSSY))
    if (lobe & DIFFUSE) != 0:
        place = 0
        kind = wp.static(int(HistoryBits.DIFFUSE))
    elif (lobe & DELTA) != 0:
        kind = wp.static(int(HistoryBits.GLOSSY | HistoryBits.SINGULAR))
    if (lobe & TRANSMISSION) != 0:
        place = 2
    shift = wp.static(DEPTH_SHIFT) + wp.static(DEPTH_BITS) * place
    result = (history & wp.static(DEPTHS)) | kind
    if ((history >> shift) & wp.static(_MOST)) < wp.static(_MOST):
        result += 1 << shift
    return result
