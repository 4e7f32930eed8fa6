"""Blender's callbacks, from the engine to what the GPU is asked to draw."""

import gc
import sys
import threading
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import warm_up
from raybatch_addon.blender.viewport import callbacks
from raybatch_addon.blender.viewport.draw import PictureTexture
from raybatch_addon.blender.viewport.viewport import with_warnings
from tests.blender.viewport.regions import region_context, view_space, wait_for
from tests.blender.viewport.shown import edit

DRAW = PictureTexture.draw


class Engine:
    """What callbacks ask of Blender's engine."""

    def __init__(self, calls):
        self.viewport, self.calls, self.status = None, calls, None

    def tag_redraw(self):
        pass

    def update_stats(self, *lines):
        self.status = lines

    def bind_display_space_shader(self, _scene):
        self.calls.append("bind")

    def unbind_display_space_shader(self):
        self.calls.append("unbind")


@pytest.fixture
def calls(monkeypatch):
    """What was asked of the GPU, by fake modules."""
    made = []
    shader = SimpleNamespace(bind=lambda: None, uniform_sampler=lambda *_: None)
    gpu = SimpleNamespace(
        state=SimpleNamespace(blend_set=made.append),
        shader=SimpleNamespace(from_builtin=lambda _name: shader),
        types=SimpleNamespace(
            GPUTexture=lambda size, format, data: made.append(("texture", size, format)) or "texture",
            Buffer=lambda _kind, size, data: data.reshape(size),
        ),
    )
    batch = SimpleNamespace(draw=lambda _shader: made.append("draw"))

    def batch_for_shader(_shader, _kind, corners):
        made.append(corners["pos"])
        return batch

    monkeypatch.setitem(sys.modules, "gpu", gpu)
    monkeypatch.setitem(sys.modules, "gpu_extras", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "gpu_extras.batch", SimpleNamespace(batch_for_shader=batch_for_shader))
    return made, batch


def threads():
    return [each for each in threading.enumerate() if each.name == "RayBatch live render"]


def is_drawn(engine, context, depsgraph):
    callbacks.view_draw(engine, context, depsgraph)
    return engine.status[1].startswith("Sample 4/4")


def test_an_engine_is_drawn_and_ends_its_thread_when_it_goes(lit, calls):
    made, _ = calls
    engine, context, depsgraph = Engine(made), region_context(), bpy.context.evaluated_depsgraph_get()
    callbacks.view_draw(engine, context, depsgraph)
    assert engine.viewport is not None or engine.status == ("RayBatch", "Starting")
    warm_up.finish_warm_up()
    callbacks.view_update(engine, context, depsgraph)

    wait_for(lambda engine=engine: is_drawn(engine, context, depsgraph))
    callbacks.view_draw(engine, context, depsgraph)
    corners = ((0, 0), (48, 0), (48, 32), (0, 32))
    assert made[-6:] == ["ALPHA_PREMULT", "bind", corners, "draw", "unbind", "NONE"]
    assert ("texture", (48, 32), "RGBA32F") in made
    assert len(threads()) == 1
    del engine
    gc.collect()
    wait_for(lambda: not threads())


def test_what_fails_while_it_is_drawn_leaves_nothing_behind(lit, calls):
    made, batch = calls

    def broken(_shader):
        raise RuntimeError("the driver is gone")

    batch.draw = broken
    engine, picture = Engine(made), SimpleNamespace(box=(0, 0, 2, 1), pixels=None)
    texture = PictureTexture()
    texture._picture, texture._texture = picture, "texture"
    with pytest.raises(RuntimeError):
        DRAW(texture, engine, lit, picture, 1.0)
    assert made[-2:] == ["unbind", "NONE"]


def test_what_a_view_hides_is_gone_at_the_next_draw(shown):
    shown.until(shown.is_finished)
    assert len(shown.request.scene.instances) == 1
    space = view_space()
    space.show_object_viewport_mesh = False
    try:
        shown.until(lambda: len(shown.request.scene.instances) == 0 and shown.is_finished())
    finally:
        space.show_object_viewport_mesh = True
    shown.until(lambda: len(shown.request.scene.instances) == 1 and shown.is_finished())


def test_what_is_left_out_is_reported(shown):
    shown.until(shown.is_finished)
    edit(lambda: setattr(bpy.data.objects["Grid"], "scale", (0, 0, 0)))
    shown.until(shown.is_finished)
    text = shown.viewport.status()[1]
    assert text.startswith("Sample 4/4 | object “Grid” is left out")
    edit(lambda: setattr(bpy.data.objects["Grid"], "scale", (1, 1, 1)))
    shown.until(shown.is_finished)
    assert shown.viewport.status()[1] == "Sample 4/4"


def test_warnings_are_shown_by_the_first_and_their_number():
    assert with_warnings("Sample 1/4", []) == "Sample 1/4"
    assert with_warnings("Sample 1/4", ["a", "b", "a"]) == "Sample 1/4 | a (and 1 more)"
    assert with_warnings("", ["a"]) == "a"
