"""Workers of one device that launch in turns: here those of a CPU, too, stand for those of a GPU."""

import contextlib
import threading

import pytest

from raybatch_addon.core.device.launches import LaunchTurns, RepeatedLaunches
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.path_lists import Counts
from raybatch_addon.core.wavefront.render import workers
from tests.support import scenes
from tests.support.watched_renders import FRAME, SETTINGS, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")

# what a device does that has one worker: others are refused turns where a number of paths is given
ALONE = SETTINGS.replace(thread_count=1, tile_size=7, tile_order="TILE_FIRST", sample_count=12, ray_count=200)
IN_TURNS = ALONE.replace(ray_count=0)
PATIENCE = 60.0  # [s]


@pytest.fixture(autouse=True)
def in_turns(monkeypatch):
    """Each device has two workers that take turns, where that is left open, and few paths, so that a tile takes many
    turns.
    """
    monkeypatch.setattr(workers, "launches_in_turns", lambda scene, frame, settings: not settings.ray_count)
    monkeypatch.setattr(workers, "CUDA_RAYS_MOST", 64)
    monkeypatch.setattr(workers, "paths_a_worker", lambda settings, *_: settings.ray_count or 64)


@pytest.mark.parametrize(
    "changed", [{}, {"tile_order": "PROGRESSIVE"}, {"error_estimate": "ON"}, {"sample_order": "PIXEL_FIRST"}]
)
def test_the_film_is_that_of_one_worker(session, changed):
    scene = scenes.mixed(FRAME)
    expected = session.render(scene, ALONE.replace(**changed))
    film = session.render(scene, IN_TURNS.replace(**changed))
    assert_same_film(film, expected)
    assert film.statistics["rays"] == expected.statistics["rays"]
    assert (expected.statistics["schedule"]["workers"], film.statistics["schedule"]["workers"]) == (1, 2)
    assert film.statistics["schedule"]["ray_count"] == 2 * 64


class Held(LaunchTurns):
    """Turns that know whose they are; None: nobody's."""

    whose: int | None = None

    def __enter__(self):
        super().__enter__()
        self.whose = threading.get_ident()

    def __exit__(self, *error):
        self.whose = None
        super().__exit__(*error)

    @contextlib.contextmanager
    def left(self):
        self.whose = None
        with super().left():
            yield
        self.whose = threading.get_ident()


def test_all_launches_are_of_whoever_has_the_turn(session, monkeypatch):
    made, strange, launches, launch = [], [], set(), RepeatedLaunches.launch

    def make():
        made.append(Held())
        return made[-1]

    def launched(self, *inputs):
        launches.add(threading.get_ident())
        strange.extend(each for each in [made[-1].whose] if each != threading.get_ident())
        launch(self, *inputs)

    monkeypatch.setattr(workers, "LaunchTurns", make)
    monkeypatch.setattr(RepeatedLaunches, "launch", launched)
    session.render(scenes.mixed(FRAME), IN_TURNS)
    assert len(made) == 1 and len(launches) == 2 and not strange


def test_a_worker_that_waits_lets_the_other_launch(session, monkeypatch):
    """The first to wait does so until the other one has launched a turn."""
    first, other, arrived, send = [], threading.Event(), Counts.arrived, Counts.send
    came = []

    def sent(self):
        send(self)
        if first and threading.get_ident() != first[0]:
            other.set()

    def waited(self):
        if not first:
            first.append(threading.get_ident())
            came.append(other.wait(PATIENCE))
        return arrived(self)

    monkeypatch.setattr(Counts, "send", sent)
    monkeypatch.setattr(Counts, "arrived", waited)
    film = session.render(scenes.mixed(FRAME), IN_TURNS)
    assert came == [True] and film.complete


def test_a_worker_that_fails_leaves_its_turn(session, monkeypatch):
    shade, calls = TileIntegrator._shade, []

    def shaded(self, *inputs):
        calls.append(1)
        if len(calls) == 5:
            raise RuntimeError("this one fails")
        shade(self, *inputs)

    monkeypatch.setattr(TileIntegrator, "_shade", shaded)
    found = []

    def render():
        with pytest.raises(RuntimeError, match="this one fails"):
            session.render(scenes.mixed(FRAME), IN_TURNS)
        found.append("raised")

    thread = threading.Thread(target=render, daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert found == ["raised"]


def test_a_turn_is_of_one_at_a_time():
    turns, inside, most = LaunchTurns(), [], []

    def work():
        for _ in range(200):
            with turns:
                inside.append(1)
                most.append(len(inside))
                inside.pop()
                with turns.left():
                    pass
                inside.append(1)
                most.append(len(inside))
                inside.pop()

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1
