"""What a viewport does when something is in the way: a view of nothing, what is not there any more, another render."""

import threading

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender.viewport import viewport as viewports
from raybatch_addon.export.scene import reading
from tests.blender.viewport.reader import as_exported
from tests.blender.viewport.shown import edit


def test_a_render_region_that_leaves_the_view_takes_its_picture_with_it(shown, lit):
    shown.until(shown.is_finished)
    flat = shown.context.region.data.window_matrix.copy()
    lit.render.use_border = True
    shown.context.region.data.window_matrix[0][2] += 10
    shown.drawn.clear()
    shown.draw()
    shown.draw()
    assert not shown.drawn and shown.viewport.render.picture is None
    assert shown.viewport.status() == ("RayBatch", "")
    lit.render.use_border = False
    shown.context.region.data.window_matrix = flat
    shown.until(lambda: shown.drawn and shown.is_finished())
    assert shown.drawn[-1].samples == 4


def test_an_edit_that_cannot_be_identified_reads_all(shown, monkeypatch):
    shown.until(shown.is_finished)

    def broken(_depsgraph):
        raise ReferenceError("it is gone")

    with monkeypatch.context() as patch:
        patch.setattr(viewports, "updates_of", broken)
        data = bpy.data.objects["Grid"].data
        edit(lambda: (setattr(data.vertices[0].co, "z", 1), data.update()))
    shown.until(shown.is_finished)
    assert as_exported(shown.viewport.live)


def test_what_is_deleted_while_it_is_read_is_looked_for_once_more(shown, monkeypatch):
    shown.until(shown.is_finished)

    def gone(*_):
        raise ReferenceError("it is gone")

    monkeypatch.setattr(viewports, "live_camera", gone)
    before = shown.asked
    for _ in range(3):
        shown.draw()
    assert shown.asked == before + 1


def test_while_a_final_render_reads_it_is_drawn_now_and_then(shown, monkeypatch):
    monkeypatch.setattr(viewports, "LOCKED_SECONDS", 60.0)
    shown.until(shown.is_finished)
    locked, over = threading.Event(), threading.Event()

    def read():
        with reading:
            locked.set()
            over.wait(60)

    thread = threading.Thread(target=read)
    thread.start()
    locked.wait()
    try:
        before = shown.asked
        edit(lambda: setattr(bpy.data.objects["Grid"].data, "name", "Other"))
        shown.viewport.live.look_again()
        shown.draw()
        shown.draw()
        assert shown.asked == before and shown.viewport._timer.is_alive()
        assert shown.viewport.status()[1] == "Reading the scene"
    finally:
        over.set()
        thread.join()
        shown.viewport._timer.cancel()
    shown.until(shown.is_finished)
