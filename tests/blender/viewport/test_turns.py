"""Whose turn it is to render: final renders go first, and viewports come in the order in which they asked."""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import finals, frame, sessions
from raybatch_addon.core.live.picture import LiveRequest
from raybatch_addon.core.settings.settings import RenderSettings
from tests.blender.viewport.regions import wait_for

REQUEST = LiveRequest(1, None, RenderSettings())


@pytest.fixture
def no_sessions(monkeypatch):
    monkeypatch.setattr(sessions, "_session_of", lambda settings: "session")


@contextmanager
def waiting(names, views, order):
    """Threads with these names, which ask one after the other and note when they were lent a session."""

    def ask(name):
        with views.session(REQUEST, lambda: False) as session:
            order.append((name, session))

    threads = []
    for number, name in enumerate(names):
        threads.append(threading.Thread(target=ask, args=(name,)))
        threads[-1].start()
        wait_for(lambda: len(sessions._views) == number + 1)
    yield
    for each in threads:
        each.join()


def test_viewports_come_in_the_order_in_which_they_asked(no_sessions):
    views, order = sessions.ViewSessions(), []
    held = views.session(REQUEST, lambda: False)
    held.__enter__()
    assert not views.is_wanted(True)
    with waiting("ABCD", views, order):
        assert views.is_wanted(True) and not views.is_wanted(False)
        held.__exit__(None, None, None)
    assert order == [(name, "session") for name in "ABCD"]


def test_who_gives_up_lets_the_next_one_pass(no_sessions):
    views, order = sessions.ViewSessions(), []
    held = views.session(REQUEST, lambda: False)
    held.__enter__()
    with views.session(REQUEST, lambda: True) as nothing:
        assert nothing is None
    with waiting("A", views, order):
        held.__exit__(None, None, None)
    assert order == [("A", "session")]


def test_a_final_render_that_waits_can_be_cancelled(no_sessions):
    with sessions.session_for(RenderSettings()):
        with sessions.session_for(RenderSettings(), lambda: True) as nothing:
            assert nothing is None
        assert sessions._is_lent, "it gives back what it was not lent"
        assert finals.are_under_way()
    assert not sessions._is_lent and not finals.are_under_way()


def test_closing_waits_no_longer_than_it_is_asked_to(no_sessions):
    with sessions.session_for(RenderSettings()):
        assert not sessions.close_all(0.01)
    assert sessions.close_all() and not finals.are_under_way()


def test_viewports_wait_from_the_start_of_an_animation_to_its_end(scene, tmp_path):
    scene.render.filepath = str(tmp_path / "frame")
    scene.frame_start, scene.frame_end = 1, 2
    views, found = sessions.ViewSessions(), []

    def look(*_):
        found.append(views.is_wanted(False))

    reported = bpy.app.handlers
    watched = [reported.render_pre, reported.render_post, reported.render_write]
    for each in watched:
        each.append(look)
    frame.scene_listeners.append(look)
    try:
        bpy.ops.render.render(animation=True)
    finally:
        frame.scene_listeners.remove(look)
        for each in watched:
            each.remove(look)
    assert len(found) == 8 and all(found)
    assert not views.is_wanted(True)


def test_a_view_layer_alone_holds_viewports_off(scene):
    found = []
    finals.unregister()
    frame.scene_listeners.append(lambda *_: found.append(finals.are_under_way()))
    try:
        bpy.ops.render.render()
    finally:
        frame.scene_listeners.pop()
        finals.register()
    assert found == [True] and not finals.are_under_way()


def test_a_render_whose_end_nobody_reported_holds_viewports_off_no_longer(monkeypatch):
    monkeypatch.setattr(finals, "_is_job", True)
    assert finals.are_under_way()
    finals.look()
    assert not finals.are_under_way()


@pytest.fixture
def window(monkeypatch):
    """A Blender with a window, in which no render has a job of Blender's; its timers."""
    timers = []
    calls = SimpleNamespace(is_registered=timers.__contains__, register=lambda function, **_: timers.append(function))
    app = SimpleNamespace(background=False, is_job_running=lambda _kind: False, timers=calls, handlers=bpy.app.handlers)
    monkeypatch.setattr(finals, "bpy", SimpleNamespace(app=app))
    return timers


def test_with_a_window_what_waits_for_a_preview_is_called_by_a_timer(window):
    called = []
    with finals.under_way():
        finals.call_once_over(lambda: called.append(1))
        assert window[0]() is not None and not called
    assert window[0]() is None and called == [1]
    assert window[0]() is None and called == [1]


def test_with_a_window_a_handler_of_a_render_without_a_job_does_not_end_it(window, monkeypatch):
    """A script waits for its render: only its own thread knows of it."""
    monkeypatch.setattr(finals, "_is_job", True)
    monkeypatch.setattr(finals, "_job_thread", threading.get_ident())
    assert not finals.wait_for_end(0.0) and finals.are_under_way()
    monkeypatch.setattr(finals, "_job_thread", 0)
    assert finals.wait_for_end(0.0)
