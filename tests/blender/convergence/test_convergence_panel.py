"""Convergence in Blender: records of renders, slots, the plot, stopping at an error, and written files."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame
from raybatch_addon.convergence.plot import SLOT_COLORS
from raybatch_addon.convergence.records import RUNNING, SLOT_COUNT, store
from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.ui.convergence import operators, shown
from raybatch_addon.ui.convergence.panel import RAYBATCH_RENDER_PT_convergence
from raybatch_addon.ui.convergence.properties import chosen_target
from tests.blender.convergence.recorded import has_color, plot, render
from tests.support.panel_layout import context_of, drawn, own_panels


def test_both_ends_of_a_render_are_shown_beside_its_samples(lit):
    sampling = next(panel for panel in own_panels() if getattr(panel, "group", "") == "SAMPLING")
    shown = [note[2] for note in drawn(sampling, context_of(lit)) if note[0] == "prop"]
    assert shown[0] == "sample_count" and "time_limit_is_on" in shown
    error = next(panel for panel in own_panels() if getattr(panel, "group", "") == "ERROR")
    assert error.bl_parent_id == sampling.__name__
    shown = [note[2] for note in drawn(error, context_of(lit)) if note[0] == "prop"]
    assert shown == ["error_estimate_is_on", "error_target_is_on"]
    own = lit.raybatch.bl_rna.properties
    assert (own["time_limit"].name, own["error_target"].name) == ("Time Limit", "Stop at Error")
    assert own["time_limit"].unit == "TIME_ABSOLUTE" and "[s]" in own["time_limit"].description
    assert "[relMSE]" in own["error_target"].description
    lit.raybatch.error_target = 0.00012
    assert frame.settings_from(lit).error_target == 0.00012 and frame.settings_from(lit).half_count == 2


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


def test_the_plot_is_an_image_with_a_curve_in_each_slots_color(lit):
    first = render()
    lit.raybatch.nee = "OFF"
    second = render()
    pixels = plot()
    assert pixels.shape == (shown.IMAGE_SIZE[1], shown.IMAGE_SIZE[0], 4) and (pixels[..., 3] == 1).all()
    assert np.median(pixels[..., :3]) < 0.2, "dark, as Blender is"
    drawn_in = [has_color(pixels, SLOT_COLORS[slot]) for slot in range(SLOT_COUNT)]
    assert all(count > 500 for count in drawn_in[:2]) and not any(drawn_in[2:])
    for run, other in ((first, second), (second, first)):
        bpy.ops.raybatch.convergence_hide(run=other.number)
        pixels = plot()
        upper, lower = pixels[: shown.IMAGE_SIZE[1] // 2], pixels[int(shown.IMAGE_SIZE[1] * 0.68) :]
        assert has_color(upper, SLOT_COLORS[run.slot]) > 100 and has_color(lower, SLOT_COLORS[run.slot]) > 20, (
            "error above, rays below"
        )
        assert not has_color(pixels, SLOT_COLORS[other.slot])
        bpy.ops.raybatch.convergence_hide(run=other.number)
    image = bpy.data.images[shown.IMAGE_NAME]
    assert not image.is_dirty, "Blender would ask to save it"


def test_the_plot_is_drawn_again_only_when_something_is_new(lit, monkeypatch):
    render()
    plot()
    calls = []
    original = shown.draw_plot
    monkeypatch.setattr(shown, "draw_plot", lambda *args: calls.append(args) or original(*args))
    plot()
    for _ in range(3):
        drawn(RAYBATCH_RENDER_PT_convergence, context_of(lit))
    assert len(calls) == 1, "once for the panel"
    lit.raybatch_convergence.target = 0.5
    plot()
    assert len(calls) == 2


def test_the_panel_shows_the_last_run_and_when_it_reaches_an_error(lit):
    panel = RAYBATCH_RENDER_PT_convergence
    why, hint, *_ = [note[1] for note in drawn(panel, context_of(lit)) if note[0] == "label"]
    assert why == "Implied by Error Estimate" and hint.startswith("The next render is recorded")
    run = render()
    lit.raybatch_convergence.target = run.points[-1].relmse / 10
    notes = drawn(panel, context_of(lit))
    text = " ".join(note[1] for note in notes if note[0] == "label")
    assert (
        "Finished: 16 samples in" in text
        and "rays/s" in text
        and "RMSE against samples: slope -" in text
        and "(extrapolated)" in text
    )
    seconds, extrapolated = run.time_to(lit.raybatch_convergence.target)
    assert extrapolated and seconds > run.seconds
    assert any(note[0] == "icon" for note in notes)
    for note in notes:
        if note[0] == "operator":
            assert set(vars(note[3])) <= set(note[4]), note[1]
    lit.raybatch.error_target = 0.25
    assert chosen_target(lit) == 0.25 and ("prop", "RayBatchSettings", "error_target") in drawn(panel, context_of(lit))


def test_a_run_that_goes_on_can_be_looked_at(lit):
    run = render()
    store.change(run.number, state=RUNNING, stopped_by=None)
    lit.raybatch_convergence.target = run.points[-1].relmse / 10
    text = " ".join(note[1] for note in drawn(RAYBATCH_RENDER_PT_convergence, context_of(lit)) if note[0] == "label")
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
    assert shown.IMAGE_NAME not in bpy.data.images, "nobody uses the plot: it is not saved"


def test_a_plot_from_a_file_is_drawn_again(lit, tmp_path):
    """The image is kept while an editor or the user holds it; later renders are not in it."""
    store.change(render().number, kept=True)
    plot()
    bpy.data.images[shown.IMAGE_NAME].use_fake_user = True
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    second = render()
    assert has_color(plot(), SLOT_COLORS[second.slot]) > 500
    bpy.ops.wm.open_mainfile(filepath=path)
    assert shown.IMAGE_NAME in bpy.data.images and has_color(plot(), SLOT_COLORS[second.slot]) > 500


def test_the_timer_shows_what_is_new_where_it_is_watched(lit, monkeypatch):
    window = bpy.data.window_managers[0].windows[0]
    monkeypatch.setattr(shown.Shown, "seen", False)
    run = render()
    assert shown.follow() == shown.IDLE_SECONDS and shown.IMAGE_NAME not in bpy.data.images, "nobody looks"
    context = context_of(lit)
    drawn(RAYBATCH_RENDER_PT_convergence, context)
    assert shown.Shown.panels, "an editor that is not there any more, since it is made up"
    store.change(run.number, seconds=run.seconds + 1)
    shown.follow()
    assert shown.IMAGE_NAME in bpy.data.images and not shown.Shown.panels
    area = window.screen.areas[0]
    before = area.type
    area.type = "IMAGE_EDITOR"
    try:
        area.spaces.active.image = bpy.data.images[shown.IMAGE_NAME]
        calls = []
        original = shown.draw_plot
        monkeypatch.setattr(shown, "draw_plot", lambda *args: calls.append(args[1]) or original(*args))
        shown.Shown.image = None
        assert shown.follow() == shown.IDLE_SECONDS and len(calls) == 1, "it is watched now"
        store.change(run.number, state=RUNNING)
        assert shown.follow() == shown.LIVE_SECONDS and len(calls) == 2
        shown.follow()
        assert len(calls) == 2, "nothing is new"
        other = bpy.data.scenes.new("Other")
        other.raybatch_convergence.target = 0.125
        window.scene = other
        shown.follow()
        assert calls[2:] == [0.125], "the target of the scene in that window"
    finally:
        area.type = before
    monkeypatch.setattr(shown, "_show_again", lambda *_: 1 / 0)
    store.clear()
    assert shown.follow() == 10.0, "an error does not end it"


def test_what_cannot_be_written_leaves_nothing(lit, tmp_path, monkeypatch):
    render()
    monkeypatch.setattr(operators, "runs_as_data", lambda *_: {"seconds": float("nan")})
    with pytest.raises(RuntimeError, match="JSON compliant"):
        bpy.ops.raybatch.convergence_save(filepath=str(tmp_path / "runs.json"))
    (tmp_path / "taken.json").mkdir()
    monkeypatch.undo()
    with pytest.raises(RuntimeError, match="no file is named"):
        bpy.ops.raybatch.convergence_save()
    with pytest.raises(RuntimeError, match="cannot write"):
        bpy.ops.raybatch.convergence_save(filepath=str(tmp_path / "taken.json"))
    assert [each.name for each in tmp_path.iterdir()] == ["taken.json"]
