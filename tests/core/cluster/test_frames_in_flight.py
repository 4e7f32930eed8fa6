"""Several renders of a cluster at once: one begins where another leaves workers, and none changes another's bits."""

import dataclasses
import os
import threading
import time

import pytest

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.cluster.connection import Connection
from raybatch_addon.core.cluster.parts import parts_of
from raybatch_addon.core.cluster.ranges import RangeDeal
from raybatch_addon.core.cluster.session import RENDERS_MOST, ClusterSession
from raybatch_addon.core.cluster.under_way import RendersUnderWay
from raybatch_addon.core.errors import RayBatchError
from tests.core.cluster.clusters import SETTINGS, dealing, wait_for
from tests.support import scenes
from tests.support.watched_renders import FRAME, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")


def frame(number):
    """A scene that is another one in each frame."""
    scene = scenes.mixed(FRAME)
    transform = scene.camera.transform.copy()
    transform[0, 3] += 0.1 * number
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, transform=transform))


def is_staged(pending):
    """Whether machines have what the render needs, so that workers may begin with it."""
    return bool(pending._under_way.render._staging.ready)


def dealing_after(condition, count):
    """As `dealing`, but nothing before `condition()` was met."""
    deal, met = dealing(count), threading.Event()

    def dealt(self, workers):
        if not met.is_set() and condition():
            met.set()
        return deal(self, workers) if met.is_set() else None

    return dealt


@pytest.fixture
def asked(monkeypatch):
    """The recipe and the first sample of each task that was asked for, in order."""
    found, submit = [], Connection.submit

    def submit_noted(self, name, *arguments, **options):
        if name == "render":
            found.append((arguments[1], arguments[3]))
        return submit(self, name, *arguments, **options)

    monkeypatch.setattr(Connection, "submit", submit_noted)
    return found


def test_frames_overlap_and_are_those_of_frames_alone(connection, session, long_tasks, asked, bands):
    cluster = ClusterSession(connection)
    films = []
    pending = cluster.begin(frame(0), SETTINGS)
    for number in range(1, 3):
        following = cluster.begin(frame(number), SETTINGS)
        films.append(pending.film())
        pending = following
    films.append(pending.film())
    for number, film in enumerate(films):
        assert_same_film(film, session.render(frame(number), SETTINGS))
        shares = film.statistics["cluster"]["shares"]
        assert shares[0]["first"] == 0 and shares[-1]["end"] == SETTINGS.sample_count
    frames = [*dict.fromkeys(digest for digest, _ in asked)]
    assert len(frames) == 3
    first = [next(i for i, each in enumerate(asked) if each[0] == digest) for digest in frames]
    assert first == sorted(first)
    cluster.close()


def test_the_next_frame_has_what_a_frame_leaves(connection, session, monkeypatch, tmp_path):
    """A frame whose last task never comes back leaves a worker to the next one, which is complete before it."""
    submit, held = Connection.submit, []

    def submit_held(self, name, *arguments, **options):
        if name == "render" and not held:
            held.append(self._client.submit(wait_there, str(tmp_path / "end"), resources={"raybatch": 1}))
            return held[0]
        return submit(self, name, *arguments, **options)

    frames = []

    def are_staged():
        """Both: what is sent to a worker would wait behind the task that never comes back."""
        return len(frames) == 2 and all(map(is_staged, frames))

    monkeypatch.setattr(RangeDeal, "next", dealing_after(are_staged, 24))
    monkeypatch.setattr(RangeDeal, "is_late", lambda self, samples, seconds: False)
    monkeypatch.setattr(Connection, "submit", submit_held)
    try:
        cluster = ClusterSession(connection)
        slow, second = cluster.begin(frame(0), SETTINGS), cluster.begin(frame(1), SETTINGS)
        frames += slow, second
        wait_for(lambda: second.is_done)
        assert not slow.is_done
        assert_same_film(second.film(), session.render(frame(1), SETTINGS))
        slow.cancel()
        assert not slow.film().complete
        cluster.close()
    finally:
        (tmp_path / "end").touch()


def wait_there(path):
    """On a worker: until there is a file."""
    while not os.path.exists(path):
        time.sleep(0.05)


def test_a_frame_that_is_waited_for_goes_first(connection, monkeypatch, asked):
    begun, cluster = [], ClusterSession(connection)

    def is_awaited():
        """Both may begin, and the later one is waited for."""
        return len(begun) == 2 and all(map(is_staged, begun)) and begun[1]._under_way.is_awaited

    monkeypatch.setattr(RangeDeal, "next", dealing_after(is_awaited, 2))
    earlier, later = cluster.begin(frame(0), SETTINGS), cluster.begin(frame(1), SETTINGS)
    begun += earlier, later
    assert later.film().complete
    assert earlier.film().complete
    frames = [digest for digest, _ in asked]
    of_first, of_second = (parts_of(frame(number), SETTINGS).digest for number in (0, 1))
    last = len(frames) - 1 - frames[::-1].index(of_second)
    assert frames[last:].count(of_first) > 12  # of 24
    cluster.close()


def test_an_error_ends_one_frame_alone(connection, session, monkeypatch, long_tasks):
    from raybatch_addon.core.cluster.keeping import ClusterKeeper

    cluster, check = ClusterSession(connection), ClusterKeeper.check
    bad, good = cluster.begin(frame(0), SETTINGS), cluster.begin(frame(1), SETTINGS)

    def checked(self, share):
        if self is bad._keeper:
            raise RayBatchError("of another device")
        check(self, share)

    monkeypatch.setattr(ClusterKeeper, "check", checked)
    with pytest.raises(RayBatchError, match="of another device"):
        bad.film()
    assert_same_film(good.film(), session.render(frame(1), SETTINGS))
    cluster.close()


def test_the_number_of_frames_at_once_has_a_bound(connection):
    cluster = ClusterSession(connection)
    begun = [cluster.begin(frame(number), SETTINGS) for number in range(RENDERS_MOST)]
    assert not cluster.has_room
    begun[0].film()
    assert cluster.has_room
    begun[1].cancel()
    assert cluster.has_room
    cluster.close()
    assert all(each.is_done for each in begun)


def test_a_frame_that_is_cancelled_leaves_the_next_one_alone(connection, session, long_tasks, tmp_path):
    cluster, path = ClusterSession(connection), tmp_path / "film.checkpoint"
    first = cluster.begin(frame(0), SETTINGS, checkpoint=Checkpoint(path, 0.05))
    second = cluster.begin(frame(1), SETTINGS)
    assert not first.film(cancelled=path.exists).complete
    assert_same_film(second.film(), session.render(frame(1), SETTINGS))
    again = cluster.begin(frame(0), SETTINGS, checkpoint=Checkpoint(path)).film()
    assert_same_film(again, session.render(frame(0), SETTINGS))
    cluster.close()


def test_nobody_waits_for_renders_that_cannot_go_on(connection, monkeypatch):
    def failing(self, renders):
        raise MemoryError("no memory is left")

    monkeypatch.setattr(RendersUnderWay, "_step", failing)
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    cluster = ClusterSession(connection)
    pending = cluster.begin(frame(0), SETTINGS)
    with pytest.raises(MemoryError, match="no memory is left"):
        pending.film()
    cluster.close()
