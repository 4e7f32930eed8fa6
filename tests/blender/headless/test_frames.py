"""Many frames by one call of render.py: each as alone, files that cannot be written, and a stop between two frames."""

import json
import os
import re
import tempfile
import threading
import weakref

import numpy as np
import pytest
from PIL import Image

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame
from tests.support.blender_builders import add_moving_grids, saved_for_cpu
from tests.support.scripts_here import call_script


@pytest.fixture
def blend(scene, tmp_path):
    """A grid that waves, and one that moves from frame to frame."""
    add_moving_grids()
    return saved_for_cpu(scene, tmp_path)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_frames_are_those_that_are_rendered_alone(blend, tmp_path):
    many, alone = tmp_path / "many", tmp_path / "alone"
    files = ["-o", "p.png", "--film", "f####.npz", "--heat-map", "Rays=h##.png"]

    def arguments(folder):
        return [text.replace("=", f"={folder}/") if "=" in text else str(folder / text) for text in files[1::2]]

    def call(folder, *which):
        pairs = [part for pair in zip(files[::2], arguments(folder), strict=True) for part in pair]
        done = call_script("render.py", blend, *which, *pairs)
        assert done.returncode == 0, done.stderr

    call(many, "--frames", "1..3")
    expected = [f"{stem}{end}" for stem, end in (("f000", ".npz"), ("h0", ".png"), ("p000", ".png"))]
    assert names(many) == [f"{each[:-4]}{n}{each[-4:]}" for each in expected for n in (1, 2, 3)]
    films = set()
    for n in (1, 2, 3):
        call(alone, "--frame", n)
        with np.load(many / f"f000{n}.npz") as a, np.load(alone / f"f000{n}.npz") as b:
            assert a["Combined"].tobytes() == b["Combined"].tobytes()
            films.add(a["Combined"].tobytes())
        assert (np.array(Image.open(many / f"p000{n}.png")) == np.array(Image.open(alone / "p.png"))).all()
        assert (np.array(Image.open(many / f"h0{n}.png")) == np.array(Image.open(alone / f"h0{n}.png"))).all()
    assert len(films) == 3


def test_frames_are_one_animation_that_blender_evaluates_once_a_frame(blend, tmp_path):
    seen = []

    def listen(scene, depsgraph):
        seen.append((scene.frame_current, depsgraph.mode))

    bpy.app.handlers.frame_change_post.append(bpy.app.handlers.persistent(listen))
    try:
        done = call_script("render.py", blend, "--frames", "2..4", "-o", tmp_path / "p.png")
    finally:
        bpy.app.handlers.frame_change_post.remove(listen)
    assert done.returncode == 0, done.stderr
    assert [each for each in seen if each[1] == "RENDER"] == [(n, "RENDER") for n in (2, 3, 4)]
    assert len(seen) <= 4, "the view of a window that is not there is evaluated at the end alone"


def test_lines_of_progress_name_their_frame(blend, tmp_path, monkeypatch):
    """As those of a Blender without a window, for farm managers."""
    monkeypatch.setattr("rendering.progress.PLAIN_SECONDS", 0.0)
    done = call_script("render.py", blend, "--frames", "2..3", "--film", tmp_path / "out" / "f.npz")
    assert done.returncode == 0, done.stderr
    found = re.findall(r"^Fra: (\d+) \| Sample \d+/\d+ \| ", done.stderr, re.MULTILINE)
    assert sorted(set(found)) == ["2", "3"], done.stderr


def test_frames_without_a_picture_leave_films_alone(blend, tmp_path):
    out = tmp_path / "out"
    done = call_script("render.py", blend, "--frames", "1..2", "--film", out / "f.npz")
    assert done.returncode == 0 and names(out) == ["f0001.npz", "f0002.npz"]
    assert [line.partition("out/")[2] for line in done.stderr.splitlines() if "saved" in line] == [
        "f0001.npz (the film)",
        "f0002.npz (the film)",
    ]


def test_frames_before_the_first_of_blenders_animations(blend, tmp_path):
    out = tmp_path / "out"
    done = call_script("render.py", blend, "--frames=-2..0", "-o", out / "p.png")
    assert done.returncode == 0, done.stderr
    assert names(out) == ["p-001.png", "p-002.png", "p0000.png"]


def test_pictures_that_nobody_wants_go_after_each_frame(blend, tmp_path, monkeypatch):
    there = []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: there.append(len([*tmp_path.glob(".raybatch-*/*")]))])
    done = call_script("render.py", blend, "--frames", "1..4", "--film", tmp_path / "out" / "f.npz")
    assert done.returncode == 0, done.stderr
    assert len(there) == 4 and max(there) <= 1


