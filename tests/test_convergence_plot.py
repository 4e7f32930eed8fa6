"""Records of runs and their plot, without Blender."""

import math
import threading
import types

import numpy as np
import pytest

from raybatch_addon.convergence import (
    FINISHED,
    WAITING_SNAPSHOTS,
    ErrorRecorder,
    RatePoint,
    RateRecorder,
    RunStore,
    error_line,
    names_of,
    point_of_halves,
    run_lines,
    runs_as_data,
    target_line,
)
from raybatch_addon.convergence_plot import SLOT_COLORS, draw_plot
from raybatch_addon.core.report.convergence import ErrorPoint, geometric_samples
from raybatch_addon.core.report.snapshot import Snapshot
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.plotting import letters
from raybatch_addon.plotting.axes import LogAxis, number_text, seconds_text
from raybatch_addon.plotting.raster import Canvas, text_width

ESTIMATED = RenderSettings(error_estimate="ON", sample_count=256)


def point(samples, relmse, seconds=None):
    return ErrorPoint(
        seconds or samples * 0.1, samples * 0.1 + 1, samples, {"camera": samples}, math.sqrt(relmse), relmse, floor_rmse=0.0, floor_relmse=0.0,
        from_halves=True,
    )  # fmt: skip


def points(count=256, error=0.3):
    """Of independent samples, exactly, at a tenth of a second each."""
    return tuple(point(n, error / n) for n in geometric_samples(count, 1.5, 2))


def store_of(*settings):
    store = RunStore()
    for i, each in enumerate(settings):
        run = store.begin("Scene", "Layer", 1, each)
        rates = tuple(RatePoint(t, 2e6 * (i + 1)) for t in np.geomspace(0.1, 25.6, 40))
        store.change(run.number, points=points(error=0.3 / (i + 1)), rates=rates, seconds=25.6, samples=256, state=FINISHED)
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


def test_runs_are_told_apart_by_what_differs():
    runs = store_of(ESTIMATED, ESTIMATED.replace(nee="OFF"), ESTIMATED.replace(nee="OFF", bounce_max=2)).runs()
    assert names_of(runs) == {1: "#1, Light Sampling On", 2: "#2", 3: "#3, Bounces 2"}, "what most have is not said"
    assert names_of(runs[1:]) == {1: "#1, Light Sampling On", 2: "#2, Light Sampling Off"}
    assert names_of(store_of(ESTIMATED, ESTIMATED.replace(sample_count=8)).runs()) == {1: "#1, Samples 256", 2: "#2, Samples 8"}
    assert names_of(store_of(ESTIMATED, ESTIMATED.replace(sample_count=8, seed=1)).runs()) == {1: "#1, Seed 0", 2: "#2, Seed 1"}
    assert names_of(runs[:1]) == {3: "#3"} and names_of([]) == {}


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
    return types.SimpleNamespace(stage=stage, seconds_rendering=seconds, rays_per_second=rays / seconds if seconds else 0.0, samples_done=1.0)


def test_rates_are_of_the_time_since_the_point_before_and_few():
    store = RunStore()
    recorder = RateRecorder(store, store.begin("Scene", "Layer", 1, RenderSettings()))
    recorder.on_progress(progress(0.0, 0.0, "build"))
    for step in range(1, 20_001):  # 1000 s, twenty times a second; 1000 rays a second up to 500 s, then 3000
        seconds = step * 0.05
        recorder.on_progress(progress(seconds, 1000 * seconds + 2000 * max(seconds - 500, 0)))
    rates = store.last().rates
    assert len(rates) < 160 and store.last().samples == 1.0
    assert rates[0].rays_per_second == pytest.approx(1000, rel=0.01) and rates[-1].rays_per_second == pytest.approx(3000, rel=0.01)


def snapshot(samples, seed=0):
    rng = np.random.default_rng((seed, samples))
    a, b = (rng.normal(1, 0.1 / math.sqrt(samples / 2), (16, 16, 3)).astype(np.float32) for _ in range(2))
    return Snapshot(samples, samples * 0.1, samples * 0.1, {"camera": samples}, 0, (a + b) / 2, (a, b))


