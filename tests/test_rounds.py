"""Renders in rounds: what is shown on the way, halves, stopping, and that none of it changes the film."""

import contextlib
import dataclasses
import json

import numpy as np
import pytest
import scenes
import schedule_scenes
from checking.films import FilmComparer
from checking.schedules import SeededDraws
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from under_test import DEVICE

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film
from raybatch_addon.core.film.half_error import half_error
from raybatch_addon.core.scene.description import ClosureKind, Frame, World
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.rounds import half_seed

PASSES = ("Combined", "Depth", "Normal", "Position")
FRAME = Frame(24, 20, passes=PASSES)
# Renders of this file are of `scenes.mixed` with these settings where they can be: kernels are compiled for what a scene and its settings need
SETTINGS = RenderSettings(sample_count=7, bounce_max=5, roulette_bounce=2, clamp_indirect=3.0)
HALVES = SETTINGS.replace(error_estimate="ON")
TARGET = SETTINGS.replace(sample_count=512, error_target=0.05, tile_size=9)
WAYS = {
    "unbatched": dict(batching="OFF"), "small tiles": dict(tile_size=7, thread_count=3), "batched": dict(batching="ON", debug_checks="ON"),
    "by value": dict(batching="ON", ray_storage="DIRECT", queue_size=2, queue_count=3, ray_count=50), "paged": dict(debug_checks="ON"),
    "pixel first": dict(sample_order="PIXEL_FIRST", tile_size=9, ray_count=100),
}  # fmt: skip


def settings_of(way: str) -> dict:
    return {**WAYS[way], **(dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000) if way == "paged" else {})}


@pytest.fixture(scope="module")
def session(device, tmp_path_factory):
    opened = Session(device, page_folder=tmp_path_factory.mktemp("pages"))
    yield opened
    opened.close()


class Watcher:
    """Wants snapshots at `wanted`."""

    def __init__(self, wanted):
        self.wanted, self.got = wanted, []

    def snapshot_samples(self, sample_count):
        return self.wanted

    def on_snapshot(self, snapshot):
        self.got.append(snapshot)

    @property
    def samples(self) -> list[int]:
        return [snapshot.samples for snapshot in self.got]


def assert_same(passes, expected):
    assert passes.keys() == expected.keys()
    for name in expected:
        assert np.array_equal(passes[name], expected[name]), name


def rounded_anew(film: Film) -> dict[str, np.ndarray]:
    """Its passes, made of the sums on the host."""
    return film.merge(Film.empty(FRAME)).passes


@pytest.fixture(scope="module")
def plain(session):
    return session.render(scenes.mixed(FRAME), SETTINGS)


@pytest.fixture(scope="module")
def halves(session):
    return session.render(scenes.mixed(FRAME), HALVES)


# --- snapshots


@pytest.mark.parametrize("way", WAYS)
def test_snapshots_are_the_films_of_fewer_samples_and_change_nothing(session, plain, way):
    watcher, more = Watcher([1, 2, 4, 100]), settings_of(way)
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(**more), observers=[watcher])
    assert_same(film.passes, plain.passes)
    assert_same(rounded_anew(film), plain.passes)
    assert np.array_equal(film.counts, plain.counts) and film.sample_total == plain.sample_total
    assert film.statistics["rays"] == plain.statistics["rays"] and film.complete
    assert watcher.samples == [1, 2, 4, 7]
    for snapshot in watcher.got[:-1]:
        fewer = session.render(scenes.mixed(FRAME), SETTINGS.replace(sample_count=snapshot.samples))
        assert np.array_equal(snapshot.picture, fewer.passes["Combined"][..., :3])
        assert snapshot.rays == {"bounced" if kind == "bounce" else kind: n for kind, n in fewer.statistics["rays"].items() if kind != "total"}
    last = watcher.got[-1]
    assert np.array_equal(last.picture, plain.passes["Combined"][..., :3]) and last.halves is None
    assert last.picture.dtype == np.float32 and last.picture.shape == (20, 24, 3)


