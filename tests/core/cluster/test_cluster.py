"""Renders on a cluster of two processes: the film of one, bit for bit, whatever happens to them."""

import contextlib
import itertools
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

distributed = pytest.importorskip("distributed")

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.checkpoint.file import CheckpointError
from raybatch_addon.core.cluster import calls, films, work
from raybatch_addon.core.cluster import connection as connection_module
from raybatch_addon.core.cluster.connection import ClusterError, Connection, is_diagnosed, why_lost
from raybatch_addon.core.cluster.report.tasks_again import TasksAgain
from raybatch_addon.core.cluster.session import ClusterSession
from raybatch_addon.core.errors import BudgetError, DeviceError, SettingsError
from tests.core.cluster.clusters import SETTINGS, cut_into, wait_for
from tests.support import scenes
from tests.support.running.shares import thorough_but
from tests.support.under_test import DEVICE
from tests.support.watched_renders import FRAME, PASSES, assert_same, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")


def pids(connection):
    return connection._client.run(os.getpid)


def render(connection, **options):
    return ClusterSession(connection).render(scenes.mixed(FRAME), options.pop("settings", SETTINGS), **options)


def test_the_film_is_that_of_one_process(connection, expected, cut):
    tiles, fractions = [], []
    film = render(connection, on_tile=tiles.append, on_progress=lambda each: fractions.append(each.fraction))
    assert_same_film(film, expected)
    assert (tiles[-1].width, tiles[-1].height) == (FRAME.width, FRAME.height)
    assert_same(tiles[-1].passes, expected.passes)
    assert fractions[-1] == 1.0 and max(fractions) <= 1.0
    shares = film.statistics["cluster"]["shares"]
    regions = sorted({tuple(each["region"]) for each in shares})
    assert len(regions) == cut
    assert regions[0][:2] == (0, 0) and regions[-1][2:] == (FRAME.width, FRAME.height)
    assert all(a[3] == b[1] for a, b in itertools.pairwise(regions))
    for region in regions:
        own = [each for each in shares if tuple(each["region"]) == region]
        assert own[0]["first"] == 0 and own[-1]["end"] == SETTINGS.sample_count
        assert all(a["end"] == b["first"] for a, b in itertools.pairwise(own))
    assert film.statistics["rays"] == expected.statistics["rays"]
    assert film.statistics["samples"] == expected.statistics["samples"]


def test_halves_and_a_later_range(connection, session, bands):
    settings = SETTINGS.replace(error_estimate="ON", sample_count=10)
    film = render(connection, settings=settings, sample_first=16)
    whole = session.render(scenes.mixed(FRAME), settings, sample_first=16)
    assert_same_film(film, whole)
    for mine, theirs in zip(film.halves, whole.halves, strict=True):
        assert_same(mine.passes, theirs.passes)


def test_what_a_machine_has_is_not_sent_again(connection, expected, monkeypatch):
    sent = []
    send = Connection.send
    monkeypatch.setattr(Connection, "send", lambda self, value, worker: sent.append(value) or send(self, value, worker))
    render(connection)  # by the first test, or now
    sent.clear()
    assert_same_film(render(connection), expected)
    assert sent == []


@pytest.mark.parametrize("seed", thorough_but([0, 1], range(5)))
def test_workers_that_are_killed_lose_nothing(connection, expected, long_tasks, seed, monkeypatch):
    if seed % 2:
        cut_into(3, monkeypatch)
    rng, over, killed = random.Random(seed), threading.Event(), []

    def kill():
        while not over.wait(rng.uniform(0.1, 1.0)):
            with contextlib.suppress(Exception):
                address, pid = rng.choice(sorted(pids(connection).items()))
                os.kill(pid, signal.SIGKILL)
                killed.append(address)
            if len(killed) == 2:
                return

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        film = render(connection)
    finally:
        over.set()
        thread.join()
    assert_same_film(film, expected)
    gone = [each["who"] for each in film.statistics["cluster"]["events"] if each["kind"] == "WORKER_GONE"]
    assert {*gone} <= {*killed}
    wait_for(lambda: len(connection.workers()) == 2)


