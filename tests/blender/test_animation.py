"""Frames, layers and rectangles of real renders: displayed results, data kept between frames, and its memory."""

import gc
import os
import warnings
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from bpy_extras.object_utils import world_to_camera_view

from raybatch_addon.blender import frame, reports, sessions
from raybatch_addon.core import session as core_session
from raybatch_addon.core.wavefront.render import steps
from tests.support.blender_builders import add_grid, add_mesh, add_object, add_triangle, material_of, node_tree
from tests.support.blender_watch import watch_engines

STATM = Path("/proc/self/statm")
# Bound of the growth of resident memory between frames 50 and 200 [bytes]: the allocator's own variation is 4 MiB, and
# a mesh or tree kept from every frame takes several times this
MEMORY_TOLERANCE = 12 * 2**20


@pytest.fixture
def lit(scene):
    """A glowing white square, slightly off the middle; black behind."""
    glow(add_mesh("Square", [(-1.2, -0.7, 0), (0.8, -0.7, 0), (0.8, 1.1, 0), (-1.2, 1.1, 0)], [(0, 1, 2, 3)]))
    image = scene.render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "32", "ZIP"
    return scene


@pytest.fixture
def films():
    """(view layer, frame, film) of all renders."""
    got = []

    def listen(layer, _scene, film):
        got.append((layer, reports.last().frame, film))

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)


@pytest.fixture
def rectangles(monkeypatch):
    """x, y, width, height of every result that is opened."""
    got = []

    def begin_result(engine, x, y, width, height, **options):
        got.append((x, y, width, height))
        return engine.begin_result(x, y, width, height, **options)

    watch_engines(monkeypatch, begin_result=begin_result)
    return got


def glow(obj):
    tree, surface = node_tree(material_of(obj))
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(emission.outputs[0], surface)
    return obj


def picture_of(path):
    """Pixels of a file: float32 [height, width, 4], bottom row first."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    pixels = pixels.reshape(height, width, 4)
    bpy.data.images.remove(image)
    return pixels


def render(path):
    bpy.context.scene.render.filepath = str(path)
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    return picture_of(f"{path}.exr")


# --- changes from frame to frame


def test_worlds_and_overriding_materials_follow_drivers_and_keyframes(lit, films):
    lit.world = bpy.data.worlds.new("World")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # needed up to 4.5, always on from 5.0
        lit.world.use_nodes = True
    background = next(node for node in lit.world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].driver_add("default_value").driver.expression = "frame"
    for number in (1, 3):
        background.inputs["Color"].default_value = (0.25 * number, 0.5, 1, 1)
        background.inputs["Color"].keyframe_insert("default_value", frame=number)
    override = bpy.data.materials.new("Override")
    tree, surface = node_tree(override)
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1, 1, 1, 1)
    emission.inputs["Strength"].driver_add("default_value").driver.expression = "10 * frame"
    tree.links.new(emission.outputs[0], surface)
    bpy.context.view_layer.material_override = override
    lit.frame_start, lit.frame_end = 1, 3
    bpy.ops.render.render(animation=True)
    assert [number for _, number, _ in films] == [1, 2, 3]
    for _, number, film in films:
        picture = film.passes["Combined"]
        assert picture[0, 0, :3] == pytest.approx((0.25 * number**2, 0.5 * number, number), rel=1e-5)
        assert picture[12, 14, :3] == pytest.approx(10.0 * number, rel=1e-5)


# --- rectangles


def assert_covered_once(rectangles, width, height):
    covered = np.zeros((height, width), int)
    for x, y, w, h in rectangles:
        assert x >= 0 and y >= 0 and x + w <= width and y + h <= height
        covered[y : y + h, x : x + w] += 1
    assert (covered == 1).all()
    assert len(set(rectangles)) >= 4


@pytest.mark.parametrize("tile_size", [0, 7])
@pytest.mark.parametrize("size", [(33, 17, 100), (50, 70, 77), (4, 5, 100)])
def test_finished_tiles_cover_the_frame_once(lit, rectangles, tile_size, size):
    lit.render.resolution_x, lit.render.resolution_y, lit.render.resolution_percentage = size
    lit.raybatch.tile_size = tile_size if min(size) > 7 else 1  # few pixels are one tile where nothing is asked for
    bpy.ops.render.render()
    assert_covered_once(rectangles, size[0] * size[2] // 100, size[1] * size[2] // 100)


@pytest.mark.parametrize("tile_size", [0, 5])
@pytest.mark.parametrize("crop", [False, True])
def test_finished_tiles_cover_the_border_once(lit, rectangles, films, tmp_path, crop, tile_size):
    """Rectangles are counted from the border's corner, as Blender wants them, cropped or not."""
    lit.raybatch.tile_size = tile_size
    settings = lit.render
    settings.use_border, settings.use_crop_to_border = True, crop
    settings.border_min_x, settings.border_max_x, settings.border_min_y, settings.border_max_y = 0.26, 0.83, 0.17, 0.92
    picture = render(tmp_path / "part")
    ((_, _, film),) = films
    x0, y0, x1, y1 = film.region
    assert (x0, y0, x1, y1) == (8, 4, 26, 22)
    assert_covered_once(rectangles, x1 - x0, y1 - y0)
    placed = picture if crop else picture[y0:y1, x0:x1]
    assert picture.shape[:2] == ((18, 18) if crop else (24, 32))
    assert np.array_equal(placed, film.passes["Combined"])


