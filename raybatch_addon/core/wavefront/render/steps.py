"""How far tiles go before they are shown, where the whole frame is to be seen early. Pure policy, without a device.

A tile stops at a sample that all of its pixels have, so its picture is as good as any of that many samples. To stop it
must let its last paths come home, which keeps a worker busy with little work, and the picture must be made and shown.
So steps are as long as that costs little.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

# What stopping and showing may take of the time of a step
COST_SHARE = 0.01
# A step is not shorter: nobody looks more often [s]
STEP_SECONDS = 1.0
# A step has at most so many times the samples before it, whatever the one before cost: that may have been chance
GROWTH_MOST = 8
# The last step of a tile may be so many times as long: a rest would not pay
LAST_LONGER = 1.5
# Towards the end steps are shorter, so that workers come to it together, unless stopping and showing took so much of it
END_COST_SHARE = 0.1


class TileSteps:
    """The steps of all tiles of a render. Who works on a tile asks about it, one at a time."""

    def __init__(self) -> None:
        self._seconds_a_sample: dict[Hashable, float] = {}  # of a tile's last step
        self._stop_seconds: dict[Hashable, float] = {}  # that it took to stop then
        self._show_seconds: dict[Hashable, float] = {}  # that it took to show it then
        self._done: dict[Hashable, float] = {}  # samples so far

    def samples(self, tile: Hashable, left: int, share: float = math.inf) -> int:
        """Samples of the next step of `tile`, which has `left` to come; 1 where nothing is known of it. `share` is what
        a worker should take of all that is left at most, as samples of this tile.
        """
        seconds = self._seconds_a_sample.get(tile)
        if seconds is None:
            return min(1, left)
        cost = self._stop_seconds[tile] + self._show_seconds.get(tile, 0.0)
        wanted = max(STEP_SECONDS, cost / COST_SHARE) / max(seconds, 1e-9)
        wanted = min(wanted, GROWTH_MOST * self._done[tile], max(share, cost / END_COST_SHARE / max(seconds, 1e-9)))
        return left if left <= LAST_LONGER * wanted else max(1, math.ceil(wanted))

    def note(self, tile: Hashable, samples: int, seconds: float, stop_seconds: float) -> None:
        """A step of `samples` samples took `seconds`, of them `stop_seconds` from its last full wave to its picture."""
        self._seconds_a_sample[tile] = seconds / samples
        self._done[tile] = self._done.get(tile, 0.0) + samples
        self._stop_seconds[tile] = stop_seconds

    def note_shown(self, tile: Hashable, seconds: float) -> None:
        """To show the picture took `seconds`, on whatever thread."""
        self._show_seconds[tile] = seconds
