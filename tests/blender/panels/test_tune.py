"""Tune in Blender: schedules are tried by a render, and the fastest is taken by a click."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import reports, tuning
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.tuning import Trial, Tuning
from raybatch_addon.export.settings import settings_from
from raybatch_addon.ui.tune.panel import RAYBATCH_RENDER_PT_tune, notes, table_rows
from tests.support.blender_builders import add_grid
from tests.support.panel_layout import FIRST_WIDTH, INNER_WIDTH, Measured, context_of, drawn

TRIALS = [
    Trial({}, "cpu", 0.5, True),
    Trial({"batching": "ON"}, "cpu", 0.25, True),
    Trial({"batching": "ON", "ray_sort": "ON"}, "cpu", why="slower"),
    Trial({"batching": "ON", "ray_count": 500_000}, "cpu", why="there is no room"),
]


@pytest.fixture
def found(scene, monkeypatch):
    made = Tuning(RenderSettings(), 4, "GENERAL", list(TRIALS), True)
    monkeypatch.setattr(tuning, "_last", tuning.Tuned(scene.name, made))
    return made


def test_schedules_are_tried_by_a_render(scene):
    add_grid("Grid", 20)
    scene.raybatch.device, scene.raybatch.sample_count = "cpu", 4
    before = settings_from(scene)
    shown = reports.begin(scene.name, 7)
    assert bpy.ops.raybatch.tune(seconds=0.05) == {"FINISHED"}
    made = tuning.last_tuned().tuning
    assert made.ended and made.samples >= 1
    assert reports.last() is shown and not shown.errors, "Last Render is still that of the last picture"
    assert len(made.trials) >= 5 and made.trials[0].changes == {}
    assert all(trial.same_bits for trial in made.trials if trial.seconds is not None)
    assert settings_from(scene) == before, "nothing is changed unasked"
    assert not tuning.is_tuning()
    bpy.ops.render.render()
    assert reports.last().statistics, "the next render is a picture again"
    tuning.forget_tuned()


def test_other_view_layers_are_left_alone(scene, monkeypatch):
    scene.view_layers.new("Second")
    scene.raybatch.sample_count = 2
    calls = []
    monkeypatch.setattr(tuning, "tune", lambda *args, **_rest: calls.append(args) or (Tuning(args[0]), None))
    bpy.ops.raybatch.tune(seconds=0.05)
    assert len(calls) == 1, "nothing is rendered for the second layer"
    bpy.ops.render.render()
    assert len(calls) == 1 and len(reports.last().statistics) == 2
    scene.view_layers.remove(scene.view_layers["Second"])


def test_what_was_asked_for_and_began_is_over_when_the_next_render_begins(scene):
    tuning.ask_for_tuning(scene.name, 1.0)
    tuning.begin_tuning()
    assert tuning.is_tuning()
    tuning.begin_tuning()
    assert not tuning.is_tuning(), "Blender never told of its end"


def test_an_error_leaves_the_next_render_alone(scene):
    scene.camera = None
    with pytest.raises(RuntimeError):
        bpy.ops.raybatch.tune(seconds=0.05)
    assert not tuning.is_tuning()


def test_the_fastest_is_taken_by_a_click(scene, found):
    before = settings_from(scene)
    assert bpy.ops.raybatch.take_fastest() == {"FINISHED"}
    assert settings_from(scene) == before.replace(batching="ON")
    tuning.forget_tuned()
    assert not bpy.ops.raybatch.take_fastest.poll()


def test_the_table_says_what_was_tried(scene, found):
    assert table_rows(found) == [
        ("As set", "500 ms", False),
        ("Batching: On", "250 ms", True),
        ("Sort Rays: On", "slower", False),
        ("Rays Alive: 500,000", "failed", False),
    ]
    assert any("there is no room" in line for line in notes(found))
    panel_notes = drawn(RAYBATCH_RENDER_PT_tune, context_of(scene))
    assert [note[1] for note in panel_notes if note[0] == "operator"] == ["raybatch.tune", "raybatch.take_fastest"]
    assert ("label", "250 ms", "NONE") in panel_notes
    found.trials[1] = Trial({"batching": "ON"}, "cpu", 0.25, False)
    assert any("Not the same bits: Batching: On" in line for line in notes(found))
    assert found.best.changes == {} and any("fastest already" in line for line in notes(found))
    found.ended = False
    assert "raybatch.take_fastest" not in [note[1] for note in drawn(RAYBATCH_RENDER_PT_tune, context_of(scene))]


@pytest.mark.parametrize("rays", [131_072, 999_999, 4_194_304])
@pytest.mark.parametrize("seconds", [None, 0.0333, 1234.56])
def test_the_table_fits_the_panel_at_its_first_width(scene, found, rays, seconds):
    found.trials[1:] = [Trial({"ray_count": rays}, "cpu", seconds), Trial({"kernel_tier": "SPECIALISED"}, "cpu", 0.1)]
    layout = Measured(INNER_WIDTH, is_split=False)
    context = context_of(scene, region=SimpleNamespace(width=FIRST_WIDTH))
    RAYBATCH_RENDER_PT_tune.draw(SimpleNamespace(layout=layout), context)
    assert layout.cut == [] and ("label", "As set", "BLANK1") in layout.notes


def test_the_table_is_of_its_scene(scene, found):
    other = scene.copy()
    assert [note[0] for note in drawn(RAYBATCH_RENDER_PT_tune, context_of(other))] == ["operator"]
