"""Renders that show the whole frame early and refine it: what is shown, and that the film is the same."""

import time

import numpy as np
import pytest

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.film import Film
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import steps
from tests.support import scenes, schedule_scenes
from tests.support.under_test import DEVICE
from tests.support.watched_renders import (  # noqa: F401 (`halves_film` is the fixture `halves`)
    FRAME,
    HALVES,
    SETTINGS,
    Watcher,
    assert_same,
    box_of,
    halves_film,
    rounded_anew,
    stopping,
)

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

PROGRESSIVE = dict(tile_order="PROGRESSIVE", tile_size=12)
WAYS = {
    "one worker": dict(thread_count=1),
    "three workers": dict(thread_count=3, tile_size=7),
    "batched": dict(batching="ON", debug_checks="ON"),
    "few rays": dict(ray_count=50, ray_low_water=0.2),
}


@pytest.fixture(autouse=True)
def steps_of_one_sample(monkeypatch):
    """No tile gets more than one sample before it is shown: otherwise steps follow the clock."""
    monkeypatch.setattr(steps, "STEP_SECONDS", 0.0)
    monkeypatch.setattr(steps, "COST_SHARE", 1e30)


@pytest.fixture(scope="module")
def plain(session) -> Film:
    return session.render(scenes.mixed(FRAME), SETTINGS)


@pytest.mark.parametrize("way", WAYS)
def test_the_film_is_that_of_tiles_one_after_another(session, plain, way):
    shown = []
    settings = SETTINGS.replace(**{**PROGRESSIVE, **WAYS[way]})
    film = session.render(scenes.mixed(FRAME), settings, on_tile=shown.append)
    assert len(shown) == SETTINGS.sample_count * len({box_of(tile) for tile in shown})
    assert film.complete and film.statistics["rays"] == plain.statistics["rays"]
    assert_same(film.passes, plain.passes)
    assert_same(film.passes, rounded_anew(film))
    assert np.array_equal(film.sums.window, plain.sums.window)


def test_the_whole_frame_is_shown_with_each_sample_and_is_right(session):
    scene, shown = scenes.mixed(FRAME), []
    settings = SETTINGS.replace(
        **PROGRESSIVE, thread_count=1, ray_count=1000
    )  # one worker, so that tiles have an order
    session.render(scene, settings, on_tile=lambda tile: shown.append((box_of(tile), tile.passes)))
    boxes = [box for box, _ in shown]
    count = len(set(boxes))
    assert count == 4 and boxes == boxes[:count] * SETTINGS.sample_count
    for samples in (1, 3):
        expected = session.render(scene, settings.replace(sample_count=samples))
        for (x, y, width, height), passes in shown[(samples - 1) * count : samples * count]:
            assert_same(passes, expected.part(x, y, width, height))


@pytest.mark.parametrize("changes", [dict(sample_order="PIXEL_FIRST"), dict(tile_order="AUTO"), "paged"])
def test_where_it_is_not_wanted_or_does_not_pay_tiles_are_shown_once(session, plain, changes):
    if changes == "paged":
        changes = dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000)
    shown = []
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(**{**PROGRESSIVE, **changes}), on_tile=shown.append)
    assert len(shown) == len({box_of(tile) for tile in shown})
    assert_same(film.passes, plain.passes)


def test_halves_and_rounds_are_refined_too(session, halves):
    watcher, shown = Watcher([3]), []
    settings = HALVES.replace(**PROGRESSIVE)
    film = session.render(scenes.mixed(FRAME), settings, observers=[watcher], on_tile=shown.append)
    assert watcher.samples == [3, 7] and len(shown) == 4 * (2 + 2)  # a step has a sample of each half
    for mine, expected in zip((film, *film.halves), (halves, *halves.halves), strict=True):
        assert_same(mine.passes, expected.passes)


def test_pixels_that_end_early_end_at_the_same_sample(session):
    adaptive = SETTINGS.replace(
        sample_count=40, adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8, thread_count=2
    )
    expected = session.render(scenes.mixed(FRAME), adaptive)
    film = session.render(scenes.mixed(FRAME), adaptive.replace(**PROGRESSIVE))
    assert np.array_equal(film.counts, expected.counts)
    assert_same(film.passes, expected.passes)


@pytest.mark.parametrize("after", [3, 40, 90])
@pytest.mark.parametrize("then", ["PROGRESSIVE", "TILE_FIRST"])
def test_a_stopped_render_goes_on_to_the_same_film(session, plain, after, then):
    settings = SETTINGS.replace(**PROGRESSIVE)
    with stopping(after):
        film = session.render(scenes.mixed(FRAME), settings)
    assert not film.complete
    film = session.render(scenes.mixed(FRAME), settings.replace(tile_order=then), resume=film)
    assert film.complete
    assert_same(film.passes, plain.passes)


class FrequentCheckpoint(Checkpoint):
    """Is due when it is told so."""

    due, kept, looks, begun = False, 0, 0, 0

    def is_due(self):
        return self.due

    def keep(self, state):
        self.due, self.kept, self.looks = False, self.kept + 1, 0
        self.begun = sum(each.items_begun for each in state.states)
        super().keep(state)
        self.wait()


@pytest.mark.parametrize(("after", "workers"), [(2, 1), (7, 1), (7, 2), (23, 1)])
@pytest.mark.parametrize("settings", [SETTINGS, HALVES], ids=["plain", "halves"])
def test_no_tile_gets_ahead_where_the_film_is_kept_often(session, tmp_path, monkeypatch, settings, after, workers):
    """The workers stop for a copy of the film whenever they have looked `after` times whether they are to stop, since
    they began a path: within a step, or behind a few.
    """
    # a GPU has one worker with so few rays
    settings = settings.replace(**PROGRESSIVE, thread_count=workers, ray_count=1000, sample_count=12)
    expected = session.render(scenes.mixed(FRAME), settings)
    keeper, states, most_ahead = FrequentCheckpoint(tmp_path / "a.checkpoint"), {}, [0.0]
    render = integrator.TileIntegrator.render

    def watched(self, state, first, count, stop, most):
        def tells():
            keeper.looks += sum(each.items_begun for each in states.values()) > keeper.begun
            if keeper.looks >= after:
                keeper.due = True
                while not stop():
                    time.sleep(0.0002)
            return stop()

        states[box_of(state.tile), state.half] = state
        tile = render(self, state, first, count, tells, most)
        if len(states) == 4 * settings.half_count:
            begun = [each.items_begun / each.pixel_count for each in states.values()]
            most_ahead[0] = max(most_ahead[0], max(begun) - min(begun))
        return tile

    monkeypatch.setattr(integrator.TileIntegrator, "render", watched)
    film = session.render(scenes.mixed(FRAME), settings, checkpoint=keeper)
    assert film.complete and keeper.kept > 4
    assert len(states) == 4 * settings.half_count and 0 < most_ahead[0] <= workers
    assert_same(film.passes, expected.passes)
