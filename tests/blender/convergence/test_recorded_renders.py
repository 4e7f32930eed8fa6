"""Records of renders in Blender: which are kept, how they end, and what they cost the film."""

import dataclasses
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame, reports
from raybatch_addon.convergence.records import CANCELLED, FAILED, FINISHED, RUNNING, store
from raybatch_addon.convergence.run_data import runs_as_data
from raybatch_addon.convergence.run_texts import names_of
from raybatch_addon.core.session import Session
from raybatch_addon.ui import last_render
from raybatch_addon.ui.convergence.panel import RAYBATCH_RENDER_PT_convergence
from raybatch_addon.ui.convergence.properties import chosen_target
from tests.blender.convergence.recorded import render
from tests.support.panel_layout import context_of, drawn


def test_a_render_whose_error_is_estimated_is_recorded(lit):
    run = render()
    statistics = reports.last().statistics["ViewLayer"]
    assert (run.state, run.stopped_by, run.device) == (FINISHED, "samples", "cpu")
    assert (run.scene, run.layer, run.frame) == (lit.name, "ViewLayer", lit.frame_current)
    assert [p.samples for p in run.points] == [2, 4, 8, 16]
    assert run.points[-1].relmse == pytest.approx(statistics["error"]["relmse"], rel=1e-12)
    assert run.points[-1].rmse == pytest.approx(statistics["error"]["rmse"], rel=1e-12)
    assert run.points[0].relmse > run.points[-1].relmse > 0
    seconds = [p.seconds for p in run.points]
    assert seconds == sorted(seconds) and 0 < seconds[-1] <= run.seconds == statistics["seconds"]["render"]
    # the rates are those of all rays: rates times their seconds add up
    times = np.diff([0.0, *(r.seconds for r in run.rates)])
    assert np.dot(times, [r.rays_per_second for r in run.rates]) == pytest.approx(statistics["rays"]["total"], rel=1e-6)


def test_recording_does_not_change_the_film(lit):
    films = []
    frame.film_listeners.append(lambda layer, scene, film: films.append((scene, film)))
    try:
        render()
    finally:
        frame.film_listeners.pop()
    ((exported, film),) = films
    alone = Session("cpu").render(exported, frame.settings_from(lit))
    assert np.array_equal(film.passes["Combined"], alone.passes["Combined"])


@pytest.mark.parametrize("record", [False, True])
def test_without_an_estimate_only_rays_are_recorded_and_only_on_demand(lit, record, monkeypatch):
    """Either way the render is one round, as without a recorder."""
    lit.raybatch.error_estimate = "OFF"
    lit.raybatch_convergence.record = record
    observers = []
    original = Session.render

    def watched(self, *args, **options):
        observers.extend(options["observers"])
        return original(self, *args, **options)

    monkeypatch.setattr(Session, "render", watched)
    run = render()
    assert all(observer.snapshot_samples(16) is None for observer in observers)
    assert len(observers) == record and (run is not None) == record
    if record:
        assert run.rates and not run.points and run.slope is None and run.time_to(1e-3) is None
        lines = [text for kind, text, *_ in drawn(RAYBATCH_RENDER_PT_convergence, context_of(lit)) if kind == "label"]
        assert any("Error Estimate" in text for text in lines)


@pytest.mark.parametrize("change", [{}, dict(error_target=0.003, sample_count=64), dict(time_limit=60.0)])
def test_without_windows_nothing_is_recorded_unless_it_was_asked_for(lit, change, monkeypatch):
    """The error is in the statistics either way, and the render ends at the same point."""
    for name, value in change.items():
        setattr(lit.raybatch, name, value)
    recorded = render()
    errors, observers, original = [reports.last().statistics["ViewLayer"]["error"]], [], Session.render

    def watched(self, *args, **options):
        observers.extend(options["observers"])
        return original(self, *args, **options)

    monkeypatch.setattr(Session, "render", watched)
    lit.raybatch_convergence.record = False
    assert render().number == recorded.number and not observers
    errors.append(reports.last().statistics["ViewLayer"]["error"])
    assert errors[0] == errors[1] and errors[0]["relmse"] > 0
    settings = frame.settings_from(lit)
    assert frame.wants_recording(lit, settings, has_windows=True) and not frame.wants_recording(
        lit, settings, has_windows=False
    )
    unknown = settings.replace(error_estimate="OFF", error_target=0.0)
    assert not frame.wants_recording(lit, unknown, has_windows=True), "nothing gives the error"


