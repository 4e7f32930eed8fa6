"""A render that is ended at once gives up its paths, and leaves nothing behind for the next one."""

import time
from contextlib import closing

import pytest

from raybatch_addon.core.observers import Cancel
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=64, bounce_max=4, thread_count=2)


@pytest.mark.parametrize("changes", [{}, {"batching": "ON", "treelet_size": 2048}], ids=["unbatched", "batched"])
def test_the_next_film_has_the_same_bits(monkeypatch, changes):
    scene, settings = scenes.mixed(scenes.Frame(64, 48)), SETTINGS.replace(**changes)
    with closing(Session(DEVICE)) as fresh:
        whole = fresh.render(scene, settings).passes["Combined"].tobytes()
    turns, shaded, real = [], [], TileIntegrator._shade
    monkeypatch.setattr(TileIntegrator, "_shade", lambda *args: shaded.append(len(turns)) or real(*args))

    def cancelled():
        turns.append(len(shaded))
        return Cancel.AT_ONCE if len(shaded) > 3 else False

    with closing(Session(DEVICE)) as session:
        for _ in range(3):
            del turns[:], shaded[:]
            film = session.render(scene, settings.replace(sample_count=1_000_000), cancelled=cancelled)
            assert not film.complete and film.resume_state is None
        monkeypatch.undo()
        assert session.render(scene, settings).passes["Combined"].tobytes() == whole


def test_no_path_is_shaded_after_it(monkeypatch):
    """Also in the turn that was under way: its rays are back, and the calling thread has heard of the end."""
    scene, traced, shaded, real = scenes.mixed(scenes.Frame(64, 48)), [], [], TileIntegrator._trace

    def trace(self, work, film, camera, stop):
        back = real(self, work, film, camera, stop)
        traced.append(self)
        while not stop():
            time.sleep(0.001)
        return back

    monkeypatch.setattr(TileIntegrator, "_trace", trace)
    monkeypatch.setattr(TileIntegrator, "_shade", lambda *_: shaded.append(True))
    settings = SETTINGS.replace(sample_count=1_000_000)
    with closing(Session(DEVICE)) as session:
        film = session.render(scene, settings, cancelled=lambda: Cancel.AT_ONCE if traced else False)
    assert traced and not shaded and not film.complete
