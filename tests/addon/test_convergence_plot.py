"""Records of runs and their plot, without Blender."""

import dataclasses
import math
import threading
import types

import numpy as np
import pytest

from raybatch_addon.convergence.plot import SLOT_COLORS, _fitting, draw_plot
from raybatch_addon.convergence.plotting.axes import LogAxis
from raybatch_addon.convergence.plotting.raster import text_width
from raybatch_addon.convergence.records import (
    FINISHED,
    WAITING_SNAPSHOTS,
    ErrorRecorder,
    RatePoint,
    RateRecorder,
    RunStore,
    point_of_halves,
    recorder_for,
)
from raybatch_addon.convergence.run_data import runs_as_data
from raybatch_addon.convergence.run_texts import error_line, names_of, run_lines, target_line
from raybatch_addon.core.convergence.points import ErrorPoint, geometric_samples
from raybatch_addon.core.measure.snapshot import Snapshot
from raybatch_addon.core.settings.settings import RenderSettings

ESTIMATED = RenderSettings(error_estimate="ON", sample_count=256)


def point(samples, relmse, seconds=None):
    return ErrorPoint(
        seconds=seconds or samples * 0.1,
        seconds_total=samples * 0.1 + 1,
        samples=samples,
        rays={"camera": samples},
        rmse=math.sqrt(relmse),
        relmse=relmse,
        floor_rmse=0.0,
        floor_relmse=0.0,
        from_halves=True,
    )


def points(count=256, error=0.3):
    """Points of independent samples, exactly, at a tenth of a second each."""
    return tuple(point(n, error / n) for n in geometric_samples(count, 1.5, 2))


def store_of(*settings):
    store = RunStore()
    for i, each in enumerate(settings):
        run = store.begin("Scene", "Layer", 1, each)
        rates = tuple(RatePoint(t, 2e6 * (i + 1)) for t in np.geomspace(0.1, 25.6, 40))
        store.change(
            run.number, points=points(error=0.3 / (i + 1)), rates=rates, seconds=25.6, samples=256, state=FINISHED
        )
    return store


def test_time_to_an_error_is_extrapolated_from_the_measured_slope():
    run = store_of(ESTIMATED).last()
    assert run.slope.slope == pytest.approx(-0.5, abs=1e-9)
    assert run.time_to(0.3 / 1024) == (pytest.approx(102.4), True)
    assert run.time_to(0.3 / 256) == (pytest.approx(25.6), False)
    seconds, extrapolated = run.time_to(0.3 / 20)
    assert not extrapolated and seconds == pytest.approx(2.0, rel=1e-6)
    assert target_line(run, 0.3 / 1024) == "relMSE 0.000292969 in about 1.71 min (extrapolated)"
    assert any("Finished: 256 samples in 25.6 s" in line for line in run_lines(run, 1e-3))


def test_an_error_that_does_not_fall_is_never_reached():
    store = RunStore()
    run = store.begin("Scene", "Layer", 1, ESTIMATED)
    store.change(run.number, points=tuple(point(n, 0.3) for n in (2, 4, 8, 16)))
    assert store.last().time_to(0.1) is None and "never" in target_line(store.last(), 0.1)


def test_runs_are_distinguished_by_what_differs():
    runs = store_of(ESTIMATED, ESTIMATED.replace(nee="OFF"), ESTIMATED.replace(nee="OFF", bounce_max=2)).runs()
    assert names_of(runs) == {1: "#1, Light Sampling On", 2: "#2", 3: "#3, All Bounces 2"}, "what most have is not said"
    assert names_of(runs[1:]) == {1: "#1, Light Sampling On", 2: "#2, Light Sampling Off"}
    assert names_of(store_of(ESTIMATED, ESTIMATED.replace(sample_count=8)).runs()) == {
        1: "#1, Samples 256",
        2: "#2, Samples 8",
    }
    assert names_of(store_of(ESTIMATED, ESTIMATED.replace(sample_count=8, seed=1)).runs()) == {
        1: "#1, Seed 0",
        2: "#2, Seed 1",
    }
    assert names_of(runs[:1]) == {3: "#3"} and names_of([]) == {}
    sequences = [ESTIMATED.replace(sample_sequence=each, geometry_store="HOST") for each in ("BLUE_NOISE", "SOBOL")]
    assert names_of(store_of(*sequences).runs()) == {1: "#1, Sequence Blue Noise", 2: "#2, Sequence Sobol"}, (
        "values have the names of the panel"
    )


