"""Several GPUs of one process: tiles go to whoever is free, and something is done one after another."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

TILES_A_DEVICE = 8  # docs/devices.md
TILE_SPREAD = 0.5  # of the seconds of tiles: a sky, and glass (standard deviation of their logarithm); assumed
LAST_SHARE = 0.125  # of a tile's samples that it gets in a turn towards the end; assumed


def listed(seconds: Sequence[float], rates: Sequence[float]) -> float:
    """When the last of some tasks ends that take so long at rate 1, if each goes to who is free first (Graham 1969)."""
    free = [(0.0, i) for i in range(len(rates))]
    last = 0.0
    for each in seconds:
        at, i = heapq.heappop(free)
        at += each / rates[i]
        last = max(last, at)
        heapq.heappush(free, (at, i))
    return last


def graham_bound(seconds: Sequence[float], count: int) -> float:
    """What `listed` never exceeds with `count` equal workers, whatever the order: the work shared evenly, and what the
    longest task adds (Graham, Bounds on multiprocessing timing anomalies, 1969).
    """
    return sum(seconds) / count + (1.0 - 1.0 / count) * max(seconds)


def amdahl(count: float, serial: float) -> float:
    """The speedup of `count` where the share `serial` of the work of one is not shared (Amdahl 1967)."""
    return 1.0 / (serial + (1.0 - serial) / count)


def serial_share(count: float, speedup: float) -> float:
    """The inverse of `amdahl`."""
    return (count / speedup - 1.0) / (count - 1.0)


def process_seconds(seconds: float, count: int, serial: float, seed: int = 0) -> float:
    """What a picture takes `count` GPUs of a process that takes one so long: the share `serial` is done by one after
    another, the rest is tiles that are dealt, the last turns of each being shorter.
    """
    random = np.random.default_rng(seed)
    tiles = np.exp(random.normal(0.0, TILE_SPREAD, TILES_A_DEVICE * count))
    tiles *= (1.0 - serial) * seconds / tiles.sum()
    whole, rest = int(0.5 / LAST_SHARE), round(1.0 / LAST_SHARE)
    turns = [tiles * whole * LAST_SHARE, *(tiles * LAST_SHARE for _ in range(rest - whole))]
    return serial * seconds + listed(np.concatenate(turns).tolist(), [1.0] * count)
