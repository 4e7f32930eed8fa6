"""Bad input through the whole engine: what cannot be rendered is an error, what can be left out is named in a warning."""

import math
import os
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_builders import add_mesh, add_object, add_triangle, material_of, node_tree  # noqa: E402
from blender_watch import watch_engines  # noqa: E402

from raybatch_addon import frame, reports, sessions  # noqa: E402
from raybatch_addon.core import session as core_session  # noqa: E402
from raybatch_addon.core.wavefront import integrator, workers  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
BACKGROUND = (0.25, 0.5, 0.75)
NAN, INFINITY = math.nan, math.inf


@pytest.fixture
def lit(scene):
    """A triangle that emits white light in the middle of the frame, before a coloured world."""
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*BACKGROUND, 1)
    glow(add_triangle("Lamp"))
    lamp = bpy.data.objects["Lamp"]
    lamp.scale, lamp.location = (3, 3, 3), (-1, -1, 0)
    return scene


@pytest.fixture
def films():
    """The films of all renders."""
    got = []

    def listen(_layer, _scene, film):
        got.append(film)

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)


def glow(obj):
    """`obj`, emitting white light of radiance 1."""
    tree, surface = node_tree(material_of(obj))
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(emission.outputs[0], surface)
    return obj


def render():
    """Render what is expected to work; returns the warnings."""
    assert bpy.ops.render.render() == {"FINISHED"}
    assert reports.last().errors == []
    return reports.last().warnings


def assert_picture(film):
    """The lamp before the world, and nothing else that shows or is not finite."""
    picture = film.passes["Combined"]
    assert film.complete and film.statistics["invalid_samples"] == 0
    assert np.isfinite(picture).all()
    assert picture[12, 16, :3] == pytest.approx([1, 1, 1])
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert picture[corner][:3] == pytest.approx(BACKGROUND, rel=1e-5)


def assert_fails(tmp_path, *words):
    """A render to files ends as an error whose one line has all `words`, and leaves no file."""
    scene = bpy.context.scene
    scene.render.filepath = str(tmp_path / "never")
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.render.render(write_still=True)
    (line,) = reports.last().errors
    assert line in str(caught.value) and "\n" not in line
    assert all(word in line for word in words), line
    assert os.listdir(tmp_path) == []
    assert "Traceback" not in line and "Error:" not in line, "a sentence for the user, not the name of an exception"


# --- cameras


def test_no_camera(lit, tmp_path):
    """Blender refuses by itself, before it asks an engine."""
    lit.camera, lit.render.filepath = None, str(tmp_path / "never")
    with pytest.raises(RuntimeError, match="no camera"):
        bpy.ops.render.render(write_still=True)
    assert os.listdir(tmp_path) == []


def test_a_camera_that_is_lost_on_the_way(lit, tmp_path, monkeypatch):
    """What the engine itself says where Blender let a scene without camera pass."""
    original = frame.export_scene

    def export(depsgraph, **options):
        depsgraph.scene.camera = None
        return original(depsgraph, **options)

    monkeypatch.setattr(frame, "export_scene", export)
    assert_fails(tmp_path, "no camera", f"“{lit.name}”", "add one")


def test_something_else_as_the_camera(lit, tmp_path):
    lit.camera = add_object("Not a camera", None)
    assert_fails(tmp_path, "“Not a camera”", "make a camera the active one")


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0), (0, 1, 1)])
def test_a_camera_with_a_singular_matrix(lit, tmp_path, scale):
    lit.camera.scale = scale
    assert_fails(tmp_path, "“Camera”", "singular", "scale")


@pytest.mark.parametrize("what", ["location", "rotation_euler", "scale"])
def test_a_camera_with_a_matrix_that_is_not_finite(lit, tmp_path, what):
    setattr(lit.camera, what, (1, NAN, 1))
    assert_fails(tmp_path, "“Camera”", "not finite", "reset")


