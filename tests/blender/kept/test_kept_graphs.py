"""Graphs of lights and of the world are compiled once for as long as they, and what they look up, are the same."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export import kept_graphs, lights, world
from tests.support.blender_builders import add_object, exported, node_tree

pytestmark = pytest.mark.usefixtures("scene")


@pytest.fixture
def compiled(monkeypatch):
    """Names of the lights and worlds whose graphs were compiled."""
    kept_graphs.forget_kept()
    names = []

    def count(module):
        real = module.compile_graph

        def compile_graph(socket, owner, collections, *more):
            names.append(owner.name)
            return real(socket, owner, collections, *more)

        monkeypatch.setattr(module, "compile_graph", compile_graph)

    count(lights)
    count(world)
    return names


def add_light(name):
    data = bpy.data.lights.new(name, "POINT")
    add_object(name, data)
    return data


@pytest.fixture
def lamp():
    """A lamp, whose nodes have a constant in a group."""
    data = add_light("Lamp")
    tree, surface = node_tree(data)
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
    value, out = group.nodes.new("ShaderNodeValue"), group.nodes.new("NodeGroupOutput")
    value.outputs[0].default_value = 2.0
    group.links.new(value.outputs[0], out.inputs[0])
    instance, shader = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeEmission")
    instance.node_tree = group
    tree.links.new(instance.outputs[0], shader.inputs["Strength"])
    tree.links.new(shader.outputs[0], surface)
    return data


@pytest.fixture
def sky():
    """A world that shows an image all around."""
    made = bpy.context.scene.world = bpy.data.worlds.new("World")
    tree, surface = node_tree(made)
    texture, shader = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeBackground")
    texture.image = bpy.data.images.new("around", 2048, 4)
    tree.links.new(texture.outputs[0], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], surface)
    return made


def node(owner, kind):
    return next(each for each in owner.node_tree.nodes if each.bl_idname == kind)


def emission(scene):
    return scene.lights[0].emission


def said(scene):
    """What graphs say, but for the pixels of images."""
    programs = [scene.world.program, *(each.program for each in scene.lights)]
    made = [program and (program.instructions, program.constants.tolist()) for program in programs]
    return emission(scene), made, [image.name for image in scene.images]


def assert_as_new(scene):
    kept_graphs.forget_kept()
    new = exported()
    assert said(scene) == said(new) and scene.warnings == new.warnings
    assert (scene.world.radiance, scene.world.sampling_size) == (new.world.radiance, new.world.sampling_size)


def test_unchanged_graphs_are_not_compiled_again(compiled, lamp, sky):
    first = exported()
    assert compiled == ["Lamp", "World"]
    compiled.clear()
    second = exported()
    assert not compiled
    assert second.world.program is first.world.program
    assert_as_new(second)


def in_group(lamp, sky):
    group = node(lamp, "ShaderNodeGroup").node_tree
    next(each for each in group.nodes if each.bl_idname == "ShaderNodeValue").outputs[0].default_value = 3.0


def in_the_lamp(lamp, sky):
    node(lamp, "ShaderNodeEmission").inputs["Color"].default_value = (1.0, 0.5, 0.25, 1.0)


def muted(lamp, sky):
    node(lamp, "ShaderNodeGroup").mute = True


def in_the_world(lamp, sky):
    node(sky, "ShaderNodeBackground").inputs["Strength"].default_value = 3.0


def other_image(lamp, sky):
    node(sky, "ShaderNodeTexEnvironment").image = bpy.data.images.new("other", 4096, 4)


def image_before(lamp, sky):
    """The lamp shows an image too, so that the world's gets another index."""
    tree = lamp.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("before", 4, 4)
    tree.links.new(texture.outputs[0], node(lamp, "ShaderNodeEmission").inputs["Color"])


@pytest.mark.parametrize("edit", [in_group, in_the_lamp, muted, in_the_world, other_image, image_before])
def test_edited_graphs_are_compiled_again(compiled, lamp, sky, edit):
    before = exported()
    compiled.clear()
    edit(lamp, sky)
    scene = exported()
    assert compiled and said(scene) != said(before)
    assert_as_new(scene)


def test_what_is_no_part_of_a_graph_is_read_each_time(compiled, lamp, sky):
    exported()
    compiled.clear()
    lamp.energy *= 2
    node(sky, "ShaderNodeTexEnvironment").image.scale(8192, 4)
    scene = exported()
    assert not compiled
    assert scene.world.sampling_size == 8192
    assert_as_new(scene)


def test_animated_graphs_are_not_kept(compiled, lamp, sky):
    strength = node(sky, "ShaderNodeBackground").inputs["Strength"]
    for frame, value in ((1, 1.0), (2, 5.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    bpy.context.scene.frame_set(1)
    exported()
    compiled.clear()
    bpy.context.scene.frame_set(2)
    scene = exported()
    assert compiled == ["World"]
    assert_as_new(scene)


def test_graphs_that_are_gone_are_forgotten(compiled, lamp, sky):
    exported()
    bpy.context.scene.world = None
    bpy.data.worlds.remove(sky)
    for name in ("A", "B"):
        node_tree(add_light(name))
    exported()
    owners = (*bpy.data.materials, *bpy.data.lights, *bpy.data.worlds)
    assert kept_graphs._kept.keys() <= {each.session_uid for each in owners}
