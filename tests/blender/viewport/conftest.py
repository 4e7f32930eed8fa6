"""Scenes that tests of viewports edit."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender.viewport.draw import PictureTexture
from tests.blender.viewport.reader import Reader
from tests.blender.viewport.regions import region_context, updates_to
from tests.blender.viewport.shown import Shown
from tests.support.blender_builders import add_grid, add_object, material_of, node_tree


@pytest.fixture
def objects(scene):
    """Three grids with a material each, a light and a world."""
    made = []
    for number in range(3):
        obj = add_grid(f"Grid {number}", 4 + number)
        obj.location = (3 * number, 0, 0)
        tree, surface = node_tree(material_of(obj, f"Material {number}"))
        shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
        shader.name = "Diffuse"
        tree.links.new(shader.outputs[0], surface)
        made.append(obj)
    add_object("Light", bpy.data.lights.new("Light", "POINT"))
    scene.world = bpy.data.worlds.new("World")
    bpy.context.view_layer.update()
    return made


@pytest.fixture
def reader(objects):
    made = Reader()
    made.read(bpy.context.evaluated_depsgraph_get())
    return made


@pytest.fixture
def lit(scene):
    """The scene with a shining grid."""
    obj = add_grid("Grid", 6)
    obj.location = (-2, -2, 0)
    tree, surface = node_tree(material_of(obj))
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.name = "Emission"
    tree.links.new(shader.outputs[0], surface)
    scene.raybatch_viewport.samples = 4
    bpy.context.view_layer.update()
    return scene


@pytest.fixture
def shown(lit, monkeypatch):
    """The scene in a viewport."""
    made = Shown(region_context())
    monkeypatch.setattr(
        PictureTexture, "draw", lambda _self, _engine, _scene, picture, _exposure: made.drawn.append(picture)
    )
    with updates_to(made.update):
        made.update(bpy.context.evaluated_depsgraph_get())
        yield made
    made.viewport.close()
    assert made.viewport.render.join(60)
