"""Renders in rounds: what is shown on the way, halves, where they end, and that none of it changes the film."""

import dataclasses
import itertools
import json

import numpy as np
import pytest

from raybatch_addon.core.convergence.halves import half_error
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film
from raybatch_addon.core.observers import RenderObserver
from raybatch_addon.core.scene.description import ClosureKind, Frame, World
from raybatch_addon.core.wavefront.stages.limits import half_seed
from tests.support import scenes, schedule_scenes
from tests.support.under_test import DEVICE
from tests.support.watched_renders import (  # noqa: F401 (`halves_film` is the fixture `halves`)
    FRAME,
    HALVES,
    SETTINGS,
    Watcher,
    assert_same,
    halves_film,
    rounded_anew,
    stopping,
)

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

OFTEN = ("unbatched", "batched")  # the others in a thorough run
WAYS = {
    "unbatched": dict(batching="OFF"),
    "small tiles": dict(tile_size=7, thread_count=3),
    "batched": dict(batching="ON", debug_checks="ON"),
    "by value": dict(batching="ON", ray_storage="DIRECT", queue_size=2, queue_count=3, ray_count=50),
    "paged": dict(debug_checks="ON"),
    "pixel first": dict(sample_order="PIXEL_FIRST", tile_size=9, ray_count=100),
}


TRIED = [pytest.param(way, marks=() if way in OFTEN else pytest.mark.thorough) for way in WAYS]


def settings_of(way: str) -> dict:
    return {
        **WAYS[way],
        **(dict(geometry_budget=schedule_scenes.least_budget(DEVICE) + 1000) if way == "paged" else {}),
    }


@pytest.fixture(scope="module")
def plain(session):
    return session.render(scenes.mixed(FRAME), SETTINGS)


# --- snapshots


@pytest.mark.parametrize("way", TRIED)
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
        assert snapshot.rays == {
            "bounced" if kind == "bounce" else kind: n
            for kind, n in fewer.statistics["rays"].items()
            if kind != "total"
        }
    last = watcher.got[-1]
    assert np.array_equal(last.picture, plain.passes["Combined"][..., :3]) and last.halves is None
    assert last.picture.dtype == np.float32 and last.picture.shape == (20, 24, 3)


def test_what_a_snapshot_reports(session):
    one, other = Watcher([2, 1]), Watcher([2, 3])
    calls = []
    nobody = type(
        "Nobody", (RenderObserver,), {"on_tile": lambda self, tile: calls.append(tile)}
    )()  # without snapshots
    film = session.render(scenes.mixed(FRAME), SETTINGS, observers=[one, nobody, other])
    assert one.samples == [1, 2, 7] and other.samples == [2, 3, 7] and len(calls) >= 4  # a tile at least for each round
    seconds = [snapshot.seconds for snapshot in one.got]
    assert seconds == sorted(seconds) and seconds[0] > 0
    assert all(
        snapshot.seconds <= snapshot.seconds_total <= film.statistics["seconds"]["total"] for snapshot in one.got
    )
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
        scenes.mixed(FRAME),
        settings,
        observers=[watcher],
        on_tile=shown.append,
        on_progress=lambda progress: shares.append(progress.fraction) if progress.stage == "render" else None,
    )
    assert len(shown) == 3 * 4
    for tile in shown[-4:]:
        assert_same(
            tile.passes,
            {n: v[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] for n, v in film.passes.items()},
        )
    assert shares == sorted(shares) and shares[-1] == 1.0


# --- halves


