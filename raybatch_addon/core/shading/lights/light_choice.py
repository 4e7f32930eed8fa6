"""Choice of the emitter that light sampling aims at, and its probability."""

from __future__ import annotations

import warp as wp

from .light_table import LightTable


@wp.func
def selection_pdf(table: LightTable, emitter: int) -> float:
    """Probability that light sampling aims at `emitter`."""
    if table.emitter_count == 1:
        return 1.0
    end = wp.uint32(0)  # 2^32 in 32 bits
    if emitter + 1 < table.emitter_count:
        end = table.emitter_first[emitter + 1]
    return float(end - table.emitter_first[emitter]) * wp.static(2.0**-32)


@wp.func
def choice_bits(u_choice: float, u: wp.vec2) -> wp.uint32:
    """32 random bits: the 24 of `u_choice`, and the last 8 of the 24 of `u[1]`.

    24 bits cannot choose among millions of emitters in proportion. The bits that are used twice move a point on its
    emitter by at most 2^-16 of its width.
    """
    high = wp.uint32(u_choice * wp.static(2.0**24))
    low = wp.uint32(u[1] * wp.static(2.0**24))
    return (high << wp.uint32(8)) | (low & wp.uint32(255))


@wp.func
def choose_emitter(table: LightTable, bits: wp.uint32) -> int:
    """The emitter in whose interval `bits` lies."""
    low = int(0)
    high = table.emitter_count - 1
    while low < high:
        middle = low + (high - low + 1) // 2
        if table.emitter_first[middle] <= bits:
            low = middle
        else:
            high = middle - 1
    return low
