"""Renders in rounds that are stopped and gone on with, under any schedule: none of it changes the film."""

import numpy as np
import pytest
from checking.films import FilmComparer
from checking.schedules import SeededDraws
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes, schedule_scenes
from tests.support.running.shares import each_of
from tests.support.watched_renders import (  # noqa: F401 (`halves_film` is the fixture `halves`)
    FRAME,
    HALVES,
    SETTINGS,
    TARGET,
    WatchedSession,
    Watcher,
    assert_same,
    halves_film,
    rounded_anew,
    stopping,
)

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.mark.parametrize("estimate", each_of(2, ["ON", "OFF"]))
@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_any_schedule_with_any_rounds_and_stops_gives_the_same_film(session, name, estimate, examples, pytestconfig):
    watched = WatchedSession(session)
    estimator = RenderSettings(
        sample_count=5, bounce_max=4, roulette_bounce=2, clamp_indirect=3.0, error_estimate=estimate
    )
    comparer = FilmComparer(
        watched, schedule_scenes.SCENES[name](), estimator, 16 if pytestconfig.option.thorough else 8
    )
    fixed = {"schedule": "WAVEFRONT", **schedule_scenes.not_drawn(name, pytestconfig.option.thorough)}

    @settings(max_examples=examples(15), deadline=None, derandomize=True, database=None, phases=[Phase.generate])
    @given(number=st.integers(0, 2**32 - 1))
    def compare(number):
        watched.random = np.random.default_rng(number)
        found = comparer.compare_drawn(SeededDraws(number), fixed)
        # rays are those of the last part alone; that none is lost was looked at for each
        differs = [fault for fault in found.differs if "taken in" not in fault]
        assert not differs, (number, differs, found.settings)

    compare()
    assert watched.stops > examples(10)


@pytest.fixture(scope="module")
def targeted(session):
    return session.render(scenes.mixed(FRAME), TARGET)


@pytest.mark.parametrize("sample_order", each_of(2, ["PIXEL_FIRST", "FRAME_FIRST"]))
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(number=st.integers(0, 2**32 - 1))
def test_an_error_target_is_reached_at_the_same_sample_after_stops(session, targeted, sample_order, number):
    watched = WatchedSession(session)
    watched.random = np.random.default_rng(number)
    film = watched.render(scenes.mixed(FRAME), TARGET.replace(sample_order=sample_order))
    assert film.complete and film.statistics["error"] == targeted.statistics["error"]
    assert_same(film.passes, targeted.passes)
    for half, whole in zip(film.halves, targeted.halves):
        assert_same(half.passes, whole.passes)


def test_a_film_goes_on_with_its_own_settings_alone_but_for_the_clock(session, halves):
    with stopping(10):
        film = session.render(scenes.mixed(FRAME), HALVES.replace(time_limit=1e6))
    assert not film.complete and film.statistics["stopped_by"] is None
    for change in (dict(error_estimate="OFF"), dict(error_target=0.1), dict(seed=1)):
        with pytest.raises(RayBatchError, match="other settings"):
            session.render(scenes.mixed(FRAME), HALVES.replace(**change), resume=film)
    counted = film.counts.copy()
    assert_same(session.render(scenes.mixed(FRAME), HALVES, resume=film).passes, halves.passes)
    assert np.array_equal(film.counts, counted)  # the film that was gone on with is left as it was


@pytest.mark.parametrize("estimate", ["OFF", "ON"])
@pytest.mark.parametrize("after", each_of(2, [30, 0]))
def test_a_time_limit_holds_for_a_round_that_was_begun_without(session, estimate, after):
    endless = SETTINGS.replace(sample_count=10_000_000, error_estimate=estimate, ray_count=700, tile_size=9)
    with stopping(after):
        film = session.render(scenes.mixed(FRAME), endless)
    watcher = Watcher([64])
    film = session.render(scenes.mixed(FRAME), endless.replace(time_limit=0.2), resume=film, observers=[watcher])
    samples = film.statistics["samples_per_pixel"]
    assert film.statistics["stopped_by"] == "time" and (film.counts == samples).all() and watcher.samples[-1] == samples
    assert not film.statistics["warnings"]
    assert_same(film.passes, session.render(scenes.mixed(FRAME), endless.replace(sample_count=samples)).passes)


def test_a_round_that_a_time_limit_cannot_end_is_reported(session):
    with stopping(5):
        film = session.render(scenes.mixed(FRAME), SETTINGS.replace(sample_order="PIXEL_FIRST", ray_count=100))
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(time_limit=1e-3), resume=film)
    assert film.statistics["stopped_by"] == "samples" and "PIXEL_FIRST" in film.statistics["warnings"][0]


def test_a_cancel_between_rounds_can_be_gone_on_with(session, halves):
    cancel = []
    watcher = Watcher([3])
    watcher.on_snapshot = cancel.append
    film = session.render(scenes.mixed(FRAME), HALVES, observers=[watcher], cancelled=lambda: bool(cancel))
    assert not film.complete and film.sample_count >= 3
    assert_same(session.render(scenes.mixed(FRAME), HALVES, resume=film).passes, halves.passes)


def test_a_film_that_was_stopped_twice_is_shown_as_its_sums_are(session):
    film = None
    for after in (20, 15):
        shown = []
        with stopping(after):
            film = session.render(
                scenes.mixed(FRAME),
                HALVES.replace(tile_size=9),
                observers=[Watcher([1, 2])],
                resume=film,
                on_tile=shown.append,
            )
        assert film.picture is not None and shown
        assert_same(film.passes, rounded_anew(film))