@pytest.mark.parametrize("way", TRIED)
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
        assert np.array_equal(film.passes[name], parts[0].passes[name]) and not film.halves[1].first[name].any(), name
    for half, part in zip(film.halves, parts):
        assert np.array_equal(half.passes["Combined"], part.passes["Combined"])
        assert np.array_equal(half.sums.window, part.sums.window) and np.array_equal(half.counts, part.counts)
    assert_same(film.passes, halves.passes)
    assert_same(rounded_anew(film), halves.passes)
    first = watcher.got[0]
    assert first.samples == 1 and not first.halves[1].any() and np.array_equal(first.halves[0], first.picture)
    error = half_error(*(part.passes["Combined"][..., :3] for part in parts), 7)
    reported = film.statistics["error"]
    assert (reported["relmse"], reported["rmse"], reported["samples"]) == (
        error.relmse,
        error.rmse,
        7,
    ) and error.relmse > 0
    assert (
        reported["stopped_by"] == film.statistics["stopped_by"] == "samples"
        and reported["target"] == 0
        and not reported["reached"]
    )
    json.dumps(film.statistics)


def test_no_more_paths_are_alive_than_a_half_has(session):
    film = session.render(scenes.mixed(FRAME), HALVES.replace(thread_count=1, tile_size=64))
    assert film.statistics["schedule"]["ray_count"] == 24 * 20 * 4


@pytest.mark.parametrize("cuts", [(1,), (2, 5), (3, 4)])
def test_ranges_of_halves_merge_to_one_render(session, halves, cuts):
    edges = [0, *cuts, HALVES.sample_count]
    parts = [
        session.render(scenes.mixed(FRAME), HALVES.replace(sample_count=end - first), sample_first=first)
        for first, end in itertools.pairwise(edges)
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
    assert (
        film.statistics["counters"]["rays"]
        == session.render(scenes.mixed(frame), HALVES).statistics["counters"]["rays"]
    )
    assert np.array_equal(film.passes["Combined"], film.merge(Film.empty(frame)).passes["Combined"])


def test_sums_beyond_the_window_are_kept_between_rounds_and_in_halves(session):
    mixed = scenes.mixed(FRAME)
    lamps = [closure.kind == ClosureKind.EMISSION for material in mixed.materials for closure in material.closures[:1]]
    materials = tuple(
        scenes.emitter(1e20) if lamp else material for lamp, material in zip(lamps, mixed.materials, strict=True)
    )
    bright = dataclasses.replace(mixed, materials=materials, world=World((1e-30,) * 3))
    for estimator in (SETTINGS, HALVES):
        whole = session.render(bright, estimator)
        with stopping(5):
            stopped = session.render(bright, estimator.replace(ray_count=50), observers=[Watcher([1, 2, 4])])
        assert not stopped.complete and len(stopped.sums.wide)
        for film in (
            session.render(bright, estimator, observers=[Watcher([1, 2, 4])]),
            session.render(bright, estimator, resume=stopped),
        ):
            assert (
                np.array_equal(film.passes["Combined"], whole.passes["Combined"])
                and film.passes["Combined"].max() > 1e19
            )
            assert np.array_equal(rounded_anew(film)["Combined"], whole.passes["Combined"])


def test_the_estimate_is_the_error_on_average(session):
    """Over films of other seeds the estimate's mean is that of the squared error against many samples, within their
    spread.
    """
    few = HALVES.replace(sample_count=8)
    truth = (
        session.render(scenes.mixed(FRAME), few.replace(sample_count=1024, seed=77))
        .passes["Combined"][..., :3]
        .astype(float)
    )
    estimates, errors = [], []
    for seed in range(24):
        film = session.render(scenes.mixed(FRAME), few.replace(seed=seed))
        estimates.append(film.statistics["error"]["rmse"] ** 2)
        errors.append(((film.passes["Combined"][..., :3] - truth) ** 2).mean())
    # both means have the spread of 24 draws; the truth's own error is at most 1/128 of theirs (low-discrepancy samples
    # do not err more)
    spread = np.hypot(np.std(estimates, ddof=1), np.std(errors, ddof=1)) / np.sqrt(len(errors))
    assert abs(np.mean(estimates) - np.mean(errors)) < 4 * spread + np.mean(errors) / 128 < np.mean(errors) / 2


def test_a_border_has_the_halves_of_the_frame(session, halves):
    frame = dataclasses.replace(FRAME, border=(3, 5, 20, 13))
    film = session.render(scenes.mixed(frame), HALVES.replace(tile_size=4), observers=[Watcher([2])])
    assert_same(film.passes, {name: values[5:13, 3:20] for name, values in halves.passes.items()})


# --- where a render ends


def test_an_error_target_ends_the_render_at_the_same_sample_whatever_the_schedule(session):
    target = SETTINGS.replace(sample_count=4096, error_target=0.02)
    one = session.render(scenes.mixed(FRAME), target)
    reported = one.statistics["error"]
    assert (
        reported["reached"]
        and 0 < reported["relmse"] <= 0.02
        and reported["stopped_by"] == "error"
        and reported["target"] == 0.02
    )
    samples = reported["samples"]
    assert (
        4 <= samples < 512
        and one.complete
        and (one.counts == samples).all()
        and one.statistics["samples_per_pixel"] == samples
    )
    for more in (
        dict(tile_size=5, thread_count=3),
        dict(batching="ON", ray_count=100),
        dict(sample_order="PIXEL_FIRST"),
        dict(time_limit=1e6),
    ):
        film = session.render(scenes.mixed(FRAME), target.replace(**more), observers=[Watcher([1, 3, 7, 9])])
        assert film.statistics["error"] == reported
        assert_same(film.passes, one.passes)
    alone = session.render(
        scenes.mixed(FRAME), target.replace(error_target=0, error_estimate="ON", sample_count=samples)
    )
    assert_same(alone.passes, one.passes)
    with pytest.raises(RayBatchError, match="complete"):
        session.render(scenes.mixed(FRAME), target, resume=one)


def test_a_black_picture_that_meets_the_target_is_reported(session):
    """Nothing was found, so halves agree: of what is there they say nothing."""
    frame = dataclasses.replace(FRAME, passes=("Combined",))
    for world, warned in ((0.0, 1), (0.5, 0)):
        film = session.render(
            scenes.scene(frame=frame, world=world), SETTINGS.replace(sample_count=64, error_target=0.01)
        )
        warnings = [warning for warning in film.statistics["warnings"] if "error_target" in warning]
        assert film.statistics["stopped_by"] == "error" and len(warnings) == warned, world
        assert all("black" in warning and "no path" in warning for warning in warnings)


def test_a_target_that_is_not_reached(session):
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(error_target=1e-9))
    reported = film.statistics["error"]
    assert (
        film.complete
        and not reported["reached"]
        and reported["stopped_by"] == "samples"
        and reported["samples"] == 7
        and reported["relmse"] > 1e-9
    )


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