def test_a_task_whose_worker_is_killed_counts_and_is_said(connection, expected, long_tasks):
    notes, killed = [], []
    connection._report = notes.append

    def kill(_progress):
        if killed:
            return
        for address, pid in pids(connection).items():
            os.kill(pid, signal.SIGSTOP)  # it keeps what it has, but for what it has sent
            time.sleep(0.1)
            if any(key.startswith("raybatch-render-") for key in connection._client.processing()[address]):
                os.kill(pid, signal.SIGKILL)
                killed.append(address)
                return
            os.kill(pid, signal.SIGCONT)

    film = render(connection, on_progress=kill)
    assert_same_film(film, expected)
    cluster = film.statistics["cluster"]
    late = [each for each in cluster["events"] if each["kind"] == "TASK_LATE"]
    assert cluster["tasks_again"] >= 1 + len(late)
    assert notes == [f"worker {killed[0]} ended; what it was asked for is rendered elsewhere"]
    wait_for(lambda: len(connection.workers()) == 2)


def test_a_task_that_dask_gives_out_again_counts_once_each_time():
    again, futures = TasksAgain(), [SimpleNamespace(key=key) for key in "ab"]
    assert [again.know(each) for each in futures] == futures
    again.give({("a", 1.0), ("b", 1.0), ("of another render", 1.0)})
    again.give({("a", 1.0), ("a", 2.0)})
    assert again.count == 3
    again.ask(futures[:1])  # instead of what Dask does
    again.give({("a", 3.0)})
    assert again.count == 2
    again.ask()
    assert again.count == 3


def test_a_worker_that_is_stopped_is_left_out(connection, expected, long_tasks, monkeypatch):
    monkeypatch.setattr(connection_module, "SILENT_SECONDS", 3.0)
    notes = []
    connection._report = notes.append
    stopped, seen = min(pids(connection).values()), []

    def on_progress(progress):
        if progress.stage == "render" and not seen:
            seen.append(progress)
            os.kill(stopped, signal.SIGSTOP)

    try:
        film = render(connection, on_progress=on_progress)
        assert_same_film(film, expected)
        assert [each for each in notes if "is silent" in each]
        assert "WORKER_SILENT" in [each["kind"] for each in film.statistics["cluster"]["events"]]
    finally:
        with contextlib.suppress(ProcessLookupError):  # its nanny ended it
            os.kill(stopped, signal.SIGKILL)
    wait_for(lambda: len(connection.workers()) == 2)


@pytest.mark.parametrize("name", ["render", "merge"])
def test_a_film_that_is_damaged_is_rendered_again(connection, expected, long_tasks, monkeypatch, name, cut):
    submit, spoiled = Connection.submit, []

    def spoil(sent):
        sent["halves"][0]["window"] = sent["halves"][0]["window"] ^ np.uint32(4)
        return sent

    def submit_spoiled(self, function, *arguments, **options):
        future = submit(self, function, *arguments, **options)
        if function == name and not spoiled:
            spoiled.append(future)
            return self._client.submit(spoil, future, pure=False)
        return future

    monkeypatch.setattr(Connection, "submit", submit_spoiled)
    film = render(connection)
    assert_same_film(film, expected)
    assert spoiled and film.statistics["cluster"]["tasks_again"] >= 1
    kinds = {each["kind"] for each in film.statistics["cluster"]["events"]}
    assert kinds & {"FILM_DAMAGED", "TASK_LATE"}  # another worker may have been first, if it was late


def test_a_second_copy_of_a_film_stays(connection):
    """Dask's scheduler drops copies that nobody asked for; these would be lost with their worker then."""
    future = connection._client.submit(bytes, 1000, pure=False)
    future.result()
    connection.secure(future)
    for _ in range(3):
        connection._client.amm.run_once()
    (holders,) = connection._client.who_has([future]).values()
    assert len(holders) == 2