@pytest.mark.parametrize("location", [(0, INFINITY, 10), (0, 0, -INFINITY), (1e30, 0, 0)])
def test_a_camera_beyond_all_numbers(lit, tmp_path, location):
    """Blender turns an infinite location into the largest float32."""
    lit.camera.location = location
    assert_fails(tmp_path, "camera", "1e+18 m", "reset")


def test_a_camera_whose_parent_is_flat(lit, tmp_path):
    parent = add_object("Parent", None)
    parent.scale = (0, 0, 0)
    lit.camera.parent = parent
    assert_fails(tmp_path, "“Camera”", "parented to")


# --- objects


@pytest.mark.parametrize("what", ["location", "scale"])
@pytest.mark.parametrize("value", [NAN, INFINITY])
def test_an_object_with_a_matrix_that_is_not_finite(lit, films, what, value):
    bad = glow(add_triangle("Nowhere"))
    setattr(bad, what, (value, 1, 1))
    (warning,) = render()
    # Blender turns an infinite number into the largest float32
    assert "“Nowhere”" in warning and ("not finite" in warning or (value == INFINITY and "1e+18 m" in warning))
    assert_picture(films[0])
    assert films[0].statistics["warnings"] == [warning]


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0), (0, 3, 3)])
def test_an_object_scaled_to_nothing(lit, films, scale):
    glow(add_triangle("Flat")).scale = scale
    (warning,) = render()
    assert "“Flat”" in warning and "scale" in warning
    assert_picture(films[0])


@pytest.mark.parametrize("value", [NAN, INFINITY, -INFINITY])
def test_a_mesh_with_vertices_that_are_not_finite(lit, films, value):
    glow(add_mesh("Broken", [(0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, value)], [(0, 1, 2), (1, 2, 3)]))
    (warning,) = render()
    assert "“Broken”" in warning and "1 vertices" in warning and "NaN or infinite" in warning
    assert_picture(films[0])


def test_a_mesh_of_coordinates_whose_squares_are_not_finite(lit, films):
    glow(add_mesh("Vast", [(1e30, 0, 0), (0, 1e30, 0), (-1e30, 0, 5)], [(0, 1, 2)]))
    (warning,) = render()
    assert "“Vast”" in warning
    assert_picture(films[0])


def test_meshes_without_faces(lit, films):
    add_object("Nothing", bpy.data.meshes.new("Nothing"))
    add_mesh("Points", [(0, 0, 1), (1, 0, 1)], [])
    wire = bpy.data.meshes.new("Wire")
    wire.from_pydata([(0, 0, 1), (1, 0, 1)], [(0, 1)], [])
    add_object("Wire", wire)
    warnings = render()
    assert_picture(films[0])
    assert [any(f"“{name}”" in text for text in warnings) for name in ("Nothing", "Points", "Wire")] == [False, True, True]
    assert all("no faces" in text for text in warnings)


def test_faces_without_area(lit, films):
    """Points and lines as faces, in front of everything, smooth and flat: nothing is hit, nothing is invalid."""
    corners = [(0, 0, 1), (1, 0, 1), (2, 0, 1), (0, 0, 1)]
    for name in ("Smooth", "Flat"):
        obj = glow(add_mesh(name, corners, [(0, 1, 2), (0, 3, 1)]))
        obj.data.polygons.foreach_set("use_smooth", [name == "Smooth"] * 2)
    doubled = glow(add_mesh("Doubled", [(0.3, 0.3, 1)] * 3, [(0, 1, 2)]))
    doubled.location.x = -0.5
    assert render() == []
    assert_picture(films[0])


def test_a_scene_of_faces_without_area_alone(lit, films):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    add_mesh("Line", [(0, 0, 1), (1, 0, 1), (2, 0, 1)], [(0, 1, 2)])
    render()
    assert films[0].passes["Combined"][..., :3].reshape(-1, 3) == pytest.approx(np.tile(BACKGROUND, (32 * 24, 1)), rel=1e-5)


