"""What render.py says of clusters before it renders on one: nothing is started for what would be refused."""

import json
import socket

import pytest
import render

pytest.importorskip("distributed")

from raybatch_addon.core.cluster import connection, local
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.cluster.clusters import two_workers
from tests.support import scenes
from tests.support.scripts_here import call_script


@pytest.fixture
def saved(tmp_path):
    """Makes a saved scene with some settings, and returns its path."""

    def save(**settings):
        path = tmp_path / "scene.scene.npz"
        scene = scenes.mixed(scenes.Frame(6, 4))
        save_scene(path, scene, RenderSettings(sample_count=2, bounce_max=5, **settings))
        return str(path)

    return save


@pytest.fixture
def started(monkeypatch):
    """What was started or waited for, each of which ends at once."""
    found = []

    def start(count, kernel_cache=None):
        found.append(count)
        raise connection.ClusterError("nothing starts here")

    monkeypatch.setattr(local, "local_cluster", start)
    return found


def said(*arguments):
    """What render.py writes to standard error, in lines, where it fails."""
    done = call_script("render.py", *arguments)
    assert done.returncode == 1
    return done.stderr.splitlines()


@pytest.mark.parametrize(
    "given, name, variable",
    [
        (["--device", "cpu"], "device", "RAYBATCH_DEVICE"),
        (["--device", ""], "device", "RAYBATCH_DEVICE"),
        (["--set", "device=cuda:0"], "device", "RAYBATCH_DEVICE"),
        (["--set", "thread_count=2"], "thread_count", "RAYBATCH_THREADS"),
    ],
)
def test_what_workers_have_of_their_own_is_refused(saved, started, tmp_path, given, name, variable):
    (line,) = said(saved(), "-o", tmp_path / "x.png", "--cluster", "local:2", *given)
    assert f"{name} is given, but workers of a cluster have their own" in line and f"{variable}=VALUE" in line
    assert not started


@pytest.mark.parametrize("own, given", [({}, ["--set", "time_limit=3"]), ({"time_limit": 3.0}, [])])
def test_settings_are_looked_at_before_a_cluster_starts(saved, started, tmp_path, own, given):
    (line,) = said(saved(**own), "-o", tmp_path / "x.png", "--cluster", "local:2", *given)
    assert "time_limit ends a render by the clock of one process" in line
    assert not started


def test_settings_of_a_blend_are_looked_at_before_a_cluster_starts(started, tmp_path):
    bpy = pytest.importorskip("bpy")
    path = tmp_path / "scene.blend"
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    arguments = path, "-o", tmp_path / "x.png", "--cluster", "local:2"
    (line,) = said(*arguments, "--set", "time_limit=3")
    assert "time_limit ends a render by the clock of one process" in line
    assert not started
    assert said(*arguments) == ["render.py: starting 2 workers", "render.py: error: nothing starts here"]
    assert started == [2]


@pytest.mark.parametrize("count, text", [(1, "starting 1 worker"), (3, "starting 3 workers")])
def test_a_local_cluster_is_said_when_it_starts(saved, started, tmp_path, count, text):
    lines = said(saved(), "-o", tmp_path / "x.png", "--cluster", f"local:{count}")
    assert lines == [f"render.py: {text}", "render.py: error: nothing starts here"]


def test_a_scheduler_is_said_while_it_is_waited_for(capsys, saved, tmp_path, monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    looked = []

    def connect(self):
        looked.append(capsys.readouterr().err)  # before anything is waited for
        raise connection.ClusterError("nobody is there")

    monkeypatch.setattr(connection.Connection, "_connect", connect)
    assert render.main([saved(), "-o", str(tmp_path / "x.png"), "--cluster", address]) == 1
    assert looked == [f"render.py: waiting for the scheduler at {address}\n"]
    assert capsys.readouterr().err == "render.py: error: nobody is there\n"


@pytest.mark.usefixtures("general_kernels")
def test_a_render_on_a_cluster_names_no_dashboard_that_there_is_not(capsys, saved, tmp_path):
    report = tmp_path / "report.json"
    with two_workers(tmp_path / "parts") as address:
        path = saved(device="cpu", thread_count=1)  # of the machine that saved it
        assert render.main([path, "--json", str(report), "--cluster", address]) == 0
        assert "dashboard" not in capsys.readouterr().err
    assert json.loads(report.read_text())["cluster"]["shares"]
