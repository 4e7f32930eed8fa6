"""What traversals are made of where instances and vertices move."""

from __future__ import annotations

from .options import TraversalOptions


def motion_headers(options: TraversalOptions) -> tuple[str, ...]:
    """Headers that stand before all others."""
    return ("math/motion.h", "traverse/motion.h") if options.motion else ()
