"""What was asked of tiles in a turn, condensed for the host: a byte of each."""

from __future__ import annotations

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...shading.images.tiled.look_up import MARKS, SEEN, WANTED

# Bits of a byte
WAS_SEEN, IS_WANTED = 1, 2


@wp.kernel(**KERNEL_OPTIONS)
def condense_marks_kernel(marks: wp.array(dtype=int), asked: wp.array(dtype=wp.uint8)):
    """Say of each tile whether it was read, and whether a path waits for it."""
    number = wp.tid()
    first = wp.static(MARKS) * number
    bits = wp.where(marks[first + wp.static(SEEN)] != 0, wp.static(WAS_SEEN), 0)
    if marks[first + wp.static(WANTED)] != 0:
        bits += wp.static(IS_WANTED)
    asked[number] = wp.uint8(bits)
