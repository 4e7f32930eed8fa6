"""Lights that some kinds of scattered rays alone see."""

import warp as wp

from ...scene.description import SCATTERED_RAYS


@wp.func
def is_lit_in_part(visibility: int) -> bool:
    """Whether a light is not seen by all kinds of rays that surfaces scatter.

    Such lights are left to light sampling, which knows the kinds of lobes apart; a scattered ray stands for all of
    them.
    """
    return (visibility & SCATTERED_RAYS) != SCATTERED_RAYS
