"""How much of a device's budget is for pages that it holds for all devices: pure policy, without a device."""

from __future__ import annotations

from typing import NamedTuple

from ....errors import OutOfMemoryError

# Of the budget at most: the rest is for what stays on the device, and for pages that are brought in
PEER_SHARE_MOST = 0.7


class ShareTooLargeError(OutOfMemoryError):
    """The shares of pages leave too little of the budget for anything else: without them it may be enough."""


class Hold(NamedTuple):
    """A way to hold pages."""

    share: int  # bytes of pages that each device holds at most; 0: all lie in host memory
    encoded: bool  # triangles are packed


def ways_to_hold(budget: int, count: int, plain: int, packed: int | None) -> list[Hold]:
    """Ways for `count` devices with this `budget` each [bytes], the best first.

    `plain` and `packed`: bytes of all pages as the device has them, and with triangles packed (None: they never are).
    Where the shares hold all pages plain, those that a device holds itself are read where they lie, and rays can read
    the others' too; packed ones are fewer bytes for shares that are short of them. Then come smaller shares, and none,
    for budgets that have little room beside what stays on the device.
    """
    most = int(PEER_SHARE_MOST * budget)
    each = -(-plain // count)
    first = Hold(each, False) if each <= most or packed is None else Hold(-(-packed // count), True)
    last = packed is not None
    return [Hold(min(first.share, most), first.encoded), Hold(min(first.share, most // 2), last), Hold(0, last)]
