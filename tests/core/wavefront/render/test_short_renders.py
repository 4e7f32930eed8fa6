"""Short renders of a scene that was rendered before: the calling thread does them itself, and hears no less."""

import threading
from concurrent.futures import wait
from types import SimpleNamespace

import pytest

from raybatch_addon.core.ahead import prepare
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.render import rendering
from raybatch_addon.core.wavefront.render.rendering import Rendering
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

FRAME = scenes.Frame(24, 20)
# one worker, on a GPU too
SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=2, tile_size=6, thread_count=1, ray_count=1000)


@pytest.fixture
def session(monkeypatch):
    """One without threads, which looks up at each turn."""
    monkeypatch.setattr(rendering, "POLL_SECONDS", 1e-9)
    monkeypatch.setattr(Rendering, "_is_short", lambda self: True)
    return Session(DEVICE)


@pytest.fixture
def threads(monkeypatch):
    """Where tiles were rendered, in order."""
    found, real = [], TileIntegrator.render

    def noted(*args, **options):
        found.append(threading.current_thread())
        return real(*args, **options)

    monkeypatch.setattr(TileIntegrator, "render", noted)
    return found


def test_tiles_are_handed_out_as_they_are_finished(session, threads):
    scene, counts = scenes.mixed(FRAME), []
    film = session.render(scene, SETTINGS, on_tile=lambda tile: counts.append(len(threads)))
    assert counts == list(range(1, 17)) and set(threads) == {threading.main_thread()}
    assert film.complete


def test_a_stop_behind_a_tile_is_heard_and_the_rest_goes_on(session, threads):
    scene, tiles = scenes.mixed(FRAME), []
    whole = Session(DEVICE).render(scene, SETTINGS)
    del threads[:]
    film = session.render(scene, SETTINGS, on_tile=tiles.append, cancelled=lambda: len(tiles) >= 2)
    assert len(threads) == len(tiles) == 2 and not film.complete
    film = session.render(scene, SETTINGS, resume=film)
    assert film.complete and len(threads) == 16
    assert film.passes["Combined"].tobytes() == whole.passes["Combined"].tobytes()


def test_a_stop_amid_a_tile_is_heard(session, threads):
    """Once its first paths are over: while kernels are waited for, it is asked too."""
    asked = []

    def cancelled():
        asked.extend(threads)  # one, from when the tile begins
        return len(asked) > 20

    settings = SETTINGS.replace(sample_count=4096, tile_size=32, ray_count=16)
    film = session.render(scenes.mixed(FRAME), settings, cancelled=cancelled)
    assert not film.complete and 0 < film.sample_total < 4096 * FRAME.pixel_count


def test_an_error_of_whoever_takes_tiles_is_raised(session):
    def fail(_tile):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        session.render(scenes.mixed(FRAME), SETTINGS, on_tile=fail)


def test_only_workers_that_were_fast_before_have_no_thread(threads, monkeypatch):
    """By their paths of the same scene: how long those of another one take nobody knows."""
    session, scene = Session(DEVICE), scenes.mixed(FRAME)
    if not session.device.is_cpu:
        pytest.skip("workers are kept on a CPU alone")
    monkeypatch.setattr(rendering, "SHORT_SECONDS", 3600.0)
    main = threading.main_thread()
    for expected in (False, True):
        del threads[:]
        session.render(scene, SETTINGS)
        assert {thread is main for thread in threads} == {expected}
    monkeypatch.setattr(rendering, "SHORT_SECONDS", 1e-6)
    del threads[:]
    session.render(scene, SETTINGS)
    assert main not in threads, "it takes longer than that"


@pytest.mark.parametrize("thread_count", [1, 3])
def test_a_cancel_amid_the_build_begins_no_path(monkeypatch, thread_count):
    """However soon the build is over: nobody asks for a cancel behind it but the render itself."""
    pressed, real = [], DeviceScene.build

    def build(*args, **options):
        made = real(*args, **options)
        pressed.append(True)
        return made

    def start(thread):
        begin(thread)
        thread.join(0.2)  # it gets as far as it can

    session, scene = Session(DEVICE), scenes.mixed(FRAME)
    session.render(scene, SETTINGS.replace(thread_count=thread_count, bounce_max=1))  # kernels are there
    monkeypatch.setattr(DeviceScene, "build", staticmethod(build))
    monkeypatch.setattr(prepare, "is_awaited", lambda future, *_: wait([future]).done)
    begin = threading.Thread.start
    slow = SimpleNamespace(Thread=type("Slow", (threading.Thread,), {"start": start}), Event=threading.Event)
    monkeypatch.setattr(rendering, "threading", slow)
    film = session.render(scene, SETTINGS.replace(thread_count=thread_count), cancelled=lambda: bool(pressed))
    assert pressed and not film.complete and film.sample_total == 0
