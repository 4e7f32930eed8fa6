"""What Blender does with a picture of RayBatch's: lines and strokes drawn over it, and baking, which it refuses."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import reports
from tests.support.blender_builders import add_grid

DARK = 0.1  # of a screen's values
LEAST = 0.01  # share of pixels that lines cover at least


@pytest.fixture
def white(scene, tmp_path):
    """A square before a white world."""
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    scene.camera.location, scene.camera.rotation_euler = (0, 0, 3), (0, 0, 0)
    add_grid("Square", 1)
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.raybatch.sample_count = scene.cycles.samples = 8
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(tmp_path / "picture.png")
    return scene


def dark_share(scene, engine: str) -> float:
    """Share of dark pixels in what `engine` renders and Blender saves."""
    scene.render.engine = engine
    scene.render.image_settings.file_format = "PNG"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(image.pixels[:]).reshape(-1, 4)
    bpy.data.images.remove(image)
    return float((pixels[:, :3] < DARK).all(-1).mean())


def assert_drawn(scene) -> None:
    share = dark_share(scene, "CYCLES")
    if share < LEAST:
        pytest.skip("Blender draws nothing over pictures here: it has no context of the graphics card")
    assert dark_share(scene, "RAYBATCH") == pytest.approx(share, abs=0.02)
    assert reports.last().errors == reports.last().warnings == []


def test_freestyle_lines_are_drawn_over_the_picture(white):
    assert dark_share(white, "RAYBATCH") < LEAST
    white.render.use_freestyle, white.render.line_thickness = True, 2
    layer = white.view_layers[0]
    layer.use_freestyle = True
    lines = layer.freestyle_settings.linesets
    (lines[0] if lines else lines.new("Lines")).linestyle = bpy.data.linestyles.new("Black")
    assert_drawn(white)


def test_grease_pencil_is_drawn_over_the_picture(white):
    if not hasattr(bpy.data, "grease_pencils_v3") and bpy.app.version < (5, 0):
        pytest.skip("Grease Pencil has another interface here")
    bpy.ops.object.grease_pencil_add(type="MONKEY", location=(0, 0, 0.5))
    bpy.context.object.rotation_euler = (-math.pi / 2, 0, 0)  # it is drawn upright
    assert_drawn(white)


def test_baking_is_refused(white):
    square = bpy.data.objects["Square"]
    bpy.context.view_layer.objects.active = square
    square.select_set(True)
    square.data.uv_layers.new(name="UVMap")
    material = bpy.data.materials.new("Baked")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    square.data.materials.append(material)
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image, material.node_tree.nodes.active = bpy.data.images.new("Target", 8, 8), texture
    with pytest.raises(RuntimeError, match="Current render engine does not support baking"):
        bpy.ops.object.bake(type="COMBINED")