@pytest.mark.parametrize("resumed", [False, True])
def test_the_thread_that_writes_holds_no_film(blend, tmp_path, resumed):
    """A film keeps its sums on the device: they are asked for before the next frame begins, and by no other thread."""
    from raybatch_addon.core.film import Film

    out, films, alive, threads = tmp_path / "out", [], [], []
    writing = threading.Event()
    fetched, written = Film.fetched, deliveries_module().write_film

    def listen(_layer, _scene, film):
        films.append(weakref.ref(film))

    def write(path, arrays):
        writing.wait(20)
        assert all(type(each) is np.ndarray for each in arrays.values())
        written(path, arrays)

    def begin(_job):
        alive.append(sum(each() is not None for each in films))
        if len(alive) == 3:
            writing.set()

    def fetch(film):
        threads.append(threading.current_thread())
        return fetched(film)

    arguments = [blend, "--frames", "1..3", "--film", out / "f.npz"]
    arguments += ["--checkpoint", tmp_path / "kept" / "c"] * resumed
    if resumed:
        assert call_script("render.py", *arguments, "--set", "sample_count=2").returncode == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Film, "fetched", fetch)
        patch.setattr(deliveries_module(), "write_film", write)
        patch.setattr(frame, "begin_frame", begin)
        patch.setattr(frame, "film_listeners", [listen])
        done = call_script("render.py", *arguments, "--set", "sample_count=3")
    assert done.returncode == 0, done.stderr
    assert alive == [0, 0, 0]
    assert {*threads} <= {threading.main_thread()} and bool(threads) >= resumed


def deliveries_module():
    from rendering import deliveries

    return deliveries


@pytest.mark.parametrize("failing", ["write_film", "film_arrays", "AskedCheckpoint"])
def test_an_error_of_any_kind_ends_the_frames(blend, tmp_path, monkeypatch, failing):
    """Blender prints what its handlers raise, and would go on."""
    deliveries = deliveries_module()

    def fail(*_):
        raise MemoryError("no memory is left")

    monkeypatch.setattr(deliveries, failing, fail)
    rendered = []
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: rendered.append(1)])
    with pytest.raises(MemoryError, match="no memory is left"):
        call_script("render.py", blend, "--frames", "1..9", "--film", tmp_path / "out" / "f.npz")
    assert (failing != "AskedCheckpoint") <= len(rendered) < 9


def test_frames_that_blender_leaves_out_are_an_error(blend, tmp_path, monkeypatch):
    deliveries = deliveries_module()
    monkeypatch.setattr(deliveries.FrameDeliveries, "are_complete", False)
    done = call_script("render.py", blend, "--frames", "1..2", "-o", tmp_path / "out" / "p.png")
    assert done.returncode == 1
    assert "Blender ended the render before all of its 2 frames were written" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("option", ["--film", "--heat-map"])
def test_a_file_that_cannot_be_written_later_is_named_and_ends_the_frames(blend, tmp_path, monkeypatch, option):
    """The thread that writes fails: what was rendered until that is noticed is there, and no other frame is begun."""
    from rendering import deliveries

    rendered = []

    def fail_at_two(function):
        def write(path, *rest):
            if "2" in path.name:
                raise deliveries.RayBatchError(f"{path} cannot be written: No space left on device")
            function(path, *rest)

        return write

    monkeypatch.setattr(deliveries, "write_film", fail_at_two(deliveries.write_film))
    monkeypatch.setattr(deliveries, "write_heat_map", fail_at_two(deliveries.write_heat_map))
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: rendered.append(1)])
    out = tmp_path / "out"
    value = out / "f.npz" if option == "--film" else f"Rays={out / 'h.png'}"
    pictures, report = tmp_path / "pictures" / "p.png", tmp_path / "r.json"
    done = call_script("render.py", blend, "--frames", "1..9", option, value, "-o", pictures, "--json", report)
    ending = "f0002.npz" if option == "--film" else "h0002.png"
    assert done.returncode == 1
    assert (
        done.stderr.splitlines()[-1] == f"render.py: error: {out / ending} cannot be written: No space left on device"
    )
    finished = range(1, len(rendered) + 1)
    assert 2 <= len(finished) < 9
    assert names(out) == [ending.replace("2", str(n)) for n in finished if n != 2]
    assert names(tmp_path / "pictures") == [f"p000{n}.png" for n in finished]
    assert len(json.loads(report.read_text())) == len(finished)


