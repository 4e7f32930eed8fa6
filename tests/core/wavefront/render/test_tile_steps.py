"""How far tiles go before they are shown; without a device."""

import pytest

from raybatch_addon.core.wavefront.render.steps import COST_SHARE, GROWTH_MOST, LAST_LONGER, STEP_SECONDS, TileSteps


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
