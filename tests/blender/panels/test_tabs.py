"""What the export reads of Blender's and Cycles' own properties is offered in the tabs where their users look."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.support.panel_layout import context_of, drawn, own_panels


def properties_of(name, context):
    panel = next(panel for panel in own_panels() if panel.__name__ == name)
    assert panel.poll(context)
    return [note[2] for note in drawn(panel, context) if note[0] == "prop"]


def test_materials_and_worlds_of_a_view_layer_are_overridden(scene):
    overrides = {"material_override"} | ({"world_override"} if bpy.app.version >= (5, 0) else set())
    assert overrides <= set(properties_of("RAYBATCH_VIEWLAYER_PT_filter", context_of(scene)))


def test_how_far_ambient_occlusion_looks_is_a_property_of_the_world(scene):
    scene.world = bpy.data.worlds.new("World")
    context = context_of(scene, world=scene.world)
    assert properties_of("RAYBATCH_WORLD_PT_ambient_occlusion", context) == ["distance"]
    layer = scene.view_layers[0]
    layer.use_pass_ambient_occlusion = False
    assert "distance" not in properties_of("RAYBATCH_VIEWLAYER_PT_passes", context)
    layer.use_pass_ambient_occlusion = True
    assert "distance" in properties_of("RAYBATCH_VIEWLAYER_PT_passes", context)
    scene.world = None
    assert "distance" not in properties_of("RAYBATCH_VIEWLAYER_PT_passes", context)


def test_the_shape_of_curves_is_in_the_render_tab(scene):
    assert properties_of("RAYBATCH_RENDER_PT_curves", context_of(scene)) == ["shape", "subdivisions"]
    panel = next(panel for panel in own_panels() if panel.__name__ == "RAYBATCH_RENDER_PT_curves")
    assert panel.bl_context == "render" and not panel.poll(context_of(scene, engine="CYCLES"))
