"""The panel Denoise where Open Image Denoise is not there."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.settings.settings import SETTINGS
from raybatch_addon.ui import render_panels
from raybatch_addon.ui.render_panels import shown_name
from tests.support.panel_layout import context_of, layout_of, own_panels

WHY = "Open Image Denoise is not there: name its file"
IN_PANEL = {shown_name(info) for info in SETTINGS.values() if info.group == "DENOISING" and info.name != "denoise"}


@pytest.fixture
def panel(addon):
    return next(each for each in own_panels() if getattr(each, "group", None) == "DENOISING")


def drawn_without(scene, panel, monkeypatch, why):
    monkeypatch.setattr(render_panels, "why_not", lambda given: why)
    context = context_of(scene)
    return layout_of(panel, context), layout_of(panel, context, "draw_header")


def labels_of(layout):
    return " ".join(note[1] for note in layout.notes if note[0] == "label")


def test_it_is_grey_and_says_why(scene, panel, monkeypatch):
    body, header = drawn_without(scene, panel, monkeypatch, WHY)
    assert set(body.grey) == IN_PANEL - {"denoise_library"}, "the library's file can still be named"
    assert header.grey == ["denoise_is_on"] and WHY in labels_of(body)


def test_what_another_computer_turned_on_can_be_turned_off(scene, panel, monkeypatch):
    scene.raybatch.denoise = "ON"
    body, header = drawn_without(scene, panel, monkeypatch, WHY)
    assert header.grey == [] and set(body.grey) == IN_PANEL - {"denoise_library"}


def test_with_the_library_nothing_is_grey(scene, panel, monkeypatch):
    for scene.raybatch.denoise, why in (("OFF", "Unused with Denoise off"), ("ON", "")):
        body, header = drawn_without(scene, panel, monkeypatch, "")
        assert body.grey == header.grey == [] and labels_of(body) == why


def test_a_file_that_is_not_there_is_the_reason(scene, panel):
    scene.raybatch.denoise_library = "/nowhere/lib.so"
    body = layout_of(panel, context_of(scene))
    assert set(body.grey) == IN_PANEL - {"denoise_library"} and "/nowhere/lib.so" in labels_of(body)
