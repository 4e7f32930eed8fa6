"""The checkpoint of a render on a cluster: written where it is time, beside the render, and at its end."""

import threading
import time
from types import SimpleNamespace

import pytest

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.checkpoint.file import load_kept
from raybatch_addon.core.cluster import keeping
from raybatch_addon.core.cluster.keeping import ClusterKeeper
from raybatch_addon.core.cluster.rounds import ClusterRounds
from raybatch_addon.core.cluster.session import ClusterSession
from raybatch_addon.core.cluster.under_way import RendersUnderWay
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.cluster.clusters import SETTINGS, wait_for
from tests.support import scenes
from tests.support.watched_renders import FRAME, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")


@pytest.fixture
def films(session, tmp_path):
    """What a render keeps after 1, 2 and 3 samples, and its rounds, of which none has ended."""
    found = []
    for count in (1, 2, 3):
        path = tmp_path / f"{count}.checkpoint"
        session.render(scenes.mixed(FRAME), RenderSettings(sample_count=count), checkpoint=Checkpoint(path))
        found.append(load_kept(path))
    return found, ClusterRounds(FRAME, RenderSettings(sample_count=8), 0)


@pytest.fixture
def written(monkeypatch):
    """How many samples each film that was written has, and an event that writing waits for."""
    counts, goes_on, save = [], threading.Event(), keeping.save_merged
    goes_on.set()

    def save_noted(path, film):
        goes_on.wait()
        counts.append(film.progress.done)
        save(path, film)

    monkeypatch.setattr(keeping, "save_merged", save_noted)
    return counts, goes_on


def test_films_are_written_where_it_is_time_and_at_the_end(films, written, tmp_path):
    keeper = ClusterKeeper(0, tmp_path / "kept.checkpoint", 1000.0)
    for film in films[0]:
        keeper.keep(film, [], films[1])
    assert keeper.film is films[0][-1] and not keeper.is_due()
    keeper.finish()
    assert written[0] == [3] and load_kept(tmp_path / "kept.checkpoint").progress.done == 3
    keeper.finish()
    assert written[0] == [3]


def test_a_slow_disk_holds_nobody_up(films, written, tmp_path):
    keeper = ClusterKeeper(0, tmp_path / "kept.checkpoint", 0.0)
    written[1].clear()
    for film in films[0]:
        keeper.keep(film, [], films[1])  # returns, though nothing is written
    assert not written[0]
    written[1].set()
    keeper.finish()
    assert written[0] == [1, 3]


def test_a_session_that_closes_keeps_what_came(connection, session, long_tasks, tmp_path):
    path, scene = tmp_path / "film.checkpoint", scenes.mixed(FRAME)
    cluster = ClusterSession(connection)
    pending = cluster.begin(scene, SETTINGS, checkpoint=Checkpoint(path, 0.0))
    wait_for(lambda: pending._keeper.film is not None)
    cluster.close()
    assert 0 < load_kept(path).progress.done == pending._keeper.film.progress.done
    again = ClusterSession(connection).render(scene, SETTINGS, checkpoint=Checkpoint(path))
    assert_same_film(again, session.render(scene, SETTINGS))


def test_who_is_cancelled_does_not_wait_for_a_scheduler_that_is_lost():
    """Others do."""

    class Lost:
        is_lost = True

        def reconnect(self, cancelled):
            while not cancelled():
                time.sleep(0.01)
            return False

    render = SimpleNamespace(is_over=False, look=None, is_rendering=False, close=lambda: None)
    both = [
        SimpleNamespace(render=render, is_cancelled=False, is_over=False, error=None, is_awaited=False, parts=None)
        for _ in range(2)
    ]
    thread = threading.Thread(target=RendersUnderWay(Lost())._reconnect, args=(both,), daemon=True)
    thread.start()
    both[1].is_cancelled = True
    thread.join(60.0)
    assert not thread.is_alive()