def test_what_a_snapshot_tells(session):
    one, other = Watcher([2, 1]), Watcher([2, 3])
    calls = []
    nobody = type("Nobody", (), {"on_tile": lambda self, tile: calls.append(tile)})()
    film = session.render(scenes.mixed(FRAME), SETTINGS, observers=[one, nobody, other])
    assert one.samples == [1, 2, 7] and other.samples == [2, 3, 7] and len(calls) > 4
    seconds = [snapshot.seconds for snapshot in one.got]
    assert seconds == sorted(seconds) and seconds[0] > 0
    assert all(snapshot.seconds <= snapshot.seconds_total <= film.statistics["seconds"]["total"] for snapshot in one.got)
    assert one.got[1].picture.base is not other.got[0].picture.base or one.got[1].picture.base is None
    one.got[1].picture[:] = 0  # its own copy
    assert other.got[0].picture.any() and film.passes["Combined"][..., :3].any()
    assert not any(snapshot.invalid_samples for snapshot in one.got)


def test_what_an_observer_raises_ends_the_render(session):
    watcher = Watcher([2])
    watcher.on_snapshot = lambda snapshot: 1 / 0
    with pytest.raises(ZeroDivisionError):
        session.render(scenes.mixed(FRAME), SETTINGS, observers=[watcher])


def test_tiles_are_shown_each_round_and_progress_never_goes_back(session):
    shown, shares = [], []
    watcher = Watcher([1, 3])
    settings = HALVES.replace(tile_size=12)
    film = session.render(
        scenes.mixed(FRAME), settings, observers=[watcher], on_tile=shown.append,
        on_progress=lambda progress: shares.append(progress.fraction) if progress.stage == "render" else None,
    )  # fmt: skip
    assert len(shown) == 3 * 4
    for tile in shown[-4:]:
        assert_same(tile.passes, {n: v[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] for n, v in film.passes.items()})
    assert shares == sorted(shares) and shares[-1] == 1.0


# --- halves


@pytest.mark.parametrize("way", WAYS)
def test_halves_are_renders_with_seeds_of_their_own(session, halves, way):
    watcher = Watcher([1, 3])
    film = session.render(scenes.mixed(FRAME), HALVES.replace(**settings_of(way)), observers=[watcher])
    parts = [
        session.render(scenes.mixed(FRAME), SETTINGS.replace(sample_count=count, seed=half_seed(0, half)))
        for half, count in ((0, 4), (1, 3))
    ]
    merged = parts[0].merge(parts[1])
    for name in ("Combined", "Normal"):
        assert np.array_equal(film.passes[name], merged.passes[name]), name
    for name in ("Depth", "Position"):
        assert np.array_equal(film.passes[name], parts[0].passes[name]) and not film.halves[1].passes[name].any(), name
    for half, part in zip(film.halves, parts):
        assert np.array_equal(half.passes["Combined"], part.passes["Combined"])
        assert np.array_equal(half.sums.window, part.sums.window) and np.array_equal(half.counts, part.counts)
    assert_same(film.passes, halves.passes)
    assert_same(rounded_anew(film), halves.passes)
    first = watcher.got[0]
    assert first.samples == 1 and not first.halves[1].any() and np.array_equal(first.halves[0], first.picture)
    error = half_error(*(part.passes["Combined"][..., :3] for part in parts), (4, 3))
    told = film.statistics["error"]
    assert (told["relmse"], told["rmse"], told["samples"]) == (error.relmse, error.rmse, 7) and error.relmse > 0
    assert told["stopped_by"] == film.statistics["stopped_by"] == "samples" and told["target"] == 0 and not told["reached"]
    json.dumps(film.statistics)


def test_no_more_paths_are_alive_than_a_half_has(session):
    film = session.render(scenes.mixed(FRAME), HALVES.replace(thread_count=1, tile_size=64))
    assert film.statistics["schedule"]["ray_count"] == 24 * 20 * 4