def test_slots_are_taken_from_the_oldest_that_is_not_kept():
    store = RunStore(3)
    first, second, third = (store.begin("Scene", "Layer", n, ESTIMATED) for n in range(3))
    assert [run.slot for run in (first, second, third)] == [0, 1, 2]
    assert store.keep(first.number) and store.keep(second.number)
    assert not store.keep(third.number), "one is left for the next"
    fourth = store.begin("Scene", "Layer", 4, ESTIMATED)
    assert fourth.slot == third.slot and not store.change(third.number, seconds=1.0)
    assert store.keep(second.number, False) and store.begin("Scene", "Layer", 5, ESTIMATED).slot == second.slot
    store.clear(first.number)
    assert len(store.runs()) == 2 and store.begin("Scene", "Layer", 6, ESTIMATED).slot == first.slot


def test_the_version_grows_with_every_change():
    store = RunStore()
    seen = [store.version]
    run = store.begin("Scene", "Layer", 1, ESTIMATED)
    seen.append(store.version)
    store.change(run.number, seconds=1.0)
    seen.append(store.version)
    store.keep(run.number)
    seen.append(store.version)
    store.clear()
    seen.append(store.version)
    assert seen == sorted(set(seen))


def progress(seconds, rays, stage="render"):
    return types.SimpleNamespace(
        stage=stage, seconds_rendering=seconds, rays_per_second=rays / seconds if seconds else 0.0, samples_done=1.0
    )


def test_rates_are_of_the_time_since_the_point_before_and_few():
    store = RunStore()
    recorder = RateRecorder(store, store.begin("Scene", "Layer", 1, RenderSettings()))
    recorder.on_progress(progress(0.0, 0.0, "build"))
    for step in range(1, 20_001):  # 1000 s, twenty times a second; 1000 rays a second up to 500 s, then 3000
        seconds = step * 0.05
        recorder.on_progress(progress(seconds, 1000 * seconds + 2000 * max(seconds - 500, 0)))
    rates = store.last().rates
    assert len(rates) < 160 and store.last().samples == 1.0
    assert rates[0].rays_per_second == pytest.approx(1000, rel=0.01) and rates[-1].rays_per_second == pytest.approx(
        3000, rel=0.01
    )


def snapshot(samples, seed=0):
    rng = np.random.default_rng((seed, samples))
    a, b = (rng.normal(1, 0.1 / math.sqrt(samples / 2), (16, 16, 3)).astype(np.float32) for _ in range(2))
    return Snapshot(
        samples=samples,
        seconds=samples * 0.1,
        seconds_total=samples * 0.1,
        rays={"camera": samples},
        invalid_samples=0,
        picture=(a + b) / 2,
        halves=(a, b),
    )


def test_errors_are_computed_beside_the_render_and_all_there_at_its_end():
    store = RunStore()
    recorder = ErrorRecorder(store, store.begin("Scene", "Layer", 1, ESTIMATED))
    assert list(recorder.snapshot_samples(16)) == [2, 4, 8, 16] and list(recorder.snapshot_samples(100)) == [
        2,
        4,
        8,
        16,
        24,
        36,
        54,
        81,
        100,
    ]
    assert [list(recorder.snapshot_samples(n)) for n in (1, 2, 3, 17, 20, 24, 25)] == [
        [1],
        [2],
        [2, 3],
        [2, 4, 8, 17],
        [2, 4, 8, 16, 20],
        [2, 4, 8, 16, 24],
        [2, 4, 8, 16, 25],
    ]
    recorder.on_snapshot(snapshot(1))  # one half is empty yet
    for samples in (2, 4, 8):
        recorder.on_snapshot(snapshot(samples))
    recorder.end(FINISHED)
    run = store.last()
    assert run.points[-1] == point_of_halves(snapshot(8)) and run.points[-1].from_halves
    assert run.points[-1].relmse == pytest.approx(0.01 / 8 / 1.01, rel=0.2)


