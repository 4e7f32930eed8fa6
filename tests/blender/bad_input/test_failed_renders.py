"""Devices, memory, faults and cancels: a render that cannot go on says why, and spoils nothing."""

import os
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import reports, sessions
from raybatch_addon.blender.status import terminal
from raybatch_addon.blender.status.terminal import PlainLines
from raybatch_addon.core import session as core_session
from raybatch_addon.core.ahead import change, prepare
from raybatch_addon.core.device.compiler import CompileStoppedError
from raybatch_addon.core.measure.parts import PARTS
from raybatch_addon.core.shading.images.image_upload import ImageCache
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import workers
from raybatch_addon.core.wavefront.render.workers import WorkersFor
from raybatch_addon.core.wavefront.scene import device_scene
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from raybatch_addon.core.wavefront.tier import choose_tier
from tests.blender.bad_input.outcomes import BACKGROUND, assert_fails, assert_picture, render
from tests.support.blender_watch import watch_engines

ROOT = Path(__file__).resolve().parents[3]


# --- devices and memory


@pytest.mark.parametrize("name", ["cuda:99", "gpu", "cpu:7", "metal"])
def test_an_unknown_device(lit, tmp_path, name):
    lit.raybatch.device = name
    assert_fails(tmp_path, repr(name), "choose one of AUTO, cpu")


def test_cuda_where_there_is_none(lit, tmp_path, monkeypatch):
    import warp

    monkeypatch.setattr(warp, "get_cuda_devices", list)
    lit.raybatch.device = "cuda:0"
    sessions.close_all()
    assert_fails(tmp_path, "'cuda:0'", "AUTO, cpu", "no CUDA device was found", "driver")


def test_the_ray_count_is_reduced_when_memory_is_short(lit, films, monkeypatch):
    lit.raybatch.sample_count = 64
    render()
    sessions.close_all()  # what is made for a scene serves its next render too
    monkeypatch.setattr(workers, "free_memory", lambda device: 4 << 20)
    (warning,) = render()
    assert "ray_count was reduced from" in warning and "memory" in warning
    assert films[1].statistics["warnings"] == [warning]
    assert_picture(films[1])
    assert np.array_equal(films[0].passes["Combined"], films[1].passes["Combined"]), (
        "the schedule never changes the image"
    )


def test_no_memory_at_all(lit, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "free_memory", lambda device: 100)
    assert_fails(tmp_path, "bytes left for rays", "close other programs")


# --- exceptions inside


def fail(*_args, **_options):
    raise ZeroDivisionError("a bug")


PLACES = {
    "build": (device_scene.DeviceScene, "build"),
    "compile": (prepare, "load_kernels"),
    "worker": (integrator.TileIntegrator, "_shade"),
    "film": (integrator, "FinishedTile"),
    "result": (None, "begin_result"),
    "status": (None, "update_stats"),
}


@pytest.mark.parametrize("file_format", ["PNG", "OPEN_EXR_MULTILAYER"])
@pytest.mark.parametrize("place", PLACES)
def test_an_exception_writes_nothing_over_what_is_there(lit, monkeypatch, tmp_path, capfd, place, file_format):
    image = lit.render.image_settings
    if hasattr(image, "media_type"):  # from 5.0 on
        image.media_type = "MULTI_LAYER_IMAGE" if file_format == "OPEN_EXR_MULTILAYER" else "IMAGE"
    image.file_format = file_format
    path = tmp_path / ("kept" + lit.render.file_extension)
    path.write_bytes(b"what was there")
    lit.render.filepath = str(path)
    sessions.close_all()  # nothing of the scene is there yet
    monkeypatch.setattr(PlainLines, "is_due", True)  # whatever was printed just before
    owner, name = PLACES[place]
    if owner is None:
        watch_engines(monkeypatch, **{name: fail})
    else:
        monkeypatch.setattr(owner, name, fail)
    with pytest.raises(RuntimeError, match="RayBatch: .*ZeroDivisionError: a bug"):
        bpy.ops.render.render(write_still=True)
    monkeypatch.undo()
    assert path.read_bytes() == b"what was there" and os.listdir(tmp_path) == [path.name]
    assert len(reports.last().errors) == 1
    assert "Traceback" in capfd.readouterr().err
    assert [thread for thread in threading.enumerate() if "work" in thread.name] == [], "no worker goes on"
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}, "the next render is as good as ever"
    assert path.read_bytes() != b"what was there"