@pytest.mark.parametrize("cuts", [(1,), (2, 5), (3, 4)])
def test_ranges_of_halves_merge_to_one_render(session, halves, cuts):
    edges = [0, *cuts, HALVES.sample_count]
    parts = [
        session.render(scenes.mixed(FRAME), HALVES.replace(sample_count=end - first), sample_first=first) for first, end in zip(edges, edges[1:])
    ]
    merged = parts[-1]
    for part in parts[:-1]:
        merged = merged.merge(part)
    assert_same(merged.passes, halves.passes)
    for half, whole in zip(merged.halves, halves.halves):
        assert_same(half.passes, whole.passes)


def test_a_film_with_halves_and_one_without_merge_to_one_without(session, plain, halves):
    merged = halves.merge(plain)
    assert merged.halves is None and merged.sample_total == halves.sample_total + plain.sample_total
    assert np.array_equal(merged.sums.window, plain.sums.add(halves.sums).window)


def test_the_error_of_one_sample_is_not_known(session):
    film = session.render(scenes.mixed(FRAME), HALVES.replace(sample_count=1))
    assert film.complete and film.statistics["error"]["relmse"] is None and film.statistics["error"]["samples"] == 0
    assert session.render(scenes.mixed(FRAME), SETTINGS).statistics["error"] is None


@pytest.mark.parametrize("transparent", [False, True])
def test_passes_of_cost_and_transparency_have_halves_too(session, transparent):
    frame = Frame(16, 12, passes=("Combined", "Rays", "Node Steps"), transparent=transparent)
    one = session.render(scenes.mixed(frame), SETTINGS)
    cut = session.render(scenes.mixed(frame), SETTINGS, observers=[Watcher([1, 2, 5])])
    assert_same(cut.passes, one.passes)
    film = session.render(scenes.mixed(frame), HALVES.replace(tile_size=9), observers=[Watcher([1, 2, 5])])
    assert round(film.passes["Rays"].sum(dtype=float) * 7) == film.statistics["rays"]["total"]
    assert film.statistics["counters"]["rays"] == session.render(scenes.mixed(frame), HALVES).statistics["counters"]["rays"]
    assert np.array_equal(film.passes["Combined"], film.merge(Film.empty(frame)).passes["Combined"])


def test_sums_beyond_the_window_are_kept_between_rounds_and_in_halves(session):
    mixed = scenes.mixed(FRAME)
    lamps = [closure.kind == ClosureKind.EMISSION for material in mixed.materials for closure in material.closures[:1]]
    materials = tuple(scenes.emitter(1e20) if lamp else material for lamp, material in zip(lamps, mixed.materials, strict=True))
    bright = dataclasses.replace(mixed, materials=materials, world=World((1e-30,) * 3))
    for estimator in (SETTINGS, HALVES):
        whole = session.render(bright, estimator)
        with stopping(5):
            stopped = session.render(bright, estimator.replace(ray_count=50), observers=[Watcher([1, 2, 4])])
        assert not stopped.complete and len(stopped.sums.wide)
        for film in (session.render(bright, estimator, observers=[Watcher([1, 2, 4])]), session.render(bright, estimator, resume=stopped)):
            assert np.array_equal(film.passes["Combined"], whole.passes["Combined"]) and film.passes["Combined"].max() > 1e19
            assert np.array_equal(rounded_anew(film)["Combined"], whole.passes["Combined"])


