"""The last renders in Blender's slots."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame
from raybatch_addon.ui.compare import slots
from raybatch_addon.ui.compare.panel import RAYBATCH_RENDER_PT_compare
from tests.support.blender_builders import add_grid
from tests.support.blender_watch import watch_engines
from tests.support.panel_layout import context_of, drawn


@pytest.fixture
def rendered(scene):
    slots.forget_slots()
    add_grid("Grid", 4)
    there = slots.slots()
    if there is not None:
        there.active_index = 0
    yield scene
    slots.forget_slots()


def test_renders_go_into_slots_of_their_own(rendered):
    numbers = []
    for samples in (1, 2, 3):
        rendered.raybatch.sample_count = samples
        assert bpy.ops.raybatch.render_in_new_slot() == {"FINISHED"}
        numbers.append(slots.slots().active_index)
    assert len(set(numbers)) == 3, "each has its own"
    assert [each.settings["sample_count"] for _, each in slots.known_renders()] == [3, 2, 1]
    labels = [note[1] for note in drawn(RAYBATCH_RENDER_PT_compare, context_of(rendered)) if note[0] == "label"]
    assert "Here Samples 2" in labels and "Here Samples 1" in labels and "Here Samples 3" not in labels
    buttons = [note for note in drawn(RAYBATCH_RENDER_PT_compare, context_of(rendered)) if note[0] == "operator"]
    assert [note[2] for note in buttons[1:]] == [f"Slot {number + 1}" for number in reversed(numbers)]
    bpy.ops.raybatch.show_slot(slot=numbers[0])
    assert slots.slots().active_index == numbers[0]
    with pytest.raises(RuntimeError, match="there is no slot 100"):
        bpy.ops.raybatch.show_slot(slot=99)


def test_a_render_in_the_same_slot_takes_the_place_of_the_last(rendered):
    for samples in (1, 2):
        rendered.raybatch.sample_count = samples
        bpy.ops.render.render()
    assert [each.settings["sample_count"] for _, each in slots.known_renders()] == [2]


def test_what_was_done_of_a_cancelled_render_is_listed(rendered, monkeypatch):
    """Esc has Blender call the handlers of a cancel; here, where nobody can press it, the test does."""
    bpy.ops.render.render()
    rendered.raybatch.sample_count = 1_000_000
    fractions = []
    with monkeypatch.context() as patch:
        patch.setattr(frame, "progress_listeners", [lambda progress: fractions.append(progress.fraction)])
        watch_engines(patch, test_break=lambda _engine: max(fractions, default=0) > 0)
        bpy.app.handlers.render_complete.remove(slots.note_render)
        try:
            bpy.ops.render.render()
        finally:
            bpy.app.handlers.render_complete.append(slots.note_render)
    assert [each.settings["sample_count"] for _, each in slots.known_renders()] == [2]
    for handler in bpy.app.handlers.render_cancel:
        if handler is slots.note_render:
            handler(rendered)
    ((_, found),) = slots.known_renders()
    assert found.settings["sample_count"] == 1_000_000 and "cancelled" in found.title


def test_the_oldest_render_goes_where_all_slots_are_taken(rendered):
    bpy.ops.render.render()
    settings = slots.known_renders()[0][1].settings
    count = len(slots.slots())
    for index in range(count):
        slots._renders[index] = slots.SlotRender(1000 + (index - 2) % count, "", dict(settings))
    assert slots.next_slot() == 2


def test_nothing_is_listed_before_a_render(rendered):
    labels = [note[1] for note in drawn(RAYBATCH_RENDER_PT_compare, context_of(rendered)) if note[0] == "label"]
    assert labels and labels[0].startswith("Renders are listed here")