def test_errors_of_adaptive_renders_lie_at_the_mean_of_their_samples():
    store = RunStore()
    recorder = recorder_for(store, "Scene", "Layer", 1, RenderSettings(adaptive_sampling="ON"))
    assert isinstance(recorder, ErrorRecorder) and store.last().estimates_error
    counts = np.full((16, 16), 8)
    counts[:4] = 4
    recorder.on_snapshot(dataclasses.replace(snapshot(8), counts=counts))
    recorder.end(
        FINISHED,
        {
            "seconds": {"render": 1.0},
            "rays": {"total": 10},
            "samples_per_pixel": 8,
            "adaptive": {"samples_mean": 7.0},
            "device": {"alias": "cpu"},
            "stopped_by": "samples",
            "error": None,
        },
    )
    run = store.last()
    assert [(each.samples, each.samples_most) for each in run.points] == [(7.0, 8)] and run.samples == 7.0
    assert not store_of(RenderSettings()).last().estimates_error


def test_pictures_do_not_pile_up(monkeypatch):
    """While one is being computed at most a few wait; the last one never is left out."""
    from raybatch_addon.convergence import records

    go, began = threading.Event(), threading.Event()

    def slow(each):
        began.set()
        go.wait(10)
        return point(each.samples, 1 / each.samples)

    monkeypatch.setattr(records, "point_of_halves", slow)
    store = RunStore()
    recorder = ErrorRecorder(store, store.begin("Scene", "Layer", 1, ESTIMATED))
    recorder.on_snapshot(snapshot(2))
    assert began.wait(10)
    for samples in range(3, 30):
        recorder.on_snapshot(snapshot(samples))
    go.set()
    recorder.end(FINISHED)
    assert [p.samples for p in store.last().points] == [2, *range(30 - WAITING_SNAPSHOTS, 30)]


def test_data_is_for_json_as_that_of_the_script():
    store = store_of(ESTIMATED, ESTIMATED.replace(seed=3))
    data = runs_as_data(store.runs(), 1e-4)
    assert set(data) >= {"scene", "device", "reference", "runs", "summary"}
    assert [run["seed"] for run in data["runs"]] == [3, 0]
    found = data["summary"][0]["seconds_to_target"]
    assert found["extrapolated"] is True and found["least"] == found["median"] == found["most"] == pytest.approx(150)
    assert data["summary"][0]["slope"] == data["runs"][0]["slope"] == pytest.approx(-0.5)
    assert runs_as_data([], 1e-4)["runs"] == []


@pytest.mark.parametrize(
    "statistics, said",
    [
        ({}, ""),
        ({"samples_per_pixel": 1, "stopped_by": "samples", "error": None}, "1 sample per pixel"),
        (
            {"samples_per_pixel": 9, "stopped_by": "time", "error": None},
            "9 samples per pixel, stopped by its time limit",
        ),
        ({"samples_per_pixel": 3, "stopped_by": None, "error": None}, "3 samples per pixel, cancelled"),
        (
            {"samples_per_pixel": 0, "stopped_by": None, "samples": 82_240, "frame": {"region": [10, 0, 110, 50]}},
            "16.4 samples per pixel, cancelled",
        ),
        (
            {
                "samples_per_pixel": 8,
                "stopped_by": "error",
                "error": {"relmse": 0.00123456, "samples": 8, "target": 0.002, "reached": True},
            },
            "8 samples per pixel, error 0.00123 (relMSE), stopped at its error",
        ),
        (
            {
                "samples_per_pixel": 9,
                "stopped_by": "samples",
                "error": {"relmse": 0.01, "samples": 8, "target": 0.002, "reached": False},
            },
            "9 samples per pixel, error 0.01 (relMSE) at 8, the error of 0.002 was not reached",
        ),
        (
            {"samples_per_pixel": 1024, "stopped_by": "noise", "adaptive": {"samples_mean": 211.4, "converged": 1.0}},
            "211 samples per pixel, 1,024 at most, 100 % of the pixels below the noise threshold, "
            "stopped by its noise threshold",
        ),
    ],
)
def test_how_far_a_render_came(statistics, said):
    assert error_line(statistics) == said


