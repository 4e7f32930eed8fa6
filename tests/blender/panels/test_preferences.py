"""The add-on's preferences: how far the general kernels are, and the button that compiles them."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.ui import preferences
from tests.support.panel_layout import Layout


@pytest.fixture
def kernels(addon, monkeypatch):
    """The general kernels, as a stand-in that notes each start; their timer is taken away again."""
    kernels = SimpleNamespace(compiling=False, started=0)

    def start():
        kernels.started += 1

    monkeypatch.setattr(preferences.general_kernels, "start", start)
    monkeypatch.setattr(preferences.general_kernels, "is_compiling", lambda: kernels.compiling)
    monkeypatch.setattr(preferences.general_kernels, "state", lambda: "as far as that")
    yield kernels
    if bpy.app.timers.is_registered(preferences._look):
        bpy.app.timers.unregister(preferences._look)


def test_the_button_compiles_general_kernels_and_shows_how_far_they_are(kernels):
    assert not bpy.app.timers.is_registered(preferences._look)
    assert bpy.ops.raybatch.compile_general_kernels() == {"FINISHED"}
    assert kernels.started == 1 and bpy.app.timers.is_registered(preferences._look)
    kernels.compiling = True
    assert preferences._look() == 1.0, "it looks again as long as they are being compiled"
    kernels.compiling = False
    assert preferences._look() is None


def test_the_button_is_grey_while_they_are_being_compiled(kernels):
    assert bpy.ops.raybatch.compile_general_kernels.poll()
    kernels.compiling = True
    assert not bpy.ops.raybatch.compile_general_kernels.poll()
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.raybatch.compile_general_kernels()
    assert kernels.started == 0


def test_what_is_shown(kernels):
    layout = Layout()
    own = preferences.RayBatchPreferences
    own.draw(SimpleNamespace(layout=layout, bl_rna=own.bl_rna), None)
    label, button, *cluster = layout.notes
    assert label[1] == "General kernels: as far as that"
    assert button[:2] == ("operator", preferences.RAYBATCH_OT_compile_general_kernels.bl_idname)
    assert [note[2] for note in cluster if note[0] == "prop"] == ["cluster_address", "cluster_script", "cluster_python"]