# --- size and shape of the picture


def test_a_picture_that_grows_is_written_over_and_over_and_ends_as_the_same(
    lit, rectangles, films, monkeypatch, tmp_path
):
    monkeypatch.setattr(steps, "STEP_SECONDS", 0.0)
    monkeypatch.setattr(steps, "COST_SHARE", 1e30)
    pictures = []
    lit.raybatch.sample_count, lit.raybatch.tile_size = 5, 16
    for order in ("TILE_FIRST", "PROGRESSIVE"):
        rectangles.clear()
        lit.raybatch.tile_order = order
        lit.render.filepath = str(tmp_path / order)
        bpy.ops.render.render(write_still=True)
        pictures.append(picture_of(tmp_path / f"{order}.exr"))
        assert len(rectangles) == len(set(rectangles)) * (5 if order == "PROGRESSIVE" else 1)
    assert np.array_equal(*pictures) and pictures[0].any()


def test_a_percentage_is_the_same_picture_as_that_resolution(lit, tmp_path):
    whole = render(tmp_path / "whole")
    lit.render.resolution_x, lit.render.resolution_y, lit.render.resolution_percentage = 64, 48, 50
    assert np.array_equal(render(tmp_path / "half"), whole)


@pytest.mark.parametrize("aspect", [(1, 1), (2, 1), (1, 1.6)])
@pytest.mark.parametrize("projection", ["PERSP", "ORTHO"])
def test_pixels_that_are_not_square(lit, films, aspect, projection):
    """The square covers as many pixels as in Blender's own projection, at the same position."""
    lit.render.pixel_aspect_x, lit.render.pixel_aspect_y = aspect
    lit.camera.data.type = projection
    lit.camera.data.ortho_scale = 8
    lit.raybatch.sample_count, lit.raybatch.pixel_filter = 256, "BOX"
    bpy.ops.render.render()
    corners = [world_to_camera_view(lit, lit.camera, vertex.co) for vertex in bpy.data.objects["Square"].data.vertices]
    x = np.array([corner.x for corner in corners]) * 32
    y = np.array([corner.y for corner in corners]) * 24
    seen = films[0][2].passes["Combined"][..., 0].astype(float)
    assert seen.sum() == pytest.approx(np.ptp(x) * np.ptp(y), rel=5e-3)
    centres = np.arange(32) + 0.5, np.arange(24) + 0.5
    assert (seen.sum(0) * centres[0]).sum() / seen.sum() == pytest.approx((x.min() + x.max()) / 2, abs=0.05)
    assert (seen.sum(1) * centres[1]).sum() / seen.sum() == pytest.approx((y.min() + y.max()) / 2, abs=0.05)


def test_a_transparent_film_is_the_opaque_one_without_its_world(lit, tmp_path):
    """Colour is premultiplied: the world fills the rest of alpha."""
    lit.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        lit.world.use_nodes = True
    background = next(node for node in lit.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (0.25, 0.5, 0.75, 1), 2.0
    lit.raybatch.sample_count = 16
    opaque = render(tmp_path / "opaque")
    lit.render.film_transparent = True
    cut_out = render(tmp_path / "cut out")
    alpha = cut_out[..., 3:]
    assert alpha.min() == 0 and alpha.max() == 1 and ((alpha > 0) & (alpha < 1)).any()
    assert (opaque[..., 3] == 1).all()
    np.testing.assert_allclose(cut_out[..., :3] + (1 - alpha) * np.array([0.5, 1.0, 1.5]), opaque[..., :3], atol=1e-5)


# --- animations


def animate(scene, frames, folder):
    scene.frame_start, scene.frame_end = 1, frames
    scene.render.filepath = str(folder / "frame")
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}


def test_frames_of_two_view_layers(lit, films, tmp_path):
    """Every layer of every frame shows its own objects, at the time of its frame."""
    extra = bpy.data.collections.new("Extra")
    lit.collection.children.link(extra)
    second = glow(add_triangle("Second"))
    lit.collection.objects.unlink(second)
    extra.objects.link(second)
    second.location = (1.5, 0, 0)
    lit.view_layers.new("Without").layer_collection.children["Extra"].exclude = True
    square = bpy.data.objects["Square"]
    for number, x in ((1, 0.0), (3, 100.0)):
        square.location.x = x
        square.keyframe_insert("location", frame=number)
    animate(lit, 3, tmp_path)
    assert [(layer, number) for layer, number, _ in films] == [
        (n, f) for f in (1, 2, 3) for n in ("ViewLayer", "Without")
    ]
    light = np.array([film.passes["Combined"][..., 0].sum() for _, _, film in films]).reshape(3, 2)
    assert light[0, 0] > light[0, 1] > light[1, 1] == light[2, 1] == 0
    assert light[1, 0] == light[2, 0] == pytest.approx(light[0, 0] - light[0, 1], rel=1e-6)
    assert sorted(os.listdir(tmp_path)) == ["frame0001.exr", "frame0002.exr", "frame0003.exr"]


