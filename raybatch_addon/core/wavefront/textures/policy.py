"""Which tiles of images are brought next, and which stay: pure policy, without Warp or a device."""

from __future__ import annotations

import numpy as np

# The share of the slots that tiles may always take that are missing, however many of those there are wanted
_ROOM = 4
_FIRST = np.int64(1) << 40  # more than any count of look-ups


def choose_tiles(urgency: np.ndarray, is_there: np.ndarray, slots: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the tiles to bring, at most `most`, and of those that stay, among tiles that waiting rays want, where
    there are so many `slots`. `urgency` [n], by `urgency_of`; `is_there` [n]: the tile is in a slot.

    What is there stays for rays that go on with it next, and what most rays want comes. The tiles of the ray that leads
    stay, and come first, so that it has all of them after some turns.
    """
    missing, kept = np.flatnonzero(~is_there), np.flatnonzero(is_there)
    leading = int((urgency[kept] >= _FIRST).sum())
    room = max(slots - len(kept), min(max(1, slots // _ROOM), slots - leading))
    missing = _first_of(missing, urgency, min(room, most))
    return missing, _first_of(kept, urgency, slots - len(missing))


def urgency_of(counts: np.ndarray, leads: np.ndarray) -> np.ndarray:
    """How urgent tiles are, int64: by how many look-ups wait for each; those first that the ray that leads needs."""
    return counts.astype(np.int64) + np.where(leads, _FIRST, 0)


def _first_of(places: np.ndarray, urgency: np.ndarray, count: int) -> np.ndarray:
    """The `count` most urgent of `places`, or all."""
    if count >= len(places):
        return places
    return np.sort(places[np.argpartition(-urgency[places], count - 1)[:count]]) if count > 0 else places[:0]
