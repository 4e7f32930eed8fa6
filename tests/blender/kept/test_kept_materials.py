"""Materials are compiled once for as long as their graphs, and what these look up, are the same."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export import kept_graphs, materials
from tests.support.blender_builders import add_triangle, exported, node_tree

pytestmark = pytest.mark.usefixtures("scene")


@pytest.fixture
def compiled(monkeypatch):
    """Names of the materials that were compiled."""
    kept_graphs.forget_kept()
    names = []
    real = materials.export_material

    def export_material(material, collections=None):
        names.append(material and material.name)
        return real(material, collections)

    monkeypatch.setattr(materials, "export_material", export_material)
    return names


def add_material(name, image=None):
    """A triangle with noise in a group, through a ramp and a curve, and an image if one is given."""
    obj = add_triangle(name)
    material = bpy.data.materials.new(name)
    obj.data.materials.append(material)
    tree, surface = node_tree(material)
    group = bpy.data.node_groups.new(f"{name} group", "ShaderNodeTree")
    group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
    noise, out = group.nodes.new("ShaderNodeTexNoise"), group.nodes.new("NodeGroupOutput")
    group.links.new(noise.outputs[0], out.inputs[0])
    instance = tree.nodes.new("ShaderNodeGroup")
    instance.node_tree = group
    ramp, curve = tree.nodes.new("ShaderNodeValToRGB"), tree.nodes.new("ShaderNodeRGBCurve")
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(instance.outputs[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], curve.inputs["Color"])
    tree.links.new(curve.outputs[0], shader.inputs["Color"])
    if image is not None:
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = image
        tree.links.new(texture.outputs[0], shader.inputs["Roughness"])
    tree.links.new(shader.outputs[0], surface)
    return material


def node(material, kind):
    return next(each for each in material.node_tree.nodes if each.bl_idname == kind)


def same(a, b):
    if a.program is None or b.program is None:
        return a == b
    return (
        (a.name, a.closures, a.kinds, a.aimed, a.shadow_opaque)
        == (b.name, b.closures, b.kinds, b.aimed, b.shadow_opaque)
        and a.program.instructions == b.program.instructions
        and np.array_equal(a.program.constants, b.program.constants)
        and a.program.ops == b.program.ops
    )


def assert_as_new(scene):
    kept_graphs.forget_kept()
    new = exported()
    assert all(map(same, scene.materials, new.materials)) and len(scene.materials) == len(new.materials)
    assert scene.warnings == new.warnings and scene.attributes == new.attributes
    assert [image.name for image in scene.images] == [image.name for image in new.images]


def test_unchanged_materials_are_not_compiled_again(compiled):
    image = bpy.data.images.new("picture", 4, 4)
    for name in ("A", "B"):
        add_material(name, image)
    first = exported()
    assert sorted(compiled) == ["A", "B"]
    compiled.clear()
    second = exported()
    assert not compiled
    assert all(a is b for a, b in zip(first.materials, second.materials))
    assert len(second.images) == 1
    assert_as_new(second)


def test_materials_with_nodes_that_have_no_image_are_kept_too(compiled):
    material = add_material("A")
    tree = material.node_tree
    empty = tree.nodes.new("ShaderNodeTexImage")
    tree.links.new(empty.outputs["Color"], node(material, "ShaderNodeBsdfDiffuse").inputs["Color"])
    first = exported()
    assert any("has no image: it is magenta" in each for each in first.warnings)
    compiled.clear()
    second = exported()
    assert not compiled and second.materials[0] is first.materials[0]
    assert_as_new(second)


def slider(material):
    node(material, "ShaderNodeBsdfDiffuse").inputs["Roughness"].default_value = 0.75


def in_group(material):
    group = node(material, "ShaderNodeGroup").node_tree
    group.nodes["Noise Texture"].inputs["Scale"].default_value = 9.0


def ramp(material):
    node(material, "ShaderNodeValToRGB").color_ramp.elements[0].position = 0.25


def ramp_color(material):
    node(material, "ShaderNodeValToRGB").color_ramp.elements[1].color = (1.0, 0.5, 0.0, 1.0)


def curve(material):
    mapping = node(material, "ShaderNodeRGBCurve").mapping
    mapping.curves[3].points[1].location = (0.5, 0.75)
    mapping.update()
    material.node_tree.update_tag()


def choice(material):
    node(material, "ShaderNodeGroup").node_tree.nodes["Noise Texture"].noise_dimensions = "2D"


def unlink(material):
    tree = material.node_tree
    tree.links.remove(node(material, "ShaderNodeBsdfDiffuse").inputs["Color"].links[0])


def mute(material):
    node(material, "ShaderNodeRGBCurve").mute = True


def rename(material):
    material.name = "Renamed"


def add(material):
    tree = material.node_tree
    invert = tree.nodes.new("ShaderNodeInvert")
    target = node(material, "ShaderNodeBsdfDiffuse").inputs["Color"]
    tree.links.new(node(material, "ShaderNodeRGBCurve").outputs[0], invert.inputs["Color"])
    tree.links.new(invert.outputs[0], target)


def drive(material):
    socket = node(material, "ShaderNodeBsdfDiffuse").inputs["Roughness"]
    socket.driver_add("default_value").driver.expression = "0.625"


def aim_never(material):
    material.cycles.emission_sampling = "NONE"


def block_shadows(material):
    material.use_transparent_shadow = False


@pytest.mark.parametrize(
    "change",
    [slider, in_group, ramp, ramp_color, curve, choice, unlink, mute, rename, add, drive, aim_never, block_shadows],
)
def test_a_changed_material_is_compiled_again_and_no_other(compiled, change):
    material, other = add_material("A"), add_material("B")
    first = exported()
    compiled.clear()
    change(material)
    bpy.context.view_layer.update()
    second = exported()
    assert compiled == [material.name]
    index = [each.name for each in second.materials].index(material.name)
    assert not same(first.materials[index], second.materials[index]), "the change shows"
    assert second.materials[1 - index] is first.materials[1 - index] and other.name == "B"
    assert_as_new(second)


def test_materials_are_compiled_again_where_their_images_have_other_indices(compiled):
    images = [bpy.data.images.new(name, 4, 4) for name in ("one", "two")]
    first, second = add_material("A", images[0]), add_material("B", images[1])
    exported()
    compiled.clear()
    node(first, "ShaderNodeTexImage").image = images[1]
    bpy.context.view_layer.update()
    scene = exported()
    assert sorted(compiled) == ["A", "B"], "the image of B is now the first of the scene"
    assert len(scene.images) == 1 and second.name == "B"
    assert_as_new(scene)


def test_what_graphs_look_up_elsewhere_is_read_each_time(compiled, scene):
    material = add_material("A")
    tree = material.node_tree
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_type, attribute.attribute_name = "VIEW_LAYER", "level"
    tree.links.new(attribute.outputs["Fac"], node(material, "ShaderNodeBsdfDiffuse").inputs["Roughness"])
    empty = bpy.data.objects.new("Empty", None)
    other = add_material("B")
    place = other.node_tree.nodes.new("ShaderNodeTexCoord")
    place.object = empty
    other.node_tree.links.new(place.outputs["Object"], node(other, "ShaderNodeBsdfDiffuse").inputs["Color"])
    scene.collection.objects.link(empty)
    scene["level"] = 0.25
    first = exported()
    compiled.clear()
    scene["level"], empty.location.x = 0.5, 2.0
    scene.update_tag()
    bpy.context.view_layer.update()
    second = exported()
    assert sorted(compiled) == ["A", "B"]
    assert not any(map(same, first.materials, second.materials))
