"""A scheduler and workers that stand apart from this checkout: workers have the library as its wheel has it, `raybatch`
in place of `raybatch_addon.core`, and the scheduler has Dask alone.
"""

import contextlib
import json
import os
import subprocess
import sys

import pytest

pytest.importorskip("distributed")

from raybatch_addon.core.cluster.connection import Connection
from raybatch_addon.core.cluster.session import ClusterSession
from tests.core.cluster.clusters import SETTINGS, wait_for
from tests.support import scenes
from tests.support.command_line import ROOT
from tests.support.under_test import DEVICE
from tests.support.watched_renders import FRAME, assert_same_film

# By what names a process has the library
LOADED = "{each.split('.')[0] for each in __import__('sys').modules if each.startswith('raybatch')}"

pytestmark = pytest.mark.usefixtures("general_kernels")


@contextlib.contextmanager
def program(name, *arguments, folder, paths, **environment):
    """A program of Dask's in `folder`, which finds what is in `paths` besides; it is killed at the end."""
    command = [sys.executable, "-P", "-m", f"distributed.cli.dask_{name}", *arguments]
    own = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(command, env=own, cwd=folder, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    """The address of a scheduler that cannot import NumPy, with a worker that has `raybatch`."""
    folder = tmp_path_factory.mktemp("apart")
    library, nothing = folder / "library", folder / "nothing"
    for each in (library, nothing):
        each.mkdir()
    (library / "raybatch").symlink_to(ROOT / "raybatch_addon/core")
    for name in ("numpy", "warp"):
        (nothing / f"{name}.py").write_text(f"raise ImportError('{name} is not installed')\n")
    found = folder / "scheduler.json"
    scheduling = "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(found)
    working = "--scheduler-file", str(found), "--nthreads", "2", "--resources", "raybatch=1", "--no-dashboard"
    environment = {"RAYBATCH_DEVICE": DEVICE, "RAYBATCH_PART_FOLDER": str(folder / "parts")}
    with (
        program("scheduler", *scheduling, folder=folder, paths=[nothing]),
        program("worker", *working, "--no-nanny", folder=folder, paths=[library], **environment),
    ):
        wait_for(lambda: found.exists() and found.read_text().endswith("}"))
        yield json.loads(found.read_text())["address"]


@pytest.fixture
def connection(apart):
    made = Connection(apart)
    wait_for(made.workers)
    yield made
    made.close()


def test_the_film_is_that_of_one_process(connection, expected):
    film = ClusterSession(connection).render(scenes.mixed(FRAME), SETTINGS)
    assert_same_film(film, expected)
    (loaded,) = connection._client.run(eval, LOADED).values()
    assert loaded == {"raybatch"}
    assert connection._client.run_on_scheduler(eval, LOADED) == set()


def test_what_the_scheduler_is_asked(connection):
    future = connection._client.submit(open, "/", pure=False)
    assert future.exception()  # waits for it
    assert connection.failed_on(future) == "127.0.0.1"