# --- the plot


def count(pixels, color):
    return int((np.abs(pixels[..., :3] - np.float32(color)) < 0.002).all(axis=-1).sum())


def test_curves_lie_where_their_axes_say():
    """Independent samples are a straight line: its pixels, fitted, fall by as many decades of error as of time."""
    runs = store_of(ESTIMATED).runs()
    pixels = draw_plot(runs, 0.0, 800, 800)
    error_pane = pixels[330:]
    rows, columns = np.nonzero((np.abs(error_pane[..., :3] - np.float32(SLOT_COLORS[0])) < 0.002).all(axis=-1))
    inside = columns < columns.max() - 40
    inside &= rows < np.quantile(rows, 0.97)  # without the legend
    fitted = np.polyfit(columns[inside], rows[inside], 1)
    x = LogAxis.around([p.seconds for p in runs[0].points] + [r.seconds for r in runs[0].rates], 0, 1, 10.0)
    y = LogAxis.around([p.relmse for p in runs[0].points], 0, 1, 10.0, 0.06)
    decades = math.log(x.high / x.low), math.log(y.high / y.low)
    width, height = 800 - 2 * 7 - text_width("0.005", 7.0) - 2.4 * 7, (800 - 2.6 * 7 - 5.2 * 7 - 3.2 * 7) * 0.63
    assert fitted[0] == pytest.approx(-(height / decades[1]) / (width / decades[0]), rel=0.03)


def test_runs_that_are_hidden_are_not_drawn_and_an_empty_plot_says_so():
    store = store_of(ESTIMATED, ESTIMATED.replace(nee="OFF"))
    both = draw_plot(store.runs(), 1e-3, 400, 400)
    assert count(both, SLOT_COLORS[0]) > 100 and count(both, SLOT_COLORS[1]) > 100
    store.change(1, shown=False)
    one = draw_plot(store.runs(), 1e-3, 400, 400)
    assert not count(one, SLOT_COLORS[0]) and count(one, SLOT_COLORS[1]) > 100
    empty = draw_plot([], 1e-3, 400, 400)
    assert empty.shape == (400, 400, 4) and np.isfinite(empty).all() and not count(empty, SLOT_COLORS[1])


@pytest.mark.parametrize("edge, size", [(100, 6.0), (130, 12.0), (640, 6.0)])
@pytest.mark.parametrize("runs", ["none", "begun", "rates", "one point", "tiny", "huge"])
def test_plots_of_every_size_and_range_are_drawn(runs, edge, size):
    store = RunStore()
    if runs != "none":
        run = store.begin("A scene with quite a long name · ÄÖÜ", "Layer", 1, ESTIMATED)
        own = {
            "begun": {},
            "rates": {"rates": (RatePoint(0.1, 5.0), RatePoint(0.2, 0.0))},
            "one point": {"points": (point(2, 0.1),)},
            "tiny": {"points": (point(2, 1e-30, 1e-7), point(4, 0.0), point(8, 1e-31, 1e-6))},
            "huge": {"points": (point(2, 1e25, 1e6), point(4, 1e24, 1e9))},
        }[runs]
        store.change(run.number, **own)
    pixels = draw_plot(store.runs(), 1e-3, edge, edge, size)
    assert pixels.shape == (edge, edge, 4) and pixels.dtype == np.float32
    assert np.isfinite(pixels).all() and pixels.min() >= 0 and pixels.max() <= 1 and (pixels[..., 3] == 1).all()


def test_names_in_the_legend_lose_whole_parts():
    name = "#3, Sequence Blue Noise, Pixel Filter Box"
    for letters, expected in ((41, name), (40, "#3, Sequence Blue Noise"), (22, "#3"), (1, "#3")):
        assert _fitting(name, "", letters) == expected
    assert _fitting(name, " (running)", 33) == "#3, Sequence Blue Noise (running)"
    assert _fitting(name, " (running)", 32) == "#3 (running)"
