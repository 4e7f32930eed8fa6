"""Broken shader graphs: they are named in a warning, and never cause an exception or an invalid value."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender_builders import add_triangle, exported, material_of, node_tree

pytestmark = pytest.mark.usefixtures("scene")


@pytest.fixture
def graph():
    """The node tree of a material in use, an emission that it shows, and the links' maker."""
    material = material_of(add_triangle("Thing"), "Odd")
    tree, surface = node_tree(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], surface)
    return tree, emission


def shown():
    """Emission of the only material, and the warnings."""
    scene = exported()
    (material,) = scene.materials
    assert material.program is None
    return tuple(
        sum(values) for values in zip((0, 0, 0), *(c.weight for c in material.closures), strict=True)
    ), scene.warnings


def only(warnings, *words):
    (warning,) = warnings
    for word in words:
        assert word in warning


def test_nodes_that_are_linked_to_themselves(graph):
    tree, emission = graph
    one, two = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMath")
    one.operation = two.operation = "ADD"
    one.inputs[1].default_value = two.inputs[1].default_value = 0.25
    tree.links.new(one.outputs[0], two.inputs[0])
    tree.links.new(two.outputs[0], one.inputs[0])
    tree.links.new(two.outputs[0], emission.inputs["Strength"])
    light, warnings = shown()
    assert light[0] in (0.5, 1)  # Blender reports which of the links is the wrong one
    only(warnings, "“Odd”", "invalid", "circle")


def test_reroutes_in_a_circle(graph):
    tree, emission = graph
    one, two = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    tree.links.new(one.outputs[0], two.inputs[0])
    tree.links.new(two.outputs[0], one.inputs[0])
    tree.links.new(two.outputs[0], emission.inputs["Strength"])
    light, warnings = shown()
    assert all(0 <= value <= 1 for value in light)
    only(warnings, "“Odd”", "circle")


@pytest.mark.parametrize("broken", ["no tree", "no output", "removed tree"])
def test_groups_that_are_broken(graph, broken):
    tree, emission = graph
    group = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    group.interface.new_socket("Strength", in_out="OUTPUT", socket_type="NodeSocketFloat")
    node = tree.nodes.new("ShaderNodeGroup")
    node.name = "Broken"
    node.node_tree = group
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    if broken == "no tree":
        node.node_tree = None
    elif broken == "removed tree":
        bpy.data.node_groups.remove(group)
    light, warnings = shown()
    if warnings or broken == "no output":
        only(warnings, "“Odd”", "“Broken”", "Group Output" if broken == "no output" else "no node tree")
        assert light == (0, 0, 0)
    else:  # the sockets went with the tree, and the link with them: the input's own value counts, as in Blender
        assert light == (1, 1, 1)


def test_a_group_whose_output_lacks_the_socket_gives_nothing(graph):
    tree, emission = graph
    group = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    group.nodes.new("NodeGroupOutput")
    socket = group.interface.new_socket("Strength", in_out="OUTPUT", socket_type="NodeSocketFloat")
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    group.interface.remove(socket)
    light, _ = shown()
    assert all(0 <= value <= 1 for value in light)


def test_drivers_that_fail_are_named_with_what_they_drive(graph):
    tree, emission = graph
    value = tree.nodes.new("ShaderNodeValue")
    tree.links.new(value.outputs[0], emission.inputs["Strength"])
    value.outputs[0].default_value = 0.5
    driver = value.outputs[0].driver_add("default_value").driver
    driver.expression = "1 / 0"
    bpy.data.objects["Thing"].driver_add("hide_render").driver.expression = "frame * 0"  # a driver that works
    muted = bpy.data.objects["Thing"].driver_add("scale", 0)
    muted.driver.expression, muted.mute = "1 / 0", True
    light, warnings = shown()
    assert light[0] >= 0
    only(warnings, "material “Odd”", "default_value", "cannot be evaluated", "Drivers Editor")

    driver.expression = "0.25 + 0.5"
    light, warnings = shown()
    assert light == (0.75, 0.75, 0.75) and warnings == ()
