"""How far tiles go before they are shown, where the whole frame is to be seen early, or where several devices are to
come to the end together. Pure policy, without a device.

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
# Of its part of all paths that are left, a worker begins so much of a tile before that is shown
LEFT_SHARE = 0.5
# Where tiles are rendered in parts, a worker begins so many paths at least: to bring them to their end costs little
# beside it
PART_LEAST = 1 << 23
# Share of a tile's samples in its first part at most, whose time tells how long the rest takes
FIRST_PART = 0.25
# Towards the end steps are shorter, so that workers come to it together, unless stopping and showing took so much of it
END_COST_SHARE = 0.1


class TileParts:
    """The parts of all tiles of a render that workers of several devices share, so that they come to its end together.

    A worker takes a share of what is left at most, so that the last parts are short (guided self-scheduling:
    Polychronopoulos and Kuck 1987). One tile is rendered by one worker at a time, so those that take long are to begin
    early (longest processing time first: Graham 1969): a first part says how long the rest takes.
    """

    def __init__(self) -> None:
        self._seconds_a_path: dict[Hashable, float] = {}  # of a tile's last part

    def samples(self, tile: Hashable, left: int, pixels: int, share: float) -> int:
        """Samples of the next part of `tile`, of whose `pixels` each has `left` to come. `share` is what a worker
        should take of all that is left at most, as samples of this tile.
        """
        if tile not in self._seconds_a_path:
            share = min(share, FIRST_PART * left)
        samples = math.ceil(max(share, PART_LEAST / pixels))
        return left if left <= LAST_LONGER * samples else samples

    def note(self, tile: Hashable, paths: int, seconds: float) -> None:
        """A part of `paths` paths took `seconds`."""
        if paths > 0:
            self._seconds_a_path[tile] = seconds / paths

    def seconds(self, tile: Hashable, paths: int) -> float:
        """What so many more paths of `tile` take; inf where nothing is known of it."""
        return self._seconds_a_path.get(tile, math.inf) * paths


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
