"""Headers of traversals for instances and vertices that move."""

from __future__ import annotations

from .options import TraversalOptions


def motion_headers(options: TraversalOptions) -> tuple[str, ...]:
    """Headers that stand before all others."""
    return ("math/motion.h", "traverse/motion.h") if options.motion else ()