def test_the_estimate_is_the_error_on_average(session):
    """Over films of other seeds the estimate's mean is that of the squared error against many samples, within their spread."""
    few = HALVES.replace(sample_count=8)
    truth = session.render(scenes.mixed(FRAME), few.replace(sample_count=1024, seed=77)).passes["Combined"][..., :3].astype(float)
    estimates, errors = [], []
    for seed in range(24):
        film = session.render(scenes.mixed(FRAME), few.replace(seed=seed))
        estimates.append(film.statistics["error"]["rmse"] ** 2)
        errors.append(((film.passes["Combined"][..., :3] - truth) ** 2).mean())
    # both means have the spread of 24 draws; the truth's own error is at most 1/128 of theirs (low-discrepancy samples do not err more)
    spread = np.hypot(np.std(estimates, ddof=1), np.std(errors, ddof=1)) / np.sqrt(len(errors))
    assert abs(np.mean(estimates) - np.mean(errors)) < 4 * spread + np.mean(errors) / 128 < np.mean(errors) / 2


# --- where a render ends


def test_an_error_target_ends_the_render_at_the_same_sample_whatever_the_schedule(session):
    target = SETTINGS.replace(sample_count=4096, error_target=0.02)
    one = session.render(scenes.mixed(FRAME), target)
    told = one.statistics["error"]
    assert told["reached"] and 0 < told["relmse"] <= 0.02 and told["stopped_by"] == "error" and told["target"] == 0.02
    samples = told["samples"]
    assert 4 <= samples < 512 and one.complete and (one.counts == samples).all() and one.statistics["samples_per_pixel"] == samples
    for more in (dict(tile_size=5, thread_count=3), dict(batching="ON", ray_count=100), dict(sample_order="PIXEL_FIRST"), dict(time_limit=1e6)):
        film = session.render(scenes.mixed(FRAME), target.replace(**more), observers=[Watcher([1, 3, 7, 9])])
        assert film.statistics["error"] == told
        assert_same(film.passes, one.passes)
    alone = session.render(scenes.mixed(FRAME), target.replace(error_target=0, error_estimate="ON", sample_count=samples))
    assert_same(alone.passes, one.passes)
    with pytest.raises(RayBatchError, match="complete"):
        session.render(scenes.mixed(FRAME), target, resume=one)


def test_a_target_that_is_not_reached(session):
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(error_target=1e-9))
    told = film.statistics["error"]
    assert film.complete and not told["reached"] and told["stopped_by"] == "samples" and told["samples"] == 7 and told["relmse"] > 1e-9


@pytest.mark.parametrize("estimate", ["OFF", "ON"])
def test_a_time_limit_ends_the_render_between_rounds(session, estimate):
    limited = SETTINGS.replace(sample_count=10_000_000, time_limit=0.3, error_estimate=estimate)
    watcher = Watcher([1, 2, 4, 8])
    film = session.render(scenes.mixed(FRAME), limited, observers=[watcher])
    samples = film.statistics["samples_per_pixel"]
    assert film.statistics["stopped_by"] == "time" and film.complete and 1 <= samples < limited.sample_count
    assert (film.counts == samples).all() and watcher.samples[-1] == samples
    if estimate == "ON":
        assert film.statistics["error"]["samples"] == samples or samples == 1
    same = session.render(scenes.mixed(FRAME), limited.replace(time_limit=0, sample_count=samples))
    assert_same(film.passes, same.passes)


def test_progress_tells_the_samples_that_there_are(session):
    """Not the share of a time limit, and with those from before a resume."""
    limited, told = SETTINGS.replace(sample_count=10_000_000, time_limit=0.3), []
    film = session.render(scenes.mixed(FRAME), limited, on_progress=told.append)
    samples = [progress.samples_done for progress in told if progress.stage == "render"]
    assert samples == sorted(samples) and samples[-1] == film.statistics["samples_per_pixel"] and told[-1].fraction > 0.5
    with stopping(30):
        film = session.render(scenes.mixed(FRAME), SETTINGS, on_progress=told.append)
    begun = film.sample_total / (24 * 20)
    assert 0 < begun < 7 and told[-1].samples_done == pytest.approx(begun)
    more = []
    session.render(scenes.mixed(FRAME), SETTINGS, resume=film, on_progress=more.append)
    samples = [progress.samples_done for progress in more if progress.stage == "render"]
    assert samples[0] >= begun * (1 - 1e-12) and samples[-1] == 7


