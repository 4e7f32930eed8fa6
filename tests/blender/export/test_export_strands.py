"""Curves, particle hair and point clouds as segments: what is kept, what is dropped and named, and what they say."""

import bpy
import numpy as np
import pytest

from raybatch_addon.export.curves import sources
from raybatch_addon.export.curves.strands import CurveShape, CutStrands, hair_attribute, sound_strands
from raybatch_addon.export.scene import export_scene
from tests.support.blender_builders import add_grid, add_object, material_of, node_tree


def add_camera() -> None:
    bpy.context.scene.camera = add_object("Camera", bpy.data.cameras.new("Camera"))


def add_curves(points, sizes, radii=None):
    curves = bpy.data.hair_curves.new("Hair")
    curves.add_curves(sizes)
    curves.position_data.foreach_set("vector", np.asarray(points, np.float32).ravel())
    if radii is not None:
        attribute = curves.attributes.new("radius", "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.asarray(radii, np.float32))
    return add_object("Hair", curves)


def require_another_radius() -> None:
    if bpy.app.version < (5, 0):
        pytest.skip("before Blender 5 radii are numbers of points, and no other attribute has their name")


def exported():
    return export_scene(bpy.context.evaluated_depsgraph_get())


@pytest.fixture(autouse=True)
def empty():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.cycles_curves.shape = "THICK"
    add_camera()


def test_strands_that_cannot_be_rendered_are_named():
    good = [(0, 0, 0), (0, 0, 1), (0, 0, 2)]
    points = [*good, (1, 0, 0), (5, 5, 5), (5, 5, 5), (np.nan, 0, 0), (0, 1, 0), (2, 0, 0), (2, 0, 1)]
    add_curves(points, [3, 1, 2, 2, 2], [0.1] * 8 + [0.0] * 2)
    scene = exported()
    (mesh,) = scene.meshes
    assert len(mesh.triangles) == 2 and np.array_equal(mesh.positions, good)
    (line,) = scene.warnings
    assert "“Hair”" in line
    assert "1 with points or radii that are not finite" in line
    assert "2 without length" in line and "1 without radius" in line


def test_attributes_of_the_other_domain_are_carried_over_and_named():
    require_another_radius()
    hair = add_curves([(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1), (1, 0, 2)], [2, 3])
    hair.data.attributes.new("radius", "FLOAT", "CURVE").data.foreach_set("value", [0.1, 0.2])
    slots = hair.data.attributes.new("material_index", "INT", "POINT")
    slots.data.foreach_set("value", [0, 0, 1, 1, 1])
    for name in "ab":
        hair.data.materials.append(bpy.data.materials.new(name))
    scene = exported()
    (mesh,) = scene.meshes
    assert mesh.radii == pytest.approx([0.1, 0.1, 0.2, 0.2, 0.2])
    assert mesh.triangle_slot.tolist() == [0, 1, 1]
    assert [("radius" in line, "material_index" in line) for line in scene.warnings] == [(True, False), (False, True)]
    assert all("“Hair”" in line for line in scene.warnings)


def test_a_radius_that_is_no_number_is_named():
    require_another_radius()
    hair = add_curves([(0, 0, 0), (0, 0, 1)], [2])
    hair.data.attributes.new("radius", "FLOAT4X4", "POINT")
    scene = exported()
    assert scene.meshes[0].radii == pytest.approx(0.005) and "“radius”" in scene.warnings[0]


def test_an_attribute_that_strands_lack_is_reported():
    hair = add_curves([(0, 0, 0), (0, 0, 1)], [2])
    hair.data.attributes.new("there", "FLOAT", "POINT")
    material = bpy.data.materials.new("Tinted")
    material.use_nodes = True  # before Blender 5 a choice
    hair.data.materials.append(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    for name, socket in (("there", "Roughness"), ("tint", "Base Color")):
        node = tree.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        tree.links.new(node.outputs["Fac" if name == "there" else "Color"], shader.inputs[socket])
    reported = [each for each in exported().warnings if "attribute" in each]
    assert len(reported) == 1 and "“tint”" in reported[0] and reported[0].objects == ("Hair",)


def test_curves_without_radius_have_that_of_cycles():
    add_curves([(0, 0, 0), (0, 0, 1)], [2])
    assert exported().meshes[0].radii == pytest.approx(0.005)


def test_a_bent_strand_is_cut_finer_and_a_straight_one_is_not():
    straight = np.float32([(0, 0, z) for z in range(5)])
    bent = np.float32([(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 2, 5)])
    first, radii = np.int32([0, 5]), np.full(5, 0.01, np.float32)
    assert len(CutStrands(sound_strands(straight, radii, first)).segments) == 4
    cut = CutStrands(sound_strands(bent, radii, first))
    assert len(cut.segments) > 8
    # on the circle, as far as the spline is; and as many as they are if they are to be straight
    middle = cut.mesh("bent").positions
    assert np.linalg.norm(middle, axis=1) == pytest.approx(1, abs=0.02)
    assert len(CutStrands(sound_strands(bent, radii, first), CurveShape(linear=True)).segments) == 4


def test_what_a_strand_says_of_itself():
    points = np.float32([(0, 0, 0), (0, 0, 1), (0, 0, 3), (1, 0, 0), (1, 0, 2)])
    strands = sound_strands(points, np.float32([0.2, 0.1, 0.0, 0.1, 0.1]), np.int32([0, 3, 5]))
    cut = CutStrands(strands, CurveShape(linear=True))
    said = {name: hair_attribute(cut, name).values for name in ("intercept", "length", "thickness", "random")}
    assert said["intercept"][:, :2, 0] == pytest.approx(np.float32([[0, 1 / 3], [1 / 3, 1], [0, 1]]))
    assert said["length"][:, 0] == pytest.approx([3, 3, 2])
    assert said["thickness"][:, :2, 0] == pytest.approx(np.float32([[0.4, 0.2], [0.2, 0], [0.2, 0.2]]))
    assert said["random"][0] == said["random"][1] != said["random"][2]
    # the third corner is the first: values do not depend on where around the strand a hit is
    assert np.array_equal(said["intercept"][:, 2], said["intercept"][:, 0])


def test_particle_hair_grows_in_the_object_s_space():
    ground = add_grid("Ground", 2)
    ground.location, ground.scale = (5, 0, 1), (2, 2, 2)
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.render_step = "HAIR", 10, 1.0, 3
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.5, 0.1
    scene = exported()
    hair = next(mesh for mesh in scene.meshes if mesh.radii is not None)
    assert "Ground" in hair.name
    roots = hair.positions[np.setdiff1d(hair.triangles[:, 0], hair.triangles[:, 1])]
    assert len(roots) == 10 and roots[:, 2] == pytest.approx(0, abs=1e-5) and np.abs(roots[:, :2]).max() <= 1
    assert hair.radii.max() == pytest.approx(0.05, rel=1e-5) and hair.radii.min() <= 0.025001


def hair_of(**values):
    """The exported hair of a new square that is far from the origin."""
    if "Ground" in bpy.data.objects:
        bpy.data.objects.remove(bpy.data.objects["Ground"])
    ground = add_grid("Ground", 2)
    ground.location = (5, 0, 0)
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.display_step = "HAIR", 10, 1.0, 3
    for name, value in values.items():
        setattr(settings, name, value)
    return next(mesh for mesh in exported().meshes if mesh.radii is not None)


def test_strands_without_the_extra_steps_of_a_spiral_end_where_they_end():
    """Blender gives the origin of the world for steps that a strand has not."""
    plain, spiral = hair_of(), hair_of(kink="SPIRAL", kink_extra_steps=6)
    assert np.array_equal(spiral.positions, plain.positions) and np.array_equal(spiral.radii, plain.radii)


def test_parents_are_left_out_where_there_are_children_as_in_cycles():
    count = {
        name: len(np.setdiff1d(hair.triangles[:, 0], hair.triangles[:, 1]))
        for name, hair in (
            ("alone", hair_of()),
            ("children", hair_of(child_type="SIMPLE", child_percent=3)),
            ("both", hair_of(child_type="SIMPLE", child_percent=3, use_parent_particles=True)),
            ("no children", hair_of(child_type="SIMPLE", child_percent=0)),
        )
    }
    assert count == {"alone": 10, "children": 30, "both": 30, "no children": 10}


def test_particle_hair_without_radius_is_named_and_its_points_are_not_asked_for(monkeypatch):
    owner = add_grid("Skin", 2)
    owner.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = owner.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 7
    settings.root_radius = settings.tip_radius = 0

    def ask(*_):
        raise AssertionError("points were asked for")

    monkeypatch.setattr(sources, "_paths", ask)
    scene = exported()
    assert len(scene.meshes) == 1  # the skin
    (line,) = [line for line in scene.warnings if "Skin" in line]
    assert "7 without radius" in line
    settings.tip_radius = 1
    with pytest.raises(AssertionError, match="points were asked for"):
        exported()


def test_empty_curves_and_clouds_are_nothing():
    add_object("Hair", bpy.data.hair_curves.new("Hair"))
    add_object("Points", bpy.data.pointclouds.new("Points"))
    scene = exported()
    assert scene.meshes == () and scene.warnings == ()


def test_points_are_spheres():
    cloud = bpy.data.pointclouds.new("Cloud")
    if not hasattr(cloud, "resize"):
        pytest.skip("before Blender 5 no script gives a point cloud its points")
    cloud.resize(3)
    cloud.attributes["position"].data.foreach_set("vector", np.float32([0, 0, 0, 1, 0, 0, np.inf, 0, 0]))
    add_object("Cloud", cloud)
    scene = exported()
    (mesh,) = scene.meshes
    assert np.array_equal(mesh.triangles, [[0, 0, 0], [1, 1, 1]]) and mesh.radii == pytest.approx(0.01)
    assert any("“Cloud”" in line and "1 points" in line for line in scene.warnings)


def test_the_shape_of_curves_is_the_scene_s():
    settings = bpy.context.scene.cycles_curves
    settings.shape, settings.subdivisions = "RIBBONS", 1
    points = [(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 2, 4)]
    add_curves(points, [4])
    scene = exported()
    assert scene.meshes[0].ribbons and len(scene.meshes[0].triangles) == 6 and scene.warnings == ()
    settings.shape = "THICK"
    assert not exported().meshes[0].ribbons and len(exported().meshes[0].triangles) > 6


def test_ellipses_of_curves_know_the_normals_of_their_points():
    hair = add_curves([(0, 0, 0), (0, 0, 1), (0, 1, 2)], [3])
    material = bpy.data.materials.new("Hair")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    node.model = "HUANG"
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    hair.data.materials.append(material)
    scene = exported()
    (normals,) = (each.values for each in scene.meshes[0].attributes if each.name == "normal")
    assert normals.shape[1:] == (3, 3) and np.linalg.norm(normals, axis=2) == pytest.approx(1, abs=0.3)


def test_particle_hair_has_colors_and_maps_of_its_emitter():
    ground = add_grid("Ground", 2)
    colors = ground.data.color_attributes.new("Tint", "BYTE_COLOR", "CORNER").data
    colors.foreach_set("color", [0.5, 0.25, 0.75, 1.0] * len(colors))
    first = ground.data.uv_layers[0] if ground.data.uv_layers else ground.data.uv_layers.new(name="First")
    near = np.random.default_rng(1).random(2 * len(first.uv)).astype(np.float32)
    first.uv.foreach_set("vector", near)
    ground.data.uv_layers.new(name="Second").uv.foreach_set("vector", near + np.float32(10))
    material = bpy.data.materials.new("Hair")
    material.use_nodes = True  # before Blender 5 a choice
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tint, second, plain = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("VertexColor", "UVMap", "TexCoord"))
    tint.layer_name, second.uv_map = "Tint", "Second"
    tree.links.new(tint.outputs["Color"], shader.inputs["Base Color"])
    tree.links.new(second.outputs["UV"], shader.inputs["Roughness"])
    tree.links.new(plain.outputs["UV"], shader.inputs["Metallic"])
    ground.data.materials.append(material)
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 7
    scene = exported()
    hair = next(mesh for mesh in scene.meshes if mesh.radii is not None)
    values = {each.name: each.values for each in hair.attributes}
    assert values["Tint"] == pytest.approx(np.tile([0.5, 0.25, 0.75, 1], (len(hair.triangles), 1)), abs=0.01)
    assert values["Second"] == pytest.approx(hair.corner_uvs[:, 0] + 10, abs=1e-4) and np.ptp(values["Second"]) > 0.1
    assert not [line for line in scene.warnings if "Ground" in line]


def test_values_of_strands_that_are_no_numbers_become_0_and_are_counted():
    hair = add_curves([(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1)], [2, 2])
    hair.data.attributes.new("odd", "FLOAT", "CURVE").data.foreach_set("value", np.float32([np.inf, 3.0]))
    tree, surface = node_tree(material_of(hair))
    read = tree.nodes.new("ShaderNodeAttribute")
    read.attribute_name = "odd"
    tree.links.new(read.outputs["Color"], surface)
    got = exported()
    (attribute,) = got.meshes[0].attributes
    assert set(attribute.values.ravel().tolist()) == {0, 3}
    (said,) = [text for text in got.warnings if "not finite" in text]
    assert "“odd”" in said and "“Hair”" in said and said.objects == ("Hair",)