def test_a_picture_that_cannot_be_moved_to_its_place_ends_the_frames(blend, tmp_path, monkeypatch):
    from rendering import workshop

    def replace(source, target):
        if target.name == "p0002.png":
            raise PermissionError(13, "Permission denied", str(target))
        os.rename(source, target)

    monkeypatch.setattr(workshop.os, "replace", replace)
    out = tmp_path / "out"
    done = call_script("render.py", blend, "--frames", "1..4", "-o", out / "p.png")
    assert done.returncode == 1
    assert "frame 2: " in done.stderr.splitlines()[-1] and "p0002.png" in done.stderr.splitlines()[-1]
    assert names(out) == ["p0001.png"]


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp"])
@pytest.mark.parametrize("is_empty", [True, False])
def test_a_picture_that_blender_wrote_in_part_is_an_error(blend, tmp_path, monkeypatch, ending, is_empty):
    """Blender says nothing of it where the disk is full."""
    from rendering import workshop

    def deliver(self, place, name=""):
        if place.name.startswith("p0002"):
            file = next(self.folder.iterdir())
            os.truncate(file, 0 if is_empty else file.stat().st_size - 4)
            if ending == ".bmp":
                monkeypatch.setattr(workshop, "_PROBE_BYTES", -1)
        whole(self, place, name)

    whole = workshop.Workshop.deliver
    monkeypatch.setattr(workshop.Workshop, "deliver", deliver)
    monkeypatch.setattr(workshop.tempfile, "TemporaryFile", full_from(workshop))
    out = tmp_path / "out"
    done = call_script("render.py", blend, "--frames", "1..3", "-o", out / f"p{ending}")
    assert done.returncode == 1
    line = done.stderr.splitlines()[-1]
    assert f"p0002{ending} was not written whole; is the disk full?" in line
    assert names(out) == [f"p0001{ending}"]


def full_from(workshop):
    """`TemporaryFile` of a disk that is full once `_PROBE_BYTES` is negative."""
    real = workshop.tempfile.TemporaryFile

    def temporary_file(**options):
        if workshop._PROBE_BYTES < 0:
            raise OSError(28, "No space left on device")
        return real(**options)

    return temporary_file


def test_the_error_of_a_frame_names_it(blend, tmp_path):
    bpy.context.scene.camera.data.type = "PERSP"
    camera = bpy.context.scene.camera
    for number, scale in ((1, 1.0), (2, 0.0)):
        camera.scale = (scale,) * 3
        camera.keyframe_insert("scale", frame=number)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    out = tmp_path / "out"
    done = call_script("render.py", blend, "--frames", "1..3", "-o", out / "p.png")
    assert done.returncode == 1 and "error: frame 2: " in done.stderr and names(out) == ["p0001.png"]


@pytest.mark.parametrize("films", [False, True])
def test_a_stop_between_two_frames_keeps_what_is_finished(blend, tmp_path, monkeypatch, films):
    """It comes while the third frame is read: nothing of that is written, and nothing half written is left."""
    from rendering.stops import StopRequests

    begun = []
    monkeypatch.setattr(StopRequests, "asked", lambda _: len(begun) == 3)
    monkeypatch.setattr(frame, "begin_frame", lambda _job: begun.append(1))
    out, report = tmp_path / "out", tmp_path / "r.json"
    more = ["--film", out / "f.npz"] if films else []
    done = call_script("render.py", blend, "--frames", "1..5", "-o", out / "p.png", "--json", report, *more)
    assert done.returncode == 130 and done.stderr.endswith("render.py: stopped\n")
    assert "stopped in frame 3: those before it are written, and --frames 3..5 goes on" in done.stderr
    assert names(out) == ["f0001.npz", "f0002.npz"] * films + ["p0001.png", "p0002.png"]
    assert [each["frame"]["number"] for each in json.loads(report.read_text())] == [1, 2]
    assert len(begun) == 3


def test_a_stop_of_a_single_picture_writes_none_and_is_no_error(blend, tmp_path, monkeypatch):
    from rendering.stops import StopRequests

    begun = []
    monkeypatch.setattr(StopRequests, "asked", lambda _: bool(begun))
    monkeypatch.setattr(frame, "begin_frame", lambda _job: begun.append(1))
    out = tmp_path / "out"
    done = call_script("render.py", blend, "-o", out / "p.png", "--set", "sample_count=64")
    assert done.returncode == 130 and done.stderr.endswith("render.py: stopped\n") and "error" not in done.stderr
    assert begun and not out.exists()


def test_a_scene_without_a_camera_is_told_what_it_lacks(blend, tmp_path):
    bpy.data.objects.remove(bpy.context.scene.camera)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    done = call_script("render.py", blend, "-o", tmp_path / "p.png")
    assert done.returncode == 1 and "has no camera; add one" in done.stderr


def test_a_stop_while_the_last_frame_ends_is_no_stop(blend, tmp_path, monkeypatch):
    from rendering.stops import StopRequests

    done_frames = []
    monkeypatch.setattr(StopRequests, "asked", lambda _: len(done_frames) > 1)
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: done_frames.append(1)])
    done = call_script("render.py", blend, "--frames", "1..2", "-o", tmp_path / "out" / "p.png")
    assert done.returncode == 0, done.stderr
    assert names(tmp_path / "out") == ["p0001.png", "p0002.png"]


def test_names_that_may_not_be_meant_are_noted(blend, tmp_path):
    (tmp_path / "frames").mkdir()
    for out, said in (("frames", "frames is a folder, and pictures get its name"), ("x.xyz", ".xyz is no picture's")):
        done = call_script("render.py", blend, "-o", tmp_path / out)
        assert done.returncode == 0 and said in done.stderr
    assert {"frames0001.png", "x.xyz0001.png"} <= set(names(tmp_path))