def test_progress_reports_the_samples_that_there_are(session):
    """Not the share of a time limit, and with those from before a resume."""
    limited, reported = SETTINGS.replace(sample_count=10_000_000, time_limit=0.3), []
    film = session.render(scenes.mixed(FRAME), limited, on_progress=reported.append)
    samples = [progress.samples_done for progress in reported if progress.stage == "render"]
    assert (
        samples == sorted(samples)
        and samples[-1] == film.statistics["samples_per_pixel"]
        and reported[-1].fraction > 0.5
    )
    many_turns = SETTINGS.replace(tile_size=4, ray_count=64)
    with stopping(5):
        film = session.render(scenes.mixed(FRAME), many_turns, on_progress=reported.append)
    begun = film.sample_total / (24 * 20)
    assert 0 < begun < 7 and reported[-1].samples_done == pytest.approx(begun)
    more = []
    session.render(scenes.mixed(FRAME), many_turns, resume=film, on_progress=more.append)
    samples = [progress.samples_done for progress in more if progress.stage == "render"]
    assert samples[0] >= begun * (1 - 1e-12) and samples[-1] == 7


def test_no_time_at_all_is_time_for_one_sample(session):
    film = session.render(scenes.mixed(FRAME), SETTINGS.replace(time_limit=1e-9))
    assert (film.counts == 1).all() and film.statistics["stopped_by"] == "time"
