"""Lights that some kinds of scattered rays alone see."""

import warp as wp

from ...scene.description import SCATTERED_RAYS


@wp.func
def is_lit_in_part(visibility: int) -> bool:
    """Whether a light is seen by some kinds of scattered rays but not by all.

    Such lights are left to light sampling, which knows the kinds of lobes apart; a scattered ray stands for all of
    them.
    """
    kinds = visibility & SCATTERED_RAYS
    return kinds != 0 and kinds != SCATTERED_RAYS