def test_a_million_loose_vertices(lit, films):
    bpy.data.objects["Lamp"].data.vertices.add(1_000_000)
    cloud = bpy.data.meshes.new("Cloud")
    cloud.vertices.add(1_000_000)
    add_object("Cloud", cloud)
    (warning,) = render()
    assert "“Cloud”" in warning and "no faces" in warning
    assert_picture(films[0])
    assert films[0].statistics["triangles"] == 1


def test_an_empty_scene_renders_the_world(lit, films):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    assert render() == []
    picture = films[0].passes["Combined"]
    assert picture.reshape(-1, 4) == pytest.approx(np.tile((*BACKGROUND, 1), (32 * 24, 1)), rel=1e-5)


# --- devices and memory


@pytest.mark.parametrize("name", ["cuda:99", "gpu", "cpu:7", "metal"])
def test_an_unknown_device(lit, tmp_path, name):
    lit.raybatch.device = name
    assert_fails(tmp_path, repr(name), "choose one of AUTO, cpu")


def test_cuda_where_there_is_none(lit, tmp_path, monkeypatch):
    import warp

    monkeypatch.setattr(warp, "get_cuda_devices", lambda: [])
    lit.raybatch.device = "cuda:0"
    sessions.close_all()
    assert_fails(tmp_path, "'cuda:0'", "AUTO, cpu", "no CUDA device was found", "driver")


def test_the_ray_count_is_reduced_when_memory_is_short(lit, films, monkeypatch):
    lit.raybatch.sample_count = 64
    render()
    monkeypatch.setattr(workers, "free_memory", lambda device: 4 << 20)
    (warning,) = render()
    assert "ray_count was reduced from" in warning and "memory" in warning
    assert films[1].statistics["warnings"] == [warning]
    assert_picture(films[1])
    assert np.array_equal(films[0].passes["Combined"], films[1].passes["Combined"]), "the schedule never changes the image"


def test_no_memory_at_all(lit, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "free_memory", lambda device: 100)
    assert_fails(tmp_path, "bytes left for rays", "close other programs")


# --- exceptions inside


def fail(*_args, **_options):
    raise ZeroDivisionError("a bug")


PLACES = {
    "build": (core_session.DeviceScene, "build"),
    "compile": (core_session, "load_kernels"),
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
    """Multilayer EXR after an exception is where Blender itself crashes."""
    command = [sys.executable, "-c", textwrap.dedent(SCRIPT), str(tmp_path / "frame")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 3, (done.returncode, done.stderr)
    assert "caught Error: RayBatch: the render failed: ZeroDivisionError: a bug" in done.stdout
    assert os.listdir(tmp_path) == []


# --- cancelling


@pytest.mark.parametrize("stage", ["load_kernels", "build"])
def test_a_cancel_does_not_wait_for_compiling_or_building(lit, monkeypatch, films, stage):
    """Whatever is under way goes on by itself; the render does not stay for it."""
    entered, release, finished = threading.Event(), threading.Event(), threading.Event()
    owner = core_session.DeviceScene if stage == "build" else core_session

    def endless(*_args):
        entered.set()
        release.wait(5)
        finished.set()

    monkeypatch.setattr(owner, stage, endless)
    watch_engines(monkeypatch, test_break=lambda _engine: entered.is_set())
    bpy.ops.render.render()
    assert entered.is_set() and not finished.is_set()
    release.set()
    assert not films[0].complete and films[0].sample_count == 0
    assert reports.last().errors == []


def test_a_cancel_during_export_renders_nothing(lit, monkeypatch, films):
    watch_engines(monkeypatch, test_break=lambda _engine: True)
    bpy.ops.render.render()
    assert films == [] and reports.last().errors == []


def test_a_cancel_keeps_what_is_done_of_a_tile(lit, monkeypatch, films):
    """One tile of more samples than could ever be traced: it comes as far as it came."""
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