def test_errors_are_computed_beside_the_render_and_all_there_at_its_end():
    store = RunStore()
    recorder = ErrorRecorder(store, store.begin("Scene", "Layer", 1, ESTIMATED))
    assert list(recorder.snapshot_samples(16)) == [2, 4, 8, 16] and list(recorder.snapshot_samples(100)) == [2, 4, 8, 16, 24, 36, 54, 81, 100]
    assert [list(recorder.snapshot_samples(n)) for n in (1, 2, 3, 17, 20, 24, 25)] == [
        [1], [2], [2, 3], [2, 4, 8, 17], [2, 4, 8, 16, 20], [2, 4, 8, 16, 24], [2, 4, 8, 16, 25],
    ]  # fmt: skip
    recorder.on_snapshot(snapshot(1))  # one half is empty yet
    for samples in (2, 4, 8):
        recorder.on_snapshot(snapshot(samples))
    recorder.end(FINISHED)
    run = store.last()
    assert run.points[-1] == point_of_halves(snapshot(8)) and run.points[-1].from_halves
    assert run.points[-1].relmse == pytest.approx(0.01 / 8 / 1.01, rel=0.2)


def test_pictures_do_not_pile_up(monkeypatch):
    """While one is being computed at most a few wait; the last one never is left out."""
    from raybatch_addon import convergence

    go, began = threading.Event(), threading.Event()

    def slow(each):
        began.set()
        go.wait(10)
        return point(each.samples, 1 / each.samples)

    monkeypatch.setattr(convergence, "point_of_halves", slow)
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
        ({"samples_per_pixel": 9, "stopped_by": "time", "error": None}, "9 samples per pixel, stopped by its time limit"),
        ({"samples_per_pixel": 3, "stopped_by": None, "error": None}, "3 samples per pixel, cancelled"),
        (
            {"samples_per_pixel": 8, "stopped_by": "error", "error": {"relmse": 0.00123456, "samples": 8, "target": 0.002, "reached": True}},
            "8 samples per pixel, error 0.00123 (relMSE), stopped at its error",
        ),
        (
            {"samples_per_pixel": 9, "stopped_by": "samples", "error": {"relmse": 0.01, "samples": 8, "target": 0.002, "reached": False}},
            "9 samples per pixel, error 0.01 (relMSE) at 8, the error of 0.002 was not reached",
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
            "begun": {}, "rates": {"rates": (RatePoint(0.1, 5.0), RatePoint(0.2, 0.0))}, "one point": {"points": (point(2, 0.1),)},
            "tiny": {"points": (point(2, 1e-30, 1e-7), point(4, 0.0), point(8, 1e-31, 1e-6))},
            "huge": {"points": (point(2, 1e25, 1e6), point(4, 1e24, 1e9))},
        }[runs]  # fmt: skip
        store.change(run.number, **own)
    pixels = draw_plot(store.runs(), 1e-3, edge, edge, size)
    assert pixels.shape == (edge, edge, 4) and pixels.dtype == np.float32
    assert np.isfinite(pixels).all() and pixels.min() >= 0 and pixels.max() <= 1 and (pixels[..., 3] == 1).all()


def test_text_is_readable_on_the_pane():
    """Contrast of letters, and of every slot's colour, against the pane (WCAG 2.1: 4.5 for text, 3 for what is drawn)."""
    from raybatch_addon import convergence_plot as plot

    def luminance(color):
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color]
        return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))

    def contrast(a, b):
        light, dark = sorted((luminance(a), luminance(b)), reverse=True)
        return (light + 0.05) / (dark + 0.05)

    for color in (plot._TEXT, plot._DIM_TEXT, *SLOT_COLORS):
        assert contrast(color, plot._PANE) > 4.5 and contrast(color, plot._BACKGROUND) > 4.5
    assert len(set(SLOT_COLORS)) == len(SLOT_COLORS) == len(RunStore()._slots)


def test_ticks_are_round_and_do_not_touch():
    for low, high in ((1e-5, 1e2), (0.9, 1.1), (3, 4), (1e-30, 1e30), (20, 7000), (1e-3, 1e7)):
        axis = LogAxis(low, high, 0, 300)
        for ticks, room in ((axis.ticks(20), 20), (axis.time_ticks(60), 60)):
            places = [axis.at(t) for t in ticks]
            assert places == sorted(places) and all(0 <= place <= 300 for place in places)
            assert all(b - a >= room - 1e-9 for a, b in zip(places[:-1], places[1:], strict=True)), (low, high, ticks)
    assert LogAxis(1e-4, 1, 0, 300).ticks(20) == pytest.approx([m * 10.0**d for d in range(-4, 0) for m in (1, 2, 5)] + [1])
    assert LogAxis(1e-4, 1, 0, 300).ticks(30) == pytest.approx([1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1])
    assert LogAxis(0.5, 4000, 0, 300).time_ticks(50) == [1, 10, 60, 600, 3600]


