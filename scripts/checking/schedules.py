"""Schedules drawn at random: a value for every setting that changes time alone. Legal combinations only."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.info import SettingInfo
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings

# The device is where all of them are compared; REFERENCE meets other hits, those of Warp's tree
NOT_DRAWN = {"device"}
NOT_CHOSEN = {"batching": ("REFERENCE",)}
# Every pair is compiled by itself on CUDA, so there are few
REGISTERS_AND_BLOCKS = ((0, 0), (0, 0), (0, 0), (64, 256), (0, 64))
THREADS_MOST, WARPS_MOST, QUEUE_MOST, WAIT_MOST, PROCESSORS_MOST = 4, 512, 4096, 1000, 64
PLACES_MOST = 1 << 18  # of all blocks together: what DIRECT needs for them is still little


class Draws(Protocol):
    """Where chance comes from."""

    def pick(self, values: Sequence[Any]) -> Any:
        """One of `values`."""

    def whole(self, low: int, high: int) -> int:
        """A whole number from `low` to `high`, both included."""


class SeededDraws:
    """Draws that a seed repeats."""

    def __init__(self, *seed: int):
        self._generator = np.random.default_rng(seed)

    def pick(self, values: Sequence[Any]) -> Any:
        """See `Draws`."""
        return values[int(self._generator.integers(len(values)))]

    def whole(self, low: int, high: int) -> int:
        """See `Draws`."""
        return int(self._generator.integers(low, high, endpoint=True))


@dataclass(frozen=True)
class DrawnSizes:
    """How large the scene is: what is drawn goes a little beyond it."""

    triangles: int
    tree_bytes: int  # of all of its geometry, from above
    paths: int  # of the whole frame
    image_bytes: int = 0  # of all of its images


def drawn_schedule(draws: Draws, sizes: DrawnSizes) -> dict[str, Any]:
    """A value for each schedule setting but `NOT_DRAWN`."""
    drawn: dict[str, Any] = {
        name: draws.pick(_choices(info))
        for name, info in SETTINGS.items()
        if info.effect == "schedule" and info.choices
    }
    # most of what may go wrong is where rays wait
    drawn["batching"] = draws.pick(("ON", "ON", "ON", "ON", "AUTO", "OFF"))
    drawn["geometry_budget"] = 0
    if drawn["batching"] != "OFF" and draws.pick((True, False)):
        drawn["geometry_budget"] = _any_size(
            draws, max(sizes.tree_bytes // 64, 4096), sizes.tree_bytes + (sizes.tree_bytes >> 2) + 4096
        )
    drawn["texture_budget"] = draws.pick((0, _any_size(draws, sizes.image_bytes // 8, sizes.image_bytes)))
    drawn["texture_tile_size"] = draws.pick((SETTINGS["texture_tile_size"].default, 16, 32))
    drawn["thread_count"] = draws.whole(0, THREADS_MOST)
    drawn["tile_size"] = _zero_or_any(draws, max(2, int(sizes.paths**0.5)))
    drawn["ray_count"] = _zero_or_any(draws, 2 * sizes.paths)
    low, high = sorted(draws.whole(0, 20) / 20 for _ in range(2))
    drawn["ray_low_water"], drawn["ray_high_water"] = draws.pick(((low, high), (low, 1.0)))
    drawn["bucket_wait_max"] = _zero_or_any(draws, WAIT_MOST)
    drawn["bucket_processors"] = _zero_or_any(draws, PROCESSORS_MOST)
    # where the host is asked in each step, neither a GPU's loop nor a CPU's fused steps are tried
    drawn["treelet_cache"] = draws.pick((0, 0, 0, _any_size(draws, 1, sizes.tree_bytes)))
    drawn["treelet_prefetch"] = draws.pick(("OFF", "OFF", "OFF", "ON"))
    drawn["queues_per_ray"] = draws.pick((1, 1, 2, draws.whole(2, 8)))
    drawn["queue_size"] = size = _zero_or_any(draws, QUEUE_MOST)
    drawn["queue_count"] = _zero_or_any(draws, min(QUEUE_MOST, PLACES_MOST // max(size, 1)))
    drawn["treelet_size"] = nodes = _zero_or_any(draws, max(sizes.triangles, 2))
    drawn["treelet_size_min"] = draws.pick((1, 1, _any_size(draws, 1, nodes or max(sizes.triangles, 2))))
    drawn["treelet_bytes"] = _zero_or_any(draws, sizes.tree_bytes)
    drawn["treelet_tier_bytes"] = draws.pick((0, 0, 0, _any_size(draws, 1, sizes.tree_bytes)))
    drawn["top_level_depth_max"] = draws.pick((SETTINGS["top_level_depth_max"].default, _any_size(draws, 1, 64)))
    drawn["warp_count"] = draws.whole(0, 1) if drawn["single_lane"] == "ON" else _zero_or_any(draws, WARPS_MOST)
    drawn["register_cap"], drawn["block_size"] = draws.pick(REGISTERS_AND_BLOCKS)
    return drawn


def part_to_render(draws: Draws, frame: Frame, settings: RenderSettings, turns: int) -> Frame:
    """`frame` with a border, if need be, so that its paths come to their end in about `turns` times the bounces of one:
    with few rays alive, or tiny tiles, a whole frame takes too long."""
    x0, y0, x1, y1 = frame.region
    width, height = x1 - x0, y1 - y0
    while width * height > 1 and _turns(width, height, settings) > turns:
        width, height = (-(-width // 2), height) if width > height else (width, -(-height // 2))
    left, bottom = draws.whole(x0, x1 - width), draws.whole(y0, y1 - height)
    if (width, height) == (x1 - x0, y1 - y0):
        return frame
    return dataclasses.replace(frame, border=(left, bottom, left + width, bottom + height))


def _turns(width: int, height: int, settings: RenderSettings) -> int:
    edge = settings.tile_size or max(width, height)
    tiles = -(-width // edge) * -(-height // edge)
    paths = min(edge, width) * min(edge, height) * settings.sample_count
    alive = max(1, round(settings.ray_high_water * min(settings.ray_count or paths, paths)))
    return tiles * -(-paths // alive)


def _choices(info: SettingInfo) -> list[str]:
    return [identifier for identifier, _, _ in info.choices if identifier not in NOT_CHOSEN.get(info.name, ())]


def _any_size(draws: Draws, low: int, high: int) -> int:
    """A number that is as likely small as large."""
    bits = draws.whole(low.bit_length(), high.bit_length())
    return min(max(draws.whole(1 << bits >> 1, (1 << bits) - 1), low), high)


def _zero_or_any(draws: Draws, high: int) -> int:
    """0 lets RayBatch choose."""
    return draws.pick((0, _any_size(draws, 1, high), _any_size(draws, 1, high)))