def tree_work(film):
    """Mesh trees that were built, and refitted, for a film."""
    return film.statistics["tree"]["built"], film.statistics["tree"]["refitted"]


def test_frames_share_the_session_and_what_it_keeps(lit, films, monkeypatch, tmp_path):
    """One `Session` for all frames, though Blender makes an engine for each; static geometry is built once."""
    sessions.close_all()
    made, used = [], []
    opened, rendered = core_session.Session.__init__, core_session.Session.render

    def recording(calls, function):
        def call(*args, **options):
            calls.append(args[0])
            return function(*args, **options)

        return call

    monkeypatch.setattr(core_session.Session, "__init__", recording(made, opened))
    monkeypatch.setattr(core_session.Session, "render", recording(used, rendered))
    for number, x in ((1, 0.0), (4, 2.0)):
        lit.camera.location.x = x
        lit.camera.keyframe_insert("location", frame=number)
    animate(lit, 4, tmp_path)
    assert len(made) == 1 and len(used) == 4 and all(session is made[0] for session in used)
    assert list(sessions._sessions.values()) == made
    assert [tree_work(film) for _, _, film in films] == [(1, 0), (0, 0), (0, 0), (0, 0)], "only the camera moved"
    bpy.data.objects["Square"].location.y = 0.5
    bpy.ops.render.render()
    assert len(made) == 1 and tree_work(films[-1][2]) == (0, 1)
    glow(add_triangle("Another"))
    bpy.ops.render.render()
    assert len(made) == 1 and tree_work(films[-1][2]) == (1, 0)


@pytest.mark.parametrize("persistent", [False, True])
def test_what_moves_is_followed_without_a_trace_in_the_film(lit, films, tmp_path, persistent):
    """A mesh that waves, and instances that move.

    Their trees are refitted, and every frame equals that of a session that saw no other frame.
    """
    grid = glow(add_grid("Waves", 12))
    grid.location.z = -0.5
    wave = grid.modifiers.new("Wave", "WAVE")
    wave.height, wave.speed = 0.4, 0.2
    stones = [glow(add_triangle("Stone"))]
    stones.append(add_object("Second stone", stones[0].data))
    for number, turn in ((1, 0.0), (5, 1.0)):
        for i, stone in enumerate(stones):
            stone.location, stone.rotation_euler.y = (i - turn, turn, 0.5 + turn), turn + i
            stone.keyframe_insert("location", frame=number)
            stone.keyframe_insert("rotation_euler", frame=number)
    sessions.close_all()
    lit.render.use_persistent_data = persistent
    animate(lit, 5, tmp_path)
    lit.render.use_persistent_data = False
    followed = [film for _, _, film in films]
    work = [tree_work(film) for film in followed]
    # the instances' own tree does not change; a tree with split triangles is built once without them, to be refitted
    # from then on
    assert work[0] == (2, 0) and work[1] in ((1, 0), (0, 1)) and work[2:] == 3 * [(0, 1)]
    assert len({film.passes["Combined"].tobytes() for film in followed}) == 5
    for number, film in enumerate(followed, 1):
        sessions.close_all()
        lit.frame_set(number)
        bpy.ops.render.render()
        assert tree_work(films[-1][2]) == (2, 0)
        assert film.passes["Combined"].tobytes() == films[-1][2].passes["Combined"].tobytes()


@pytest.mark.thorough  # two hundred frames
@pytest.mark.skipif(not STATM.exists(), reason="the system does not report the resident memory of a process")
def test_memory_is_flat_over_two_hundred_frames(lit, tmp_path):
    """A mesh changes in every frame, so that all data made for it must be freed."""
    lit.render.resolution_x = lit.render.resolution_y = 16
    lit.raybatch.sample_count = 1
    grid = add_grid("Waves", 50)  # a frame's geometry and tree take about a megabyte
    grid.location.z = -1
    wave = grid.modifiers.new("Wave", "WAVE")
    wave.height, wave.speed = 0.3, 0.1
    resident, shown = {}, set()

    def note(_layer, scene, film):
        number = reports.last().frame
        shown.add(max(scene.meshes, key=lambda mesh: len(mesh.positions)).positions.tobytes())
        if number in (50, 200):
            gc.collect()
            resident[number] = int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    frame.film_listeners.append(note)
    try:
        animate(lit, 200, tmp_path)
    finally:
        frame.film_listeners.remove(note)
    growth = resident[200] - resident[50]
    print(f"resident: {resident[50] / 2**20:.1f} MiB after 50 frames, {growth / 2**20:+.2f} MiB after 200")
    assert len(shown) > 150, "the mesh moves"
    assert growth < MEMORY_TOLERANCE, f"{growth / 2**20:.1f} MiB more after 150 frames"