SCRIPT = """
    import sys
    import bpy
    import raybatch_addon
    from raybatch_addon.core.wavefront import integrator

    def fail(*_):
        raise ZeroDivisionError("a bug")

    raybatch_addon.register()
    integrator.TileIntegrator._shade = fail
    scene = bpy.context.scene
    scene.render.engine, scene.raybatch.device = "RAYBATCH", "cpu"
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.render.filepath = sys.argv[1]
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    try:
        bpy.ops.render.render(animation=True)
    except RuntimeError as error:
        print("caught", error)
        sys.exit(3)
"""


def test_a_process_whose_render_fails_ends_by_its_own_will(tmp_path):
    """Blender itself crashes with multilayer EXR after an exception."""
    command = [sys.executable, "-c", textwrap.dedent(SCRIPT), str(tmp_path / "frame")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 3, (done.returncode, done.stderr)
    assert "caught Error: RayBatch: the render failed: ZeroDivisionError: a bug" in done.stdout
    assert os.listdir(tmp_path) == []


# --- cancelling


WAITING = PARTS["wait"]
# What may take long before the first ray
LONG = {
    "kernels": (prepare, "load_kernels"),
    "displacement": (SceneCache, "displaced"),
    "images": (ImageCache, "upload"),
    "tree": (SceneCache, "get"),
    "materials": (device_scene, "upload_materials"),
    "lights": (device_scene, "upload_lights"),
    "volumes": (device_scene, "upload_volumes"),
}


def displace_and_fill(ball: bpy.types.Object) -> None:
    """Give `ball` a displacement and a volume."""
    material = bpy.data.materials.new("Raised fog")
    material.use_nodes, material.displacement_method = True, "DISPLACEMENT"
    tree = material.node_tree
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    for kind, socket in (("ShaderNodeDisplacement", "Displacement"), ("ShaderNodeVolumeAbsorption", "Volume")):
        tree.links.new(tree.nodes.new(kind).outputs[0], output.inputs[socket])
    ball.data.materials.clear()
    ball.data.materials.append(material)


@pytest.mark.usefixtures("general_kernels")
@pytest.mark.parametrize("stage", LONG)
def test_a_cancel_does_not_wait_for_what_takes_long(lit, monkeypatch, films, stage):
    """Work that is under way goes on by itself; the render does not wait for it, and the next one begins behind it."""
    displace_and_fill(next(each for each in lit.objects if each.type == "MESH"))
    sessions.close_all()  # nothing of the scene is there yet
    entered, release, finished = threading.Event(), threading.Event(), threading.Event()
    owner, name = LONG[stage]
    whole = getattr(owner, name)

    def endless(*arguments, **options):
        entered.set()
        release.wait(30)
        finished.set()
        return whole(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, endless)
        watch_engines(patch, test_break=lambda _engine: entered.is_set())
        bpy.ops.render.render()
        assert entered.is_set() and not finished.is_set()
        release.set()
    assert not films[0].complete and films[0].sample_count == 0
    assert reports.last().errors == []
    bpy.ops.render.render()
    assert finished.is_set() and films[1].complete


@pytest.mark.usefixtures("general_kernels")
def test_a_cancel_while_a_cancelled_render_is_waited_for(lit, monkeypatch, films):
    """The second render waits for the tree of the first, and is cancelled too: neither waits any longer."""
    sessions.close_all()
    entered, release, finished, parts = threading.Event(), threading.Event(), threading.Event(), []
    whole = SceneCache.get

    def endless(*arguments, **options):
        entered.set()
        release.wait(30)
        found = whole(*arguments, **options)
        finished.set()
        return found

    with monkeypatch.context() as patch:
        patch.setattr(SceneCache, "get", endless)
        with monkeypatch.context() as first:
            watch_engines(first, test_break=lambda _engine: entered.is_set())
            bpy.ops.render.render()
        assert entered.is_set() and not finished.is_set()
        waited = threading.Event()
        patch.setattr(terminal, "PLAIN_SECONDS", 0.0)
        watch_engines(
            patch,
            test_break=lambda _engine: waited.is_set(),
            update_stats=lambda _engine, _layer, text: waited.set() if WAITING in text else parts.append(text),
        )
        bpy.ops.render.render()
        assert waited.is_set(), parts
        assert not finished.is_set()
        release.set()
    assert [film.complete for film in films] == [False, False] and reports.last().errors == []
    bpy.ops.render.render()
    assert finished.is_set() and films[2].complete


@pytest.mark.usefixtures("general_kernels")
def test_a_cancel_while_room_for_paths_is_made(lit, monkeypatch, films):
    entered, whole = threading.Event(), WorkersFor.get

    def get(*arguments):
        entered.set()
        return whole(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(WorkersFor, "get", get)
        watch_engines(patch, test_break=lambda _engine: entered.is_set())
        bpy.ops.render.render()
    assert entered.is_set() and not films[0].complete and films[0].sample_count == 0
    assert reports.last().errors == []
    bpy.ops.render.render()
    assert films[1].complete


def test_a_cancel_while_other_kernels_take_over(lit, monkeypatch, films):
    """What loads them is told, and the render waits for no more of them."""
    lit.raybatch.sample_count = 2**20
    entered, told = threading.Event(), threading.Event()

    def load_kernels(_kernels, _device, _on_module, given_up):
        entered.set()
        for _ in range(30_000):
            if given_up():
                told.set()
                raise CompileStoppedError
            time.sleep(0.001)

    def choose(features, setting, device):
        return replace(choose_tier(features, "GENERAL", device), asked=setting)

    with monkeypatch.context() as patch:
        patch.setattr(core_session, "choose_tier", choose)
        patch.setattr(change.TierChanges, "poll", lambda *_: change.Polled(True))
        patch.setattr(change, "load_kernels", load_kernels)
        watch_engines(patch, test_break=lambda _engine: entered.is_set())
        bpy.ops.render.render()
    assert told.is_set() and not films[0].complete and films[0].counts.max() > 0
    assert reports.last().errors == reports.last().warnings == []
    assert films[0].statistics["kernels"]["specialised_after"] is None
    lit.raybatch.sample_count = 2
    bpy.ops.render.render()
    assert films[1].complete


def test_a_cancel_during_export_renders_nothing(lit, monkeypatch, films):
    watch_engines(monkeypatch, test_break=lambda _engine: True)
    bpy.ops.render.render()
    assert films == [] and reports.last().errors == []


def test_a_cancel_keeps_what_is_done_of_a_tile(lit, monkeypatch, films):
    """One tile of more samples than could ever be traced: it keeps the samples that are done."""
    lit.raybatch.sample_count, lit.raybatch.tile_size, lit.raybatch.thread_count = 2**30, 64, 1
    written, started = [], []
    finish_paths = integrator.TileIntegrator._finish_paths

    def begin_result(engine, x, y, width, height, **options):
        written.append((x, y, width, height))
        return engine.begin_result(x, y, width, height, **options)

    def noted(*args):
        started.append(1)
        return finish_paths(*args)

    monkeypatch.setattr(integrator.TileIntegrator, "_finish_paths", noted)
    watch_engines(monkeypatch, begin_result=begin_result, test_break=lambda _engine: len(started) > 0)
    bpy.ops.render.render()
    (film,) = films
    assert not film.complete and 0 < film.counts.max() < 2**30
    assert written == [(0, 0, 32, 24)], "what is done is shown"
    picture = film.passes["Combined"]
    assert picture[12, 16, :3] == pytest.approx([1, 1, 1]) and picture[0, 0, :3] == pytest.approx(BACKGROUND, rel=1e-5)


# Where the cancel of each part is tested, or why it is not
CANCELLED = {
    "export": test_a_cancel_during_export_renders_nothing,
    "start": "imports and the device's own start cannot be ended; the next part asks",
    "check": "nothing is made in it: the next part asks",
    "wait": test_a_cancel_while_a_cancelled_render_is_waited_for,
    "checkpoint": "files are read and written whole; tests/renders/checkpoints cancels before and behind that",
    **dict.fromkeys(LONG, test_a_cancel_does_not_wait_for_what_takes_long),
    "paths": test_a_cancel_while_room_for_paths_is_made,
    "render": test_a_cancel_keeps_what_is_done_of_a_tile,
    "report": "the render is over: there is nothing to leave out",
    "denoise": "tests/blender/denoising/test_denoising.py: test_a_cancel_ends_denoising_and_keeps_the_noisy_picture",
    "write": "the render is over: the picture is kept, whole",
}


def test_a_cancel_in_each_part_is_tested_or_has_a_reason():
    assert CANCELLED.keys() == PARTS.keys()
