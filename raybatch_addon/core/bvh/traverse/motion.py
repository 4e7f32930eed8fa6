"""Headers of traversals for instances and vertices that move."""

from __future__ import annotations

from ...scene.motion import KEY_FLOATS
from .options import TraversalOptions


def motion_headers(options: TraversalOptions) -> tuple[str, ...]:
    """Headers that stand before all others."""
    return ("math/motion.h", "traverse/motion.h") if options.motion else ()


def motion_defines(options: TraversalOptions) -> dict[str, bool | int]:
    """Macros of all headers of traversals, and of these."""
    return {"MOTION": options.motion, **({"KEY_FLOATS": KEY_FLOATS} if options.motion else {})}
