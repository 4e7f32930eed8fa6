"""How far tiles go before they are shown; without a device."""

import heapq
import math

import numpy as np
import pytest

from raybatch_addon.core.wavefront.render.deal import Deal
from raybatch_addon.core.wavefront.render.steps import (
    COST_SHARE,
    GROWTH_MOST,
    LAST_LONGER,
    LEFT_SHARE,
    PART_LEAST,
    STEP_SECONDS,
    TileParts,
    TileSteps,
)


def rendered(seconds_a_sample: float, stop_seconds: float, samples: int) -> list[int]:
    """Samples of the steps of one tile, all of which take `stop_seconds` to stop and to show."""
    steps, found = TileSteps(), []
    while samples:
        step = steps.samples("tile", samples)
        assert 1 <= step <= samples
        found.append(step)
        samples -= step
        steps.note("tile", step, step * seconds_a_sample, 0.25 * stop_seconds)
        steps.note_shown("tile", 0.75 * stop_seconds)
    return found


@pytest.mark.parametrize("seconds_a_sample", [1e-6, 0.003, 0.1, 50.0])
@pytest.mark.parametrize("stop_seconds", [0.0, 0.001, 0.3])
def test_the_first_sample_is_shown_and_then_steps_cost_little(seconds_a_sample, stop_seconds):
    steps = rendered(seconds_a_sample, stop_seconds, 4096)
    assert steps[0] == 1 and sum(steps) == 4096
    for number, step in enumerate(steps[1:-1], 1):
        seconds, most = step * seconds_a_sample, GROWTH_MOST * sum(steps[:number])
        assert step <= most
        assert step == most or (seconds >= STEP_SECONDS and stop_seconds <= 1.0001 * COST_SHARE * seconds)
        # nor is it longer than that needs
        needed = max(STEP_SECONDS, stop_seconds / COST_SHARE)
        assert step == 1 or (step - 1) * seconds_a_sample < needed
    assert len(steps) == 1 or steps[-1] <= LAST_LONGER * GROWTH_MOST * sum(steps[:-1])


def test_tiles_that_differ_go_on_at_their_own_pace():
    steps = TileSteps()
    steps.note("sky", 1, 0.01, 0.0)
    steps.note("glass", 1, 0.5, 0.0)
    assert steps.samples("sky", 1000) == GROWTH_MOST and steps.samples("glass", 1000) == 2
    steps.note("sky", 19, 0.19, 0.0)
    assert steps.samples("sky", 1000) == 100
    assert steps.samples("new", 1000) == 1 and steps.samples("new", 0) == 0


PIXELS, SAMPLES = 1 << 16, 1024


def parted(devices: int, spread: float, seed: int, tiles_a_device: int = 16) -> tuple[float, float, list[int]]:
    """Tiles in parts, by two workers of each device, whose times differ by `spread` (standard deviation of their
    logarithm): how much later than if all was shared evenly the last one ends, as a share of that; the same of the
    first; and parts of each tile.
    """
    random, workers = np.random.default_rng(seed), 2 * devices
    seconds = np.exp(random.normal(0.0, spread, tiles_a_device * devices))  # of a sample
    left, parts, policy = [SAMPLES] * len(seconds), [0] * len(seconds), TileParts()
    deal = Deal((tile, None, math.inf) for tile in range(len(seconds)))
    free, ends = [(0.0, worker, None) for worker in range(workers)], []
    while free:
        now, worker, done = heapq.heappop(free)
        place = worker // 2
        if done is not None and left[done]:
            deal.put_back(done, place, policy.seconds(done, left[done] * PIXELS))
        tile = deal.take(place)
        if tile is None:
            ends.append(now)
            continue
        samples = policy.samples(tile, left[tile], PIXELS, LEFT_SHARE / workers * sum(left))
        assert 1 <= samples <= left[tile] and samples * PIXELS >= min(PART_LEAST, left[tile] * PIXELS)
        policy.note(tile, samples * PIXELS, samples * seconds[tile])
        left[tile] -= samples
        parts[tile] += 1
        heapq.heappush(free, (now + samples * seconds[tile], worker, tile))
    assert not any(left)
    even = SAMPLES * sum(seconds) / workers
    return max(ends) / even - 1.0, min(ends) / even - 1.0, parts


@pytest.mark.parametrize("devices", [2, 4, 8])
@pytest.mark.parametrize("spread", [0.0, 0.2, 0.35, 0.7])
def test_parts_bring_devices_to_the_end_together(devices, spread):
    found = [parted(devices, spread, seed) for seed in range(10)]
    assert np.mean([late for late, _, _ in found]) < 0.01
    assert max(late for late, _, _ in found) < 0.03 and min(early for _, early, _ in found) > -0.05
    assert max(sum(parts) for _, _, parts in found) < 4 * 16 * devices


def test_the_first_part_is_short_and_the_rest_long_as_long_as_much_is_left():
    policy = TileParts()
    assert policy.seconds("tile", 100) == math.inf
    assert policy.samples("tile", SAMPLES, PIXELS, 10.0 * SAMPLES) == SAMPLES // 4
    policy.note("tile", 256 * PIXELS, 2.0)
    assert policy.seconds("tile", 768 * PIXELS) == 6.0
    assert policy.samples("tile", 768, PIXELS, 10.0 * SAMPLES) == 768
    assert policy.samples("tile", 768, PIXELS, 200.0) == 200
    # no part is shorter than what is worth it, and no rest
    least = PART_LEAST // PIXELS
    assert policy.samples("tile", 768, PIXELS, 1.0) == least
    assert policy.samples("tile", least + 1, PIXELS, 1.0) == least + 1
    assert policy.samples("small", 5, 10, 1.0) == 5