def test_a_film_that_is_always_damaged_is_an_error(connection, monkeypatch):
    monkeypatch.setattr(films, "received_film", damaged)
    with pytest.raises(films.RayBatchError, match="damaged on its way"):
        render(connection)


def damaged(_sent):
    raise films.DamagedFilm("a film was damaged on its way")


def test_a_cancelled_render_keeps_a_checkpoint_that_any_render_goes_on_with(
    connection, session, expected, long_tasks, tmp_path, cut
):
    path, asked = tmp_path / "film.checkpoint", []

    def cancelled():
        asked.append(1)
        return path.exists() and len(asked) > 10

    film = render(connection, checkpoint=Checkpoint(path, 0.1), cancelled=cancelled)
    assert not film.complete and 0 < film.sample_count < SETTINGS.sample_count
    copy = path.with_name("copy.checkpoint")
    copy.write_bytes(path.read_bytes())
    notes = []
    cluster = ClusterSession(connection, notes.append)
    assert_same_film(cluster.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path)), expected)
    assert f"{film.sample_count} of 48 samples are there" in notes[0]
    assert_same_film(session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(copy)), expected)
    more = SETTINGS.replace(seed=4)
    with pytest.raises(CheckpointError, match="it was begun with seed = 0"):
        cluster.render(scenes.mixed(FRAME), more, checkpoint=Checkpoint(path))


def merging_fails(monkeypatch, times):
    """The first merges fail as on a full disk; they are noted in what is returned."""
    submit, failed = Connection.submit, []

    def submit_some(self, function, *arguments, **options):
        if function != "merge" or len(failed) >= times:
            return submit(self, function, *arguments, **options)
        failed.append(self._client.submit(on_full_disk, pure=False))
        return failed[-1]

    monkeypatch.setattr(Connection, "submit", submit_some)
    return failed


def on_full_disk():
    raise OSError(28, "No space left on device")


def test_what_a_machine_fails_to_merge_is_merged_again(connection, expected, long_tasks, monkeypatch):
    failed = merging_fails(monkeypatch, 2)
    film = render(connection)
    assert_same_film(film, expected)
    lost = [each for each in film.statistics["cluster"]["events"] if each["kind"] == "TASK_LOST"]
    assert len(failed) == 2 == len(lost) and "No space left on device" in lost[0]["text"]


def test_a_machine_that_fails_is_named(connection, long_tasks, monkeypatch):
    merging_fails(monkeypatch, 100)
    with pytest.raises(ClusterError, match=r"127\.0\.0\.1 cannot do its part: OSError: .*No space left on device"):
        render(connection)


def test_who_is_at_fault_for_an_error(connection):
    for fails, host in ((open, "127.0.0.1"), (int, "")):  # a folder is no file, nor a number
        future = connection._client.submit(fails, "/", pure=False)
        assert future.exception()  # waits for it
        assert connection.failed_on(future) == host


def test_a_dashboard_is_there_where_the_scheduler_shows_one(connection):
    assert connection.dashboard == ""  # though it has an address for one
    assert connection._client.run_on_scheduler(shown_pages, True) == 1
    assert connection.dashboard.endswith("/status")
    assert connection._client.run_on_scheduler(shown_pages, False) == 0


def shown_pages(are_there, dask_scheduler=None):
    """Stand-ins for those of Bokeh; how many there are."""
    pages = dask_scheduler.http_application.applications
    pages[:] = [None] if are_there else []
    return len(pages)


def test_machines_that_went_are_known_for_a_while(connection):
    connection._known |= {"a": connection._looked - 10.0}
    assert connection.known_hosts(11.0) == {"a", "127.0.0.1"}
    assert connection.known_hosts(10.0) == {"127.0.0.1"}


