"""Images in whole renders: re-reading between frames, defects, and datablocks left behind."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
OpenEXR = pytest.importorskip("OpenEXR")

from raybatch_addon.blender import frame, reports
from raybatch_addon.export.images.images import forget_images
from tests.support.blender_builders import add_mesh, exported, material_of, node_tree


@pytest.fixture
def texture(scene):
    """The Image Texture node of a square that fills the picture and shows nothing else."""
    forget_images()
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2.0
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.raybatch.sample_count = 1
    scene.raybatch.pixel_filter = "BOX"  # no ray misses the square
    square = add_mesh("Square", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    layer = square.data.uv_layers.new(name="UVMap")
    for corner, uv in zip(layer.data, ((0, 0), (1, 0), (1, 1), (0, 1))):
        corner.uv = uv
    tree, surface = node_tree(material_of(square))
    node, emission = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeEmission")
    node.interpolation = "Closest"
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    yield node
    forget_images()


def write_exr(path, pixels):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGBA": np.ascontiguousarray(pixels[::-1], np.float32)}).write(
        str(path)
    )
    return str(path)


def even(value):
    return np.broadcast_to(np.float32([value, value, value, 1]), (4, 4, 4))


def rendered():
    """Colours of the picture, the film's statistics and the report's warnings."""
    films = []

    def listen(_layer, _scene, film):
        films.append(film)

    frame.film_listeners.append(listen)
    try:
        bpy.ops.render.render()
    finally:
        frame.film_listeners.remove(listen)
    assert films[0].statistics["invalid_samples"] == 0
    return films[0].passes["Combined"][..., :3], films[0].statistics, list(reports.last().warnings)


def test_bad_images_are_named_and_give_sane_pixels(texture, tmp_path):
    gone = bpy.data.images.new("Gone", 4, 4)
    gone.source, gone.filepath = "FILE", str(tmp_path / "gone.png")
    texture.image = gone
    pixels, first, warnings = rendered()
    assert np.all(pixels == (1, 0, 1))
    assert sum("“Gone”" in line and "gone.png" in line and "magenta" in line for line in warnings) == 1

    bad = np.array(even(0.5))
    bad[1, 1, 0], bad[2, 2] = np.inf, np.nan
    texture.image = bpy.data.images.load(write_exr(tmp_path / "Bad.exr", bad))
    images = len(bpy.data.images)
    pixels, second, warnings = rendered()
    assert np.count_nonzero(np.all(pixels == 0, -1)) == 2 * 4 and np.count_nonzero(np.all(pixels == 0.5, -1)) == 14 * 4
    assert sum("“Bad.exr”" in line and "2 texels" in line for line in warnings) == 1

    texture.image.colorspace_settings.name = "ACEScg"  # converted through other datablocks
    rendered()
    assert len(bpy.data.images) == images

    texture.image = None
    pixels, last, warnings = rendered()
    assert np.all(pixels == (1, 0, 1)) and sum("no image" in line and "“Square”" in line for line in warnings) == 1
    assert first["modules"] == second["modules"] == last["modules"]


def test_sequences_follow_the_frame(texture, scene, tmp_path):
    for number in (1, 2, 3):
        write_exr(tmp_path / f"frame.{number:03}.exr", even(number / 4))
    texture.image = bpy.data.images.load(str(tmp_path / "frame.001.exr"))
    texture.image.source = "SEQUENCE"
    texture.image_user.frame_duration, texture.image_user.use_auto_refresh = 3, True
    for number in (1, 3, 2):
        scene.frame_set(number)
        pixels, _, warnings = rendered()
        assert np.all(pixels == number / 4) and warnings == []


def test_images_are_exported_once_for_all_nodes_and_frames(texture, scene, tmp_path):
    texture.image = bpy.data.images.load(write_exr(tmp_path / "a.exr", np.random.default_rng(1).random((4, 4, 4))))
    tree = texture.id_data
    second, mix = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeMixRGB")
    second.image, second.extension = texture.image, "CLIP"
    tree.links.new(texture.outputs["Color"], mix.inputs["Color1"])
    tree.links.new(second.outputs["Color"], mix.inputs["Color2"])
    emission = next(node for node in tree.nodes if node.type == "EMISSION")
    tree.links.new(mix.outputs[0], emission.inputs["Color"])
    one = exported()
    scene.frame_set(2)
    two = exported()
    assert len(one.images) == 1 and one.images[0] is two.images[0]
