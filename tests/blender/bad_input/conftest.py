"""A lit scene, and the films of its renders."""

import pytest


@pytest.fixture
def lit(scene):
    """A triangle that emits white light in the middle of the frame, in front of a coloured world."""
    import bpy

    from tests.blender.bad_input.outcomes import BACKGROUND, glow
    from tests.support.blender_builders import add_triangle

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
    from raybatch_addon.blender import frame

    got = []

    def listen(_layer, _scene, film):
        got.append(film)

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)
