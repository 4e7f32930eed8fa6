"""Frames of an animation on a cluster: each is as alone, and the next one is begun while the last is rendered."""

import numpy as np
import pytest
from PIL import Image

bpy = pytest.importorskip("bpy")
pytest.importorskip("distributed")

from raybatch_addon.blender import frame
from raybatch_addon.blender.cluster import frames_ahead
from raybatch_addon.core.cluster.session import ClusterSession, PendingFilm
from raybatch_addon.core.errors import SceneError
from tests.core.cluster.clusters import two_workers
from tests.support.blender_builders import add_grid, add_moving_grids, saved_for_cpu
from tests.support.scripts_here import call_script


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A scheduler with two workers on this machine."""
    with two_workers(tmp_path_factory.mktemp("parts")) as found:
        yield found


@pytest.fixture
def blend(scene, tmp_path):
    """What moves by keyframes, by time and by physics, which needs the frame before; and a camera that changes."""
    waves, _ = add_moving_grids()
    waves.modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    falling = add_grid("Falling", 1)
    falling.location = (0, 0.5, 1.0)
    bpy.context.view_layer.objects.active = falling
    bpy.ops.rigidbody.world_add()
    bpy.ops.rigidbody.object_add()
    falling.rigid_body.collision_shape = "BOX"
    second = scene.camera.copy()
    second.location.x += 0.3
    scene.collection.objects.link(second)
    for number, camera in ((1, scene.camera), (3, second)):
        scene.timeline_markers.new("Camera", frame=number).camera = camera
    return saved_for_cpu(scene, tmp_path)


@pytest.fixture
def steps(monkeypatch):
    """What was begun and taken, in order; frames are always begun ahead."""
    found, begin, film = [], ClusterSession.begin, PendingFilm.film

    def noted_begin(self, *arguments, **options):
        pending = begin(self, *arguments, **options)
        pending.number = sum(kind == "begun" for kind, _ in found) + 1
        found.append(("begun", pending.number))
        return pending

    def noted_film(self, **options):
        found.append(("taken", self.number))
        return film(self, **options)

    monkeypatch.setattr(ClusterSession, "begin", noted_begin)
    monkeypatch.setattr(PendingFilm, "film", noted_film)
    monkeypatch.setattr(frames_ahead, "is_worth_it", lambda: True)
    return found


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def assert_same_frames(folder, other, numbers):
    pictures = set()
    for n in numbers:
        with np.load(folder / f"f000{n}.npz") as a, np.load(other / f"f000{n}.npz") as b:
            assert a["Combined"].tobytes() == b["Combined"].tobytes(), n
            pictures.add(a["Combined"].tobytes())
        assert (np.array(Image.open(folder / f"p000{n}.png")) == np.array(Image.open(other / f"p000{n}.png"))).all()
    assert len(pictures) == len(numbers)


def rendered(folder, blend, *which):
    return call_script("render.py", blend, *which, "-o", folder / "p.png", "--film", folder / "f.npz")


@pytest.fixture
def alone(blend, tmp_path):
    """The folder of four frames that were rendered by one process."""
    done = rendered(tmp_path / "alone", blend, "--frames", "1..4")
    assert done.returncode == 0, done.stderr
    return tmp_path / "alone"


def test_the_next_frame_is_begun_before_the_last_one_is_there(blend, alone, address, tmp_path, steps):
    done = rendered(tmp_path / "many", blend, "--frames", "1..4", "--cluster", address)
    assert done.returncode == 0, done.stderr
    assert steps == [
        ("begun", 1), ("begun", 2), ("taken", 1), ("begun", 3), ("taken", 2), ("begun", 4), ("taken", 3), ("taken", 4)
    ]  # fmt: skip
    assert_same_frames(tmp_path / "many", alone, range(1, 5))


def test_frames_are_not_begun_ahead_where_stepping_takes_longer(blend, alone, address, tmp_path, steps, monkeypatch):
    monkeypatch.setattr(frames_ahead, "is_worth_it", lambda: False)
    done = rendered(tmp_path / "many", blend, "--frames", "1..4", "--cluster", address)
    assert done.returncode == 0, done.stderr
    assert [kind for kind, _ in steps] == ["begun", "taken"] * 4
    assert_same_frames(tmp_path / "many", alone, range(1, 5))


def test_motion_blur_and_several_view_layers(blend, address, tmp_path, steps):
    scene = bpy.context.scene
    scene.render.use_motion_blur = True
    scene.view_layers.new("Second")
    bpy.ops.wm.save_mainfile()
    for folder, *where in (("alone",), ("many", "--cluster", address)):
        done = rendered(tmp_path / folder, blend, "--frames", "1..3", *where)
        assert done.returncode == 0, done.stderr
    assert len(steps) == 12
    assert_same_frames(tmp_path / "many", tmp_path / "alone", range(1, 4))


def test_what_is_wrong_with_the_next_frame_is_said_when_it_is_its_turn(blend, alone, address, tmp_path, monkeypatch):
    export = frame.export_scene

    def failing(depsgraph, **options):
        if depsgraph.scene.frame_current == 3:
            raise SceneError("the camera is gone")
        return export(depsgraph, **options)

    monkeypatch.setattr(frame, "export_scene", failing)
    monkeypatch.setattr(frames_ahead, "is_worth_it", lambda: True)
    done = rendered(tmp_path / "many", blend, "--frames", "1..4", "--cluster", address)
    assert done.returncode == 1
    assert "frame 3: the camera is gone" in done.stderr.splitlines()[-1]
    assert_same_frames(tmp_path / "many", alone, range(1, 3))
    assert names(tmp_path / "many") == ["f0001.npz", "f0002.npz", "p0001.png", "p0002.png"]


def test_a_frame_that_is_refused_at_its_turn_takes_no_worker(blend, alone, address, tmp_path, monkeypatch, steps):
    """It was begun ahead, and what is refused is looked at when it is its turn."""
    pending, begin, refuse = [], ClusterSession.begin, frame.missing.refuse_what_lacks

    def kept_begin(self, *arguments, **options):
        pending.append(begin(self, *arguments, **options))
        return pending[-1]

    def refusing(scene, found):
        if scene.frame_current == 2:
            raise frame.missing.Refused("it lacks a light")
        refuse(scene, found)

    monkeypatch.setattr(ClusterSession, "begin", kept_begin)
    monkeypatch.setattr(frame.missing, "refuse_what_lacks", refusing)
    done = rendered(tmp_path / "many", blend, "--frames", "1..4", "--cluster", address)
    assert done.returncode != 0 and "it lacks a light" in done.stderr
    assert len(pending) == 2 and pending[1].is_taken
    assert_same_frames(tmp_path / "many", alone, range(1, 2))


def test_a_stop_leaves_frames_that_are_finished_and_ends_what_was_begun(
    blend, alone, address, tmp_path, monkeypatch, steps
):
    from rendering.stops import StopRequests

    out = tmp_path / "many"
    monkeypatch.setattr(StopRequests, "asked", lambda self: (out / "p0002.png").exists())
    done = rendered(out, blend, "--frames", "1..4", "--cluster", address)
    assert done.returncode == 130
    assert_same_frames(out, alone, range(1, 3))
    assert names(out) == ["f0001.npz", "f0002.npz", "p0001.png", "p0002.png"]
    assert not frames_ahead._ahead


def test_checkpoints_of_frames_that_are_begun_ahead(blend, alone, address, tmp_path, steps):
    out, kept = tmp_path / "many", tmp_path / "kept"
    arguments = "--frames", "1..4", "--checkpoint", kept / "c"
    assert call_script("render.py", blend, *arguments, "--set", "sample_count=1").returncode == 0
    done = rendered(out, blend, *arguments, "--cluster", address)
    assert done.returncode == 0, done.stderr
    assert len(steps) == 8 and done.stderr.count("1 of 2 samples are there") == 4
    assert_same_frames(out, alone, range(1, 5))