def test_an_error_of_a_machine_is_told_from_one_of_the_scene(monkeypatch):
    def fails(error):
        raise error

    monkeypatch.setattr(work, "lacks", fails)
    with pytest.raises(OSError, match="^kernels cannot be kept; make room$") as raised:
        calls.call("lacks", DeviceError("kernels cannot be kept; make room"))
    future = SimpleNamespace(status="error", exception=lambda: raised.value)
    assert is_diagnosed(future) and why_lost(future) == "kernels cannot be kept; make room"
    future.exception = lambda: OSError(28, "No space left on device")
    assert not is_diagnosed(future) and why_lost(future) == "OSError: [Errno 28] No space left on device"
    assert calls.call("lacks", SettingsError("no such value")) == {"error": "SettingsError", "text": "no such value"}
    assert calls.call("lacks", BudgetError("raise it")) == {"error": "BudgetError", "text": "raise it"}


def test_what_cannot_be_kept_is_an_error(connection, monkeypatch):
    other = scenes.mixed(scenes.Frame(9, 7, passes=PASSES))
    connection._client.run(make_full)
    try:
        mesh = scenes.sphere(segments=11, rings=7)
        scene = scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse())], frame=other.frame, world=1.0)
        with pytest.raises(
            ClusterError, match="127.0.0.1 cannot keep the scene: .*No space left.*RAYBATCH_PART_FOLDER"
        ):
            ClusterSession(connection).render(scene, SETTINGS)
    finally:
        connection._client.run(make_room)


def make_full():
    from raybatch_addon.core.cluster import store

    def full(self, size):
        raise OSError(28, "No space left on device")

    store.PartStore._kept, store.PartStore._make_room = store.PartStore._make_room, full


def make_room():
    from raybatch_addon.core.cluster import store

    store.PartStore._make_room = store.PartStore._kept


def test_a_clock_ends_no_render_of_a_cluster(connection):
    with pytest.raises(SettingsError, match="time_limit ends a render by the clock of one process"):
        render(connection, settings=SETTINGS.replace(time_limit=3.0))


def test_no_scheduler_is_an_error():
    with pytest.raises(ClusterError, match="there is no scheduler at tcp://127.0.0.1:9"):
        Connection("tcp://127.0.0.1:9", seconds=0.5)


def test_no_dask_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"Dask is not installed .*raybatch-\*\.whl\)\[cluster\]\""):
        Connection("tcp://127.0.0.1:9")


@contextlib.contextmanager
def program(name, *arguments, **environment):
    """A program of Dask's, which is killed at the end."""
    command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments]
    with subprocess.Popen(
        command, env={**os.environ, **environment}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_scheduler_that_is_killed_and_comes_back(expected, long_tasks, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, path, notes = f"tcp://127.0.0.1:{port}", tmp_path / "film.checkpoint", []
    named = "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"
    working = address, "--nthreads", "2", "--resources", "raybatch=1", "--no-dashboard", "--no-nanny"
    environment = {"RAYBATCH_DEVICE": DEVICE, "RAYBATCH_PART_FOLDER": str(tmp_path / "parts")}
    with (
        contextlib.ExitStack() as second,
        program("scheduler", *named) as scheduler,
        program("worker", *working, **environment),
    ):
        connection = Connection(address, notes.append)

        def on_progress(_progress):
            if path.exists() and scheduler.poll() is None:
                scheduler.kill()
                scheduler.wait()
                second.enter_context(program("scheduler", *named))
                second.enter_context(program("worker", *working, **environment))

        film = render(connection, checkpoint=Checkpoint(path, 0.2), on_progress=on_progress)
        connection.close()
    assert_same_film(film, expected)
    assert [each for each in notes if "is lost; waiting for it to come back" in each]
    shares = film.statistics["cluster"]["shares"]
    assert [each["end"] for each in shares[:-1]] == [each["first"] for each in shares[1:]]