def test_no_time_at_all_is_time_for_one_sample(session):
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(time_limit=1e-9))
    assert (film.counts == 1).all() and film.statistics["stopped_by"] == "time"


# --- stopped and gone on, under any schedule


@contextlib.contextmanager
def stopping(after: int):
    """Tiles are told to stop when they have asked `after` times; they bring their paths to the end, however long that takes."""
    render, asked = integrator.TileIntegrator.render, [0]

    def stopped(self, state, first, count, stop):
        def tells():
            asked[0] += 1
            return stop() or asked[0] > after

        return render(self, state, first, count, tells)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integrator, "DRAIN_SECONDS", 1e9)
        patch.setattr(integrator.TileIntegrator, "render", stopped)
        yield


class WatchedSession:
    """A session whose renders are watched, stopped and gone on with, as `random` says (None: they are left alone)."""

    def __init__(self, session):
        self.session, self.random, self.stops = session, None, 0

    def __getattr__(self, name):
        return getattr(self.session, name)

    def render(self, scene, settings):
        if self.random is None:
            return self.session.render(scene, settings)
        film, taken = None, [0, 0]
        for turn in range(4):
            watcher = Watcher(self.random.integers(1, settings.sample_count + 1, self.random.integers(0, 5)).tolist())
            after = 10**9 if turn == 3 else int(2.0 ** self.random.uniform(0, 10))
            with stopping(after):
                film = self.session.render(scene, settings, observers=[watcher], resume=film)
            assert not film.statistics["invalid_samples"]
            waited = film.statistics["batching"]
            if waited:
                assert waited["rays"] == waited["finished"] == film.statistics["rays"]["total"]
            if film.complete:
                break
            self.stops += 1
            counts = film.counts.reshape(-1)
            assert counts.min() < settings.sample_count and film.resume_state is not None
        return film


@pytest.mark.parametrize("estimate", ["OFF", "ON"])
@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_any_schedule_with_any_rounds_and_stops_gives_the_same_film(session, name, estimate):
    watched = WatchedSession(session)
    estimator = RenderSettings(sample_count=5, bounce_max=4, roulette_bounce=2, clamp_indirect=3.0, error_estimate=estimate)
    comparer = FilmComparer(watched, schedule_scenes.SCENES[name](), estimator, 16)

    @settings(max_examples=15, deadline=None, derandomize=True, database=None, phases=[Phase.generate])
    @given(number=st.integers(0, 2**32 - 1))
    def compare(number):
        watched.random = np.random.default_rng(number)
        found = comparer.compare_drawn(SeededDraws(number))
        # rays are those of the last part alone; that none is lost was looked at for each
        differs = [fault for fault in found.differs if "taken in" not in fault]
        assert not differs, (number, differs, found.settings)

    compare()
    assert watched.stops > 10


@pytest.fixture(scope="module")
def targeted(session):
    return session.render(scenes.mixed(FRAME), TARGET)


@pytest.mark.parametrize("sample_order", ["FRAME_FIRST", "PIXEL_FIRST"])
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
@pytest.mark.parametrize("after", [0, 30])
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


def test_a_round_that_a_time_limit_cannot_end_is_told(session):
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
            film = session.render(scenes.mixed(FRAME), HALVES.replace(tile_size=9), observers=[Watcher([1, 2])], resume=film, on_tile=shown.append)
        assert film.picture is not None and shown
        assert_same(film.passes, rounded_anew(film))


def test_a_border_has_the_halves_of_the_frame(session, halves):
    frame = dataclasses.replace(FRAME, border=(3, 5, 20, 13))
    film = session.render(scenes.mixed(frame), HALVES.replace(tile_size=4), observers=[Watcher([2])])
    assert_same(film.passes, {name: values[5:13, 3:20] for name, values in halves.passes.items()})
