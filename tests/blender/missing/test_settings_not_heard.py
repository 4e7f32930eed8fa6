"""Settings that change the picture in Cycles, and not here, are named with what they are set at."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.notice import Weight, by_weight
from raybatch_addon.export.scene import export_scene
from tests.support.blender_builders import add_grid, material_of, node_tree

REPLACED, SETTING = Weight.REPLACED, Weight.SETTING


def found(words: str) -> list:
    """Notices of an export with these words in them."""
    bpy.context.view_layer.update()
    every = by_weight(export_scene(bpy.context.evaluated_depsgraph_get()).warnings)
    return [each for each in every if words in each]


def host():
    """A square with a material of one node, and that material's tree and Surface socket."""
    obj = add_grid("Host", 1)
    material = material_of(obj, "Coat")
    return obj, material, *node_tree(material)


def denoised_layer(scene):
    scene.raybatch.denoise, scene.view_layers[0].cycles.use_denoising = "ON", False


def denoised(scene):
    scene.cycles.use_denoising = True


def no_denoised_layer(scene):
    denoised(scene)
    scene.view_layers[0].cycles.use_denoising = False


def world_of(scene, varies: bool = True, fog: bool = False):
    """A new world of the scene."""
    world = scene.world = bpy.data.worlds.new("Sky")
    tree, _ = node_tree(world)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    if varies:
        tree.links.new(tree.nodes.new("ShaderNodeTexGradient").outputs["Color"], background.inputs["Color"])
    if fog:
        tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    return world


def shading_offset(_scene):
    host()[0].shadow_terminator_shading_offset = 0.25


def bump(_scene, kind="ShaderNodeBump", links=True):
    _, material, tree, surface = host()
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(shader.outputs[0], surface)
    if links:
        node = tree.nodes.new(kind)
        if kind == "ShaderNodeBump":
            tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], node.inputs["Height"])
        tree.links.new(node.outputs[0], shader.inputs["Normal"])
    material.cycles.use_bump_map_correction = False


def normal_map(scene):
    bump(scene, "ShaderNodeNormalMap")


def no_bump(scene):
    bump(scene, links=False)


def animated_seed(scene):
    scene.cycles.use_animated_seed = True


def bounces_before_roulette(scene):
    scene.cycles.min_light_bounces, scene.cycles.min_transparent_bounces = 3, 2


def sample_subset(scene):
    scene.cycles.use_sample_subset, scene.cycles.sample_offset = True, 5


def offset_without_subset(scene):
    scene.cycles.sample_offset = 5


def lamp_without_mis(scene, size=0.1):
    obj = bpy.data.objects.new("Host", bpy.data.lights.new("Lamp", "POINT"))
    scene.collection.objects.link(obj)
    obj.data.shadow_soft_size, obj.data.cycles.use_multiple_importance_sampling = size, False


def point_without_mis(scene):
    lamp_without_mis(scene, 0.0)


def world_caustics(scene):
    world_of(scene).cycles.is_caustics_light = True


def portal(scene, filled=True):
    _, _, tree, surface = host()
    tree.links.new(tree.nodes.new("ShaderNodeBsdfRayPortal").outputs[0], surface)
    if filled:
        tree, surface = node_tree(material_of(add_grid("Fog", 1), "Fog"))
        tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], surface.node.inputs["Volume"])


def portal_in_a_foggy_world(scene):
    portal(scene, filled=False)
    world_of(scene, fog=True)
    assert export_scene(bpy.context.evaluated_depsgraph_get()).world.volume is not None


@pytest.mark.parametrize(
    ("change", "words", "weight", "objects", "material"),
    [
        (shading_offset, "Shading Offset", REPLACED, ("Host",), ""),
        (bump, "Bump Map Correction", REPLACED, ("Host",), "Coat"),
        (normal_map, "Bump Map Correction", REPLACED, ("Host",), "Coat"),
        (animated_seed, "Animated Seed on", SETTING, (), ""),
        (bounces_before_roulette, "Min Light Bounces 3, Min Transparent Bounces 2", SETTING, (), ""),
        (sample_subset, "Sample Subset on, Sample Subset Offset 5", SETTING, (), ""),
        (lamp_without_mis, "Multiple Importance", SETTING, ("Host",), ""),
        (world_caustics, "the world's light comes through glass", SETTING, (), ""),
        (portal, "Ray Portal", REPLACED, (), "Coat"),
        (denoised, "Denoise is on in Cycles", SETTING, (), ""),
        (denoised_layer, "Denoising is off for the view layer", SETTING, (), ""),
    ],
)
def test_what_is_not_heard_is_named(scene, change, words, weight, objects, material):
    change(scene)
    (notice,) = found(words)
    assert (notice.weight, notice.objects, notice.material) == (weight, objects, material)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (point_without_mis, "Multiple Importance"),
        (no_bump, "Bump Map Correction"),
        (offset_without_subset, "Sample"),
        (portal_in_a_foggy_world, "Ray Portal"),
        (no_denoised_layer, "Denois"),
    ],
)
def test_what_changes_nothing_in_cycles_is_not_named(scene, change, words):
    change(scene)
    assert found(words) == []


@pytest.mark.parametrize("emitter", ["lamp", "mesh"])
@pytest.mark.parametrize(
    ("state", "roughness", "named"), [("EXCLUDE", 0.0, True), ("EXCLUDE", 0.1, False), ("INCLUDE", 0.0, False)]
)
def test_lamps_that_mirrors_show_in_cycles_alone_are_named(scene, emitter, state, roughness, named):
    _, _, tree, surface = host()
    mirror = tree.nodes.new("ShaderNodeBsdfAnisotropic")
    mirror.inputs["Roughness"].default_value = roughness
    tree.links.new(mirror.outputs[0], surface)
    if emitter == "lamp":
        obj = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
        scene.collection.objects.link(obj)
    else:
        obj = add_grid("Lamp", 1)
        tree, surface = node_tree(material_of(obj, "Glow"))
        tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], surface)
    collection = obj.light_linking.blocker_collection = bpy.data.collections.new("Blockers")
    collection.objects.link(add_grid("Glass", 1))
    collection.collection_objects[0].light_linking.link_state = state
    assert [each.objects for each in found("Shadow Linking")] == ([("Lamp",)] if named else [])