def test_stop_at_error_ends_the_render(lit):
    lit.raybatch.error_estimate = "OFF"  # it is implied
    lit.raybatch.sample_count = 4096
    lit.raybatch.error_target = 0.003
    run = render()
    statistics = reports.last().statistics["ViewLayer"]
    assert run.stopped_by == statistics["stopped_by"] == "error" and statistics["error"]["reached"]
    assert run.points[-1].relmse <= 0.003 < run.points[0].relmse
    assert run.points[-1].samples == statistics["samples_per_pixel"] < 4096
    line = last_render.report_lines(reports.last())[0]
    assert f", {statistics['samples_per_pixel']} samples per pixel, error " in line and line.endswith(
        "stopped at its error"
    )
    seconds, extrapolated = run.time_to(chosen_target(lit))
    assert not extrapolated and seconds <= run.points[-1].seconds


def test_the_time_limit_ends_the_render(lit):
    lit.raybatch.sample_count = 1_000_000
    lit.raybatch.time_limit = 0.5
    run = render()
    assert run.stopped_by == "time" and 1 <= reports.last().statistics["ViewLayer"]["samples_per_pixel"] < 1_000_000
    assert last_render.report_lines(reports.last())[0].endswith("stopped by its time limit")


def test_an_error_that_was_not_reached_is_said(lit):
    lit.raybatch.error_target = 1e-9
    render()
    line = last_render.report_lines(reports.last())[0]
    assert ", 16 samples per pixel, error " in line and line.endswith("the error of 1e-09 was not reached")


def test_a_render_that_fails_or_is_cancelled_says_so(lit, monkeypatch):
    original = Session.render

    def broken(self, *args, **options):
        raise RuntimeError("out of chalk")

    monkeypatch.setattr(Session, "render", broken)
    with pytest.raises(RuntimeError, match="out of chalk"):
        bpy.ops.render.render()
    assert store.last().state == FAILED
    monkeypatch.setattr(
        Session,
        "render",
        lambda self, *args, **options: original(self, *args, **{**options, "cancelled": lambda: True}),
    )
    render()
    assert store.last().state == CANCELLED
    assert last_render.report_lines(reports.last())[0].endswith("cancelled")


def test_every_view_layer_is_a_run_of_its_own(lit):
    lit.raybatch.sample_count = 2
    lit.view_layers.new("Second")
    render()
    assert [run.layer for run in store.runs()] == ["Second", "ViewLayer"]


def test_the_record_does_not_wait_for_warp():
    """Registering the add-on imports records and plots; Warp starts with the first render."""
    import subprocess

    code = (
        "import sys, raybatch_addon.convergence.records, raybatch_addon.convergence.plot; "
        "sys.exit('warp' in sys.modules or 'bpy' in sys.modules)"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], cwd=str(frame.__file__).rsplit("raybatch_addon", 1)[0]).returncode
        == 0
    )


def test_errors_that_cannot_be_computed_are_said_and_the_render_goes_on(lit, monkeypatch):
    from raybatch_addon.convergence import records

    def broken(snapshot):
        raise ValueError("no chalk")

    monkeypatch.setattr(records, "point_of_halves", broken)
    run = render()
    assert run.state == FINISHED and run.points == () and "no chalk" in run.problem
    text = " ".join(note[1] for note in drawn(RAYBATCH_RENDER_PT_convergence, context_of(lit)) if note[0] == "label")
    assert "no chalk" in text


def test_runs_do_not_change(lit):
    run = render()
    with pytest.raises(dataclasses.FrozenInstanceError):
        run.state = RUNNING


def test_each_eye_has_its_own_record(lit):
    lit.raybatch.sample_count = 2
    lit.render.use_multiview = True
    render()
    runs = store.runs()
    assert [run.view for run in runs] == ["right", "left"] and {run.layer for run in runs} == {"ViewLayer"}
    assert [each["view"] for each in runs_as_data(runs, 1e-3)["runs"]] == ["right", "left"]
    assert [name.split(", ")[1:] for name in names_of(runs).values()] == [["right"], ["left"]]