def test_axes_hold_what_they_are_made_around():
    for values in ([1.0], [1e-5, 3e4], [0.0, -1.0, math.nan, math.inf], [5.0, 5.0]):
        axis = LogAxis.around(values, 10, 210, 10.0)
        assert axis.high / axis.low >= 10 * (1 - 1e-9)
        for value in values:
            if value > 0 and math.isfinite(value):
                assert 10 < axis.at(value) < 210
    assert axis.at(0.0) == 10


def test_labels():
    assert [number_text(v) for v in (1, 0.5, 0.001, 1e-4, 2.5e-7, 999, 1000, 2.5e6, 1e12, 1e15)] == [
        "1", "0.5", "0.001", "1e-4", "2.5e-7", "999", "1k", "2.5M", "1T", "1e15",
    ]  # fmt: skip
    assert [seconds_text(v) for v in (1e-6, 0.02, 1.5, 59, 60, 600, 3600, 86400, 864_000, 3.2e10)] == [
        "1 us", "20 ms", "1.5 s", "59 s", "1 min", "10 min", "1 h", "1 d", "10 d", "1,014 years",
    ]  # fmt: skip


# --- the canvas


def test_lines_cover_as_much_as_they_are_long_and_wide():
    """A line of length l and width w with round ends has the area l w + pi w^2 / 4; smooth edges keep it, within the rim's rounding."""
    for ends in (((20.5, 20.5), (80.5, 20.5)), ((15, 10), (70, 90)), ((30, 80), (31, 20))):
        canvas = Canvas(100, 100, (0, 0, 0))
        canvas.line(ends, (1, 1, 1), 6.0)
        length = math.dist(*ends)
        assert canvas.pixels[..., 0].sum() == pytest.approx(length * 6 + math.pi * 9, rel=0.02)
    canvas.line([(-50, -50), (150, 150)], (1, 0, 0), clip=(40, 40, 60, 60))
    assert not canvas.pixels[:20, :20, 0].any() and canvas.pixels[50, 50, 0] > 0.9


def test_dashes_leave_half_of_a_line():
    solid, dashed = Canvas(220, 20, (0, 0, 0)), Canvas(220, 20, (0, 0, 0))
    solid.line([(10, 10), (210, 10)], (1, 1, 1), 1.0)
    dashed.line([(10, 10), (210, 10)], (1, 1, 1), 1.0, dash=10)
    round_ends = 10 * math.pi / 4  # of ten dashes, each a disc of diameter 1
    assert dashed.pixels[..., 0].sum() == pytest.approx(solid.pixels[..., 0].sum() / 2 + round_ends, rel=0.05)


@pytest.mark.parametrize("letter", sorted(letters._STROKES))
def test_every_letter_is_made_of_points_of_the_grid(letter):
    for stroke in letters.strokes_of(letter):
        assert len(stroke) >= 2 and all(0 <= x <= 4 and 0 <= y <= 8 for x, y in stroke)


def test_letters_differ_and_unknown_ones_are_boxes():
    def mask(text):
        canvas = Canvas(30, 30, (0, 0, 0))
        canvas.text(4, 8, text, 12, (1, 1, 1))
        return canvas.pixels[..., 0]

    known = [letter for letter in letters._STROKES if letter not in " x×jloOl0"]
    masks = {letter: mask(letter).tobytes() for letter in known}
    assert len(set(masks.values())) == len(known)
    assert mask("ß").any() and np.array_equal(mask("ß"), mask("ü"))
    assert not mask(" ").any()


def test_text_beyond_the_edges_is_cut():
    canvas = Canvas(40, 12, (0, 0, 0))
    for x, y in ((-20, 3), (30, 3), (5, -6), (5, 9), (-500, 500)):
        canvas.text(x, y, "Wide text", 8, (1, 1, 1))
    canvas.rectangle(-5, -5, 3, 3, (1, 0, 0))
    assert canvas.pixels[0, 0, 0] == 1 and np.isfinite(canvas.pixels).all()
