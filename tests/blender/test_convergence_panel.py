"""Error and rays a second over time in Blender: records of renders, slots, the plot, stopping at an error, and what is written."""

import dataclasses
import json
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_builders import add_grid, add_object  # noqa: E402
from panel_layout import context_of, drawn, own_panels  # noqa: E402

from raybatch_addon import frame, reports  # noqa: E402
from raybatch_addon.convergence import CANCELLED, FAILED, FINISHED, RUNNING, SLOT_COUNT, store  # noqa: E402
from raybatch_addon.convergence_plot import SLOT_COLORS  # noqa: E402
from raybatch_addon.core.session import Session  # noqa: E402
from raybatch_addon.core.settings import SETTINGS  # noqa: E402
from raybatch_addon.ui import convergence as ui  # noqa: E402
from raybatch_addon.ui import last_render  # noqa: E402


@pytest.fixture
def lit(scene):
    """A grid under a lamp: its error is in the lamp's penumbra and in what bounces."""
    add_grid("Grid", 4)
    lamp = add_object("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.location = (0.5, 0.5, 1)
    scene.camera.location = (0, 0, 4)
    scene.raybatch.error_estimate = "ON"
    scene.raybatch_convergence.record = True  # without windows nothing is recorded but on demand
    scene.raybatch.sample_count = 16
    store.clear()
    yield scene
    store.clear()
    image = bpy.data.images.get(ui.IMAGE_NAME)
    if image:
        bpy.data.images.remove(image)


def render():
    """Render, and the record of it."""
    assert bpy.ops.render.render() == {"FINISHED"}
    return store.last()


def plot():
    """The plot as the user would see it: float32 [height, width, 4], top row first."""
    assert bpy.ops.raybatch.convergence_plot() == {"FINISHED"}
    image = bpy.data.images[ui.IMAGE_NAME]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def has_color(pixels, color):
    """How many pixels have it, as exactly as 8 bits keep it."""
    return int((np.abs(pixels[..., :3] - np.float32(color)) < 0.01).all(axis=-1).sum())


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
    # the rates are of all rays: rates times their seconds add up
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
    """Either way the render is one round, as if nobody watched."""
    lit.raybatch.error_estimate = "OFF"
    lit.raybatch_convergence.record = record
    observers = []
    original = Session.render

    def watched(self, *args, **options):
        observers.extend(options["observers"])
        return original(self, *args, **options)

    monkeypatch.setattr(Session, "render", watched)
    run = render()
    assert not any(hasattr(observer, "on_snapshot") for observer in observers)
    assert len(observers) == record and (run is not None) == record
    if record:
        assert run.rates and not run.points and run.slope is None and run.time_to(1e-3) is None
        lines = [text for kind, text, *_ in drawn(ui.RAYBATCH_RENDER_PT_convergence, context_of(lit)) if kind == "label"]
        assert any("Error Estimate" in text for text in lines)


@pytest.mark.parametrize("change", [{}, dict(error_target=0.003, sample_count=64), dict(time_limit=60.0)])
def test_without_windows_nothing_is_recorded_unless_it_was_asked_for(lit, change, monkeypatch):
    """The error is in the statistics either way, and the render ends where it would have."""
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
    assert frame.wants_recording(lit, settings, has_windows=True) and not frame.wants_recording(lit, settings, has_windows=False)
    unknown = settings.replace(error_estimate="OFF", error_target=0.0)
    assert not frame.wants_recording(lit, unknown, has_windows=True), "nothing tells the error"


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
    assert f", {statistics['samples_per_pixel']} samples per pixel, error " in line and line.endswith("stopped at its error")
    seconds, extrapolated = run.time_to(ui.chosen_target(lit))
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


def test_both_ends_of_a_render_are_shown_beside_its_samples(lit):
    sampling = next(panel for panel in own_panels() if getattr(panel, "group", "") == "SAMPLING")
    shown = [note[2] for note in drawn(sampling, context_of(lit)) if note[0] == "prop"]
    assert shown[:4] == ["sample_count", "time_limit", "error_estimate", "error_target"]
    own = lit.raybatch.bl_rna.properties
    assert (own["time_limit"].name, own["error_target"].name) == ("Time Limit", "Stop at Error")
    assert own["time_limit"].unit == "TIME_ABSOLUTE" and "[s]" in own["time_limit"].description
    assert "[relMSE]" in own["error_target"].description
    lit.raybatch.error_target = 0.00012
    assert frame.settings_from(lit).error_target == 0.00012 and frame.settings_from(lit).half_count == 2


def test_a_render_that_fails_or_is_cancelled_says_so(lit, monkeypatch):
    original = Session.render

    def broken(self, *args, **options):
        raise RuntimeError("out of chalk")

    monkeypatch.setattr(Session, "render", broken)
    with pytest.raises(RuntimeError, match="out of chalk"):
        bpy.ops.render.render()
    assert store.last().state == FAILED
    monkeypatch.setattr(Session, "render", lambda self, *args, **options: original(self, *args, **{**options, "cancelled": lambda: True}))
    render()
    assert store.last().state == CANCELLED
    assert last_render.report_lines(reports.last())[0].endswith("cancelled")


def test_runs_are_kept_in_slots(lit):
    lit.raybatch.sample_count = 2
    first = render()
    assert bpy.ops.raybatch.convergence_keep(run=first.number) == {"FINISHED"}
    for _ in range(SLOT_COUNT + 1):
        render()
    runs = store.runs()
    assert len(runs) == SLOT_COUNT and runs[-1].number == first.number and runs[-1].kept
    assert sorted(run.slot for run in runs) == list(range(SLOT_COUNT))
    for run in runs[:-2]:
        assert bpy.ops.raybatch.convergence_keep(run=run.number) == {"FINISHED"}
    with pytest.raises(RuntimeError, match="must be left for the next render"):
        bpy.ops.raybatch.convergence_keep(run=runs[-2].number)
    assert render().slot == runs[-2].slot
    assert bpy.ops.raybatch.convergence_keep(run=first.number) == {"FINISHED"}
    assert not store.runs()[-1].kept
    bpy.ops.raybatch.convergence_clear(run=first.number)
    assert first.number not in [run.number for run in store.runs()]
    with pytest.raises(RuntimeError, match="no run"):
        bpy.ops.raybatch.convergence_keep(run=first.number)
    bpy.ops.raybatch.convergence_clear(run=0)
    assert store.runs() == [] and not bpy.ops.raybatch.convergence_plot.poll()


def test_the_plot_is_an_image_with_a_curve_in_each_slots_colour(lit):
    first = render()
    lit.raybatch.nee = "OFF"
    second = render()
    pixels = plot()
    assert pixels.shape == (ui.IMAGE_SIZE[1], ui.IMAGE_SIZE[0], 4) and (pixels[..., 3] == 1).all()
    assert np.median(pixels[..., :3]) < 0.2, "dark, as Blender is"
    drawn_in = [has_color(pixels, SLOT_COLORS[slot]) for slot in range(SLOT_COUNT)]
    assert all(count > 500 for count in drawn_in[:2]) and not any(drawn_in[2:])
    for run, other in ((first, second), (second, first)):
        bpy.ops.raybatch.convergence_hide(run=other.number)
        pixels = plot()
        upper, lower = pixels[: ui.IMAGE_SIZE[1] // 2], pixels[int(ui.IMAGE_SIZE[1] * 0.68) :]
        assert has_color(upper, SLOT_COLORS[run.slot]) > 100 and has_color(lower, SLOT_COLORS[run.slot]) > 20, "error above, rays below"
        assert not has_color(pixels, SLOT_COLORS[other.slot])
        bpy.ops.raybatch.convergence_hide(run=other.number)
    image = bpy.data.images[ui.IMAGE_NAME]
    assert not image.is_dirty, "Blender would ask to save it"


def test_the_plot_is_drawn_again_only_when_something_is_new(lit, monkeypatch):
    render()
    plot()
    calls = []
    original = ui.draw_plot
    monkeypatch.setattr(ui, "draw_plot", lambda *args: calls.append(args) or original(*args))
    plot()
    for _ in range(3):
        drawn(ui.RAYBATCH_RENDER_PT_convergence, context_of(lit))
    assert len(calls) == 1, "once for the panel"
    lit.raybatch_convergence.target = 0.5
    plot()
    assert len(calls) == 2


def test_the_panel_tells_of_the_last_run_and_of_when_it_reaches_an_error(lit):
    panel = ui.RAYBATCH_RENDER_PT_convergence
    assert [note[1] for note in drawn(panel, context_of(lit)) if note[0] == "label"][0].startswith("The next render is recorded")
    run = render()
    lit.raybatch_convergence.target = run.points[-1].relmse / 10
    notes = drawn(panel, context_of(lit))
    text = " ".join(note[1] for note in notes if note[0] == "label")
    assert "Finished: 16 samples in" in text and "rays/s" in text and "RMSE against samples: slope -" in text and "(extrapolated)" in text
    seconds, extrapolated = run.time_to(lit.raybatch_convergence.target)
    assert extrapolated and seconds > run.seconds
    assert any(note[0] == "icon" for note in notes)
    for note in notes:
        if note[0] == "operator":
            assert set(vars(note[3])) <= set(note[4]), note[1]
    lit.raybatch.error_target = 0.25
    assert ui.chosen_target(lit) == 0.25 and ("prop", "RayBatchSettings", "error_target") in drawn(panel, context_of(lit))


def test_a_run_that_goes_on_can_be_looked_at(lit):
    run = render()
    store.change(run.number, state=RUNNING, stopped_by=None)
    lit.raybatch_convergence.target = run.points[-1].relmse / 10
    text = " ".join(note[1] for note in drawn(ui.RAYBATCH_RENDER_PT_convergence, context_of(lit)) if note[0] == "label")
    assert "Running: 16 samples" in text and "left (extrapolated)" in text
    assert has_color(plot(), SLOT_COLORS[run.slot]) > 500


def test_runs_are_written_as_json(lit, tmp_path):
    first = render()
    lit.raybatch.seed = 7
    second = render()
    path = tmp_path / "runs"
    assert bpy.ops.raybatch.convergence_save(filepath=str(path)) == {"FINISHED"}
    assert [each.name for each in tmp_path.iterdir()] == ["runs.json"]
    data = json.loads((tmp_path / "runs.json").read_text(encoding="utf-8"))
    assert data["scene"] == lit.name and data["device"] == "cpu" and data["reference"]["kind"] == "halves"
    newest, oldest = data["runs"]
    assert (newest["run"], oldest["run"], newest["seed"], oldest["seed"]) == (second.number, first.number, 7, 0)
    assert newest["settings"] == second.settings and set(newest["settings"]) == set(SETTINGS)
    assert [p["relmse"] for p in newest["points"]] == [p.relmse for p in second.points]
    assert set(newest["points"][0]) >= {"seconds", "samples", "rmse", "relmse", "flip"}
    assert newest["slope"] == second.slope.slope and newest["rates"]
    assert [each["label"] for each in data["summary"]] == [f"#{second.number}, Seed 7", f"#{first.number}, Seed 0"]
    with pytest.raises(RuntimeError, match="cannot write"):
        bpy.ops.raybatch.convergence_save(filepath=str(tmp_path / "nowhere" / "runs.json"))
    assert [each.name for each in tmp_path.iterdir()] == ["runs.json"]


def test_every_view_layer_is_a_run_of_its_own(lit):
    lit.raybatch.sample_count = 2
    lit.view_layers.new("Second")
    render()
    assert [run.layer for run in store.runs()] == ["Second", "ViewLayer"]


def test_what_the_panel_remembers_is_kept_in_the_file(lit, tmp_path):
    lit.raybatch_convergence.record, lit.raybatch_convergence.target = True, 0.25
    render()
    plot()
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    own = bpy.context.scene.raybatch_convergence
    assert own.record and own.target == 0.25
    assert store.runs(), "runs outlive the file: they are there to compare"
    assert ui.IMAGE_NAME not in bpy.data.images, "nobody uses the plot: it is not saved"


def test_a_plot_from_a_file_is_drawn_again(lit, tmp_path):
    """The image is kept where an editor or the user holds it; the renders since are not in it."""
    store.change(render().number, kept=True)
    plot()
    bpy.data.images[ui.IMAGE_NAME].use_fake_user = True
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    second = render()
    assert has_color(plot(), SLOT_COLORS[second.slot]) > 500
    bpy.ops.wm.open_mainfile(filepath=path)
    assert ui.IMAGE_NAME in bpy.data.images and has_color(plot(), SLOT_COLORS[second.slot]) > 500


def test_the_timer_shows_what_is_new_where_it_is_watched(lit, monkeypatch):
    window = bpy.data.window_managers[0].windows[0]
    monkeypatch.setattr(ui._Shown, "seen", False)
    run = render()
    assert ui._follow() == ui._IDLE_SECONDS and ui.IMAGE_NAME not in bpy.data.images, "nobody looks"
    context = context_of(lit)
    drawn(ui.RAYBATCH_RENDER_PT_convergence, context)
    assert ui._Shown.panels, "an editor that is not there any more, since it is made up"
    store.change(run.number, seconds=run.seconds + 1)
    ui._follow()
    assert ui.IMAGE_NAME in bpy.data.images and not ui._Shown.panels
    area = window.screen.areas[0]
    before = area.type
    area.type = "IMAGE_EDITOR"
    try:
        area.spaces.active.image = bpy.data.images[ui.IMAGE_NAME]
        calls = []
        original = ui.draw_plot
        monkeypatch.setattr(ui, "draw_plot", lambda *args: calls.append(args[1]) or original(*args))
        ui._Shown.image = None
        assert ui._follow() == ui._IDLE_SECONDS and len(calls) == 1, "it is watched now"
        store.change(run.number, state=RUNNING)
        assert ui._follow() == ui._LIVE_SECONDS and len(calls) == 2
        ui._follow()
        assert len(calls) == 2, "nothing is new"
        other = bpy.data.scenes.new("Other")
        other.raybatch_convergence.target = 0.125
        window.scene = other
        ui._follow()
        assert calls[2:] == [0.125], "the target of the scene in that window"
    finally:
        area.type = before
    monkeypatch.setattr(ui, "_show_again", lambda *_: 1 / 0)
    store.clear()
    assert ui._follow() == 10.0, "an error does not end it"


def test_what_cannot_be_written_leaves_nothing(lit, tmp_path, monkeypatch):
    render()
    monkeypatch.setattr(ui, "runs_as_data", lambda *_: {"seconds": float("nan")})
    with pytest.raises(RuntimeError, match="JSON compliant"):
        bpy.ops.raybatch.convergence_save(filepath=str(tmp_path / "runs.json"))
    (tmp_path / "taken.json").mkdir()
    monkeypatch.undo()
    with pytest.raises(RuntimeError, match="no file is named"):
        bpy.ops.raybatch.convergence_save()
    with pytest.raises(RuntimeError, match="cannot write"):
        bpy.ops.raybatch.convergence_save(filepath=str(tmp_path / "taken.json"))
    assert [each.name for each in tmp_path.iterdir()] == ["taken.json"]


def test_the_record_does_not_wait_for_warp():
    """Registering the add-on imports records and plots; Warp starts with the first render."""
    import subprocess

    code = "import sys, raybatch_addon.convergence, raybatch_addon.convergence_plot; sys.exit('warp' in sys.modules or 'bpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=str(frame.__file__).rsplit("raybatch_addon", 1)[0]).returncode == 0


def test_errors_that_cannot_be_computed_are_said_and_the_render_goes_on(lit, monkeypatch):
    from raybatch_addon import convergence

    def broken(snapshot):
        raise ValueError("no chalk")

    monkeypatch.setattr(convergence, "point_of_halves", broken)
    run = render()
    assert run.state == FINISHED and run.points == () and "no chalk" in run.problem
    text = " ".join(note[1] for note in drawn(ui.RAYBATCH_RENDER_PT_convergence, context_of(lit)) if note[0] == "label")
    assert "no chalk" in text


def test_runs_do_not_change(lit):
    run = render()
    with pytest.raises(dataclasses.FrozenInstanceError):
        run.state = RUNNING
