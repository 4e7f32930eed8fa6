"""Work that a cancelled render leaves behind: it goes on, is waited for, and touches nothing of that render."""

import dataclasses
import gc
import threading
import weakref

import pytest

from raybatch_addon.core.ahead.aside import WaitedParts, begin_aside, end_of, is_awaited, once_free
from raybatch_addon.core.measure.parts import Parts
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.support import feature_scenes, scenes
from tests.support.under_test import DEVICE

SECONDS = 60.0  # a test waits for this at most


class Made:
    """What some work makes."""


def test_the_end_of_work_does_not_keep_what_it_made():
    done = begin_aside(Made)
    assert is_awaited(done, lambda: False, lambda: None)
    over, made = end_of(done), weakref.ref(done.result())
    assert over.done() and over.result() is None
    del done
    gc.collect()
    assert made() is None


def test_work_begins_once_free_and_no_clock_is_turned_that_nobody_reads():
    free, order, parts = threading.Event(), [], Parts("check")
    waited = WaitedParts(parts)
    first = begin_aside(lambda: free.wait(SECONDS) and order.append("first"))
    second = begin_aside(lambda: once_free(end_of(first), lambda: order.append("second"), lambda: False, waited))
    assert not is_awaited(second, lambda: parts.part == "wait", lambda: None)
    waited.give_up()
    parts.enter("report")
    free.set()
    second.result(SECONDS)
    waited.enter("tree")
    assert order == ["first", "second"] and parts.part == "report"


class Fault(Exception):
    """An error raised by a callback."""


@pytest.mark.parametrize("way", ["cancelled", "raised"])
def test_a_session_closes_when_the_displacement_that_was_left_behind_is_over(monkeypatch, way):
    free, begun, order = threading.Event(), threading.Event(), []

    def displaced(_self, scene, *_):
        begun.set()
        assert free.wait(SECONDS)
        order.append("displaced")
        return scene

    def on_progress(_):
        if way == "raised" and begun.is_set():
            raise Fault

    monkeypatch.setattr(SceneCache, "displaced", displaced)
    scene = scenes.mixed(scenes.Frame(8, 8))
    scene = dataclasses.replace(scene, materials=(feature_scenes.displacing(),) * len(scene.materials))
    session, settings = Session(DEVICE), RenderSettings(sample_count=1)
    try:
        film = session.render(
            scene, settings, on_progress=on_progress, cancelled=lambda: way == "cancelled" and begun.is_set()
        )
        assert way == "cancelled" and not film.complete
    except Fault:
        assert way == "raised"
    closing = threading.Thread(target=lambda: (session.close(), order.append("closed")))
    closing.start()
    closing.join(0.2)
    free.set()
    closing.join(SECONDS)
    assert order == ["displaced", "closed"]
