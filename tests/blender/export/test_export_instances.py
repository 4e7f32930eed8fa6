"""Objects, instances and their visibility, exported to the core."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix

from raybatch_addon.core.scene.description import ALL_LIGHT_SETS, COPY_SET, Visibility
from raybatch_addon.core.scene.linking import catcher_bits, catchers
from raybatch_addon.core.scene.passes import CATCHER_PASS, CATCHER_SHADOWS
from raybatch_addon.export.meshes.placements import is_singular, row_bytes
from raybatch_addon.export.scene import export_scene
from tests.support.blender_builders import add_grid, add_object, add_triangle, exported, material_of

pytestmark = pytest.mark.usefixtures("scene")


def add_collection(scene, name, *objects):
    """A collection that is not in the scene itself."""
    collection = bpy.data.collections.new(name)
    for obj in objects:
        scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
    return collection


def instancer(collection, location=(0, 0, 0)):
    empty = add_object("Empty", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, location
    return empty


def instance_on_points(host, group_object):
    """A geometry-nodes modifier that puts an instance of `group_object` on every vertex of `host`."""
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    start, end = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    scatter, source = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = group_object
    source.inputs["As Instance"].default_value = True
    link(start.outputs[0], scatter.inputs["Points"])
    link(source.outputs["Geometry"], scatter.inputs["Instance"])
    link(scatter.outputs[0], end.inputs[0])
    host.modifiers.new("Scatter", "NODES").node_group = group


def test_linked_duplicates_share_a_mesh_and_keep_their_matrices():
    first = add_triangle()
    second = add_object("Second", first.data)
    second.matrix_world = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.5, 4, "Z") @ Matrix.Diagonal((2, 3, -4, 1))
    scene = exported()
    assert len(scene.meshes) == 1
    assert scene.instances.mesh.tolist() == [0, 0]
    assert scene.instances.transform[1] == pytest.approx(np.array(second.matrix_world)[:3], abs=1e-6)
    assert scene.instances.transform.dtype == np.float32
    assert [scene.object_names[i] for i in scene.instances.object] == ["Triangle", "Second"]


def test_objects_of_one_mesh_with_other_modifiers_have_other_meshes():
    first = add_triangle()
    add_object("Second", first.data).modifiers.new("Solid", "SOLIDIFY")
    scene = exported()
    assert sorted(len(mesh.triangles) for mesh in scene.meshes) == [1, 8]


def test_collection_instances_are_instances(scene):
    triangle = add_triangle()
    collection = add_collection(scene, "Group", triangle)
    triangle.location = (0, 0, 5)
    for x in range(3):
        instancer(collection, (x, 0, 0))
    got = exported()
    assert len(got.meshes) == 1 and len(got.instances) == 3
    assert sorted(got.instances.transform[:, :, 3].tolist()) == [[0, 0, 5], [1, 0, 5], [2, 0, 5]]


def test_geometry_nodes_instances_are_instances(scene):
    triangle = add_triangle("Leaf")
    add_collection(scene, "Hidden", triangle)
    instance_on_points(add_grid("Host", 4), triangle)
    got = exported()
    assert [len(mesh.triangles) for mesh in got.meshes] == [1]
    assert len(got.instances) == 25
    assert got.warnings == ()


def test_particles_are_instances(scene):
    triangle = add_triangle("Leaf")
    add_collection(scene, "Hidden", triangle)
    emitter = add_grid("Emitter", 2)
    emitter.modifiers.new("Particles", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.count, settings.frame_start, settings.frame_end = 7, 0, 0
    settings.render_type, settings.instance_object = "OBJECT", triangle
    emitter.show_instancer_for_viewport = emitter.show_instancer_for_render = False
    scene.frame_set(2)
    got = exported()
    assert len(got.meshes) == 1 and len(got.instances) == 7, "particles, without their emitter"


def test_ten_thousand_instances_cost_one_mesh_and_a_matrix_each(scene):
    grid = add_grid("Leaf", 71)
    add_collection(scene, "Hidden", grid)
    instance_on_points(add_grid("Host", 99), grid)
    got = exported()
    assert len(got.instances) == 10_000
    assert [len(mesh.triangles) for mesh in got.meshes] == [2 * 71 * 71]
    assert len(got.slot_materials) == 1
    arrays = vars(got.instances).values()
    assert sum(array.nbytes for array in arrays if array is not None) <= 10_000 * 64


@pytest.mark.parametrize("ray", ["camera", "diffuse", "glossy", "transmission", "shadow", "volume_scatter"])
def test_ray_visibility(ray):
    obj = add_triangle()
    setattr(obj, f"visible_{ray}", False)
    (visibility,) = exported().instances.visibility
    assert visibility == Visibility.ALL & ~Visibility[ray.upper()]


def test_instances_are_seen_by_rays_that_see_the_object_and_its_instancer(scene):
    triangle = add_triangle()
    triangle.visible_shadow = False
    empty = instancer(add_collection(scene, "Group", triangle))
    empty.visible_camera = False
    (visibility,) = exported().instances.visibility
    assert visibility == Visibility.ALL & ~Visibility.SHADOW & ~Visibility.CAMERA


def test_geometry_offsets_are_those_of_objects_whose_meshes_are_smooth():
    flat, smooth = add_triangle(), add_grid("Smooth", 1)
    assert exported().instances.terminator is None
    for polygon in smooth.data.polygons:
        polygon.use_smooth = True
    flat.shadow_terminator_geometry_offset = smooth.shadow_terminator_geometry_offset = 0.25
    scene = exported()
    cutoffs = dict(
        zip((scene.object_names[i] for i in scene.instances.object), scene.instances.terminator, strict=True)
    )
    assert cutoffs == {flat.name: 0.0, "Smooth": 0.25}


def test_hidden_and_excluded_objects_are_left_out(scene):
    add_triangle("Hidden").hide_render = True
    excluded = add_triangle("Excluded")
    collection = add_collection(scene, "Out", excluded)
    scene.collection.children.link(collection)
    scene.view_layers[0].layer_collection.children["Out"].exclude = True
    add_triangle("Seen")
    assert exported().object_names == ("Seen",)


def test_indirect_only_collections_are_not_seen_by_the_camera(scene):
    collection = add_collection(scene, "Indirect", add_triangle())
    scene.collection.children.link(collection)
    scene.view_layers[0].layer_collection.children["Indirect"].indirect_only = True
    (visibility,) = exported().instances.visibility
    assert visibility == Visibility.ALL & ~Visibility.CAMERA


def test_filters_and_material_override_of_a_view_layer(scene):
    obj = add_triangle()
    material_of(obj, "own")
    layer = scene.view_layers[0]
    layer.material_override = bpy.data.materials.new("clay")
    assert [material.name for material in exported().materials] == ["clay"]
    layer.use_solid = layer.use_sky = False
    scene.world = bpy.data.worlds.new("World")
    got = exported()
    assert len(got.instances) == 0 and got.world.radiance == (0, 0, 0)


def test_materials_of_objects_and_of_their_mesh():
    first = add_triangle()
    material_of(first, "of the mesh")
    second = add_object("Second", first.data)
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = bpy.data.materials.new("of the object")
    add_object("Third", first.data)
    scene = exported()
    assert len(scene.meshes) == 1
    names = [scene.materials[scene.slot_materials[slot]].name for slot in scene.instances.slot_first]
    assert names == ["of the mesh", "of the object", "of the mesh"]


def test_slots_of_several_materials_lie_side_by_side():
    obj = add_triangle()
    material_of(obj, "a")
    obj.data.materials.append(None)
    material_of(obj, "c")
    scene = exported()
    (first,) = scene.instances.slot_first
    names = [scene.materials[index].name for index in scene.slot_materials[first : first + 3]]
    assert names == ["a", "default", "c"]


def test_objects_scaled_to_nothing_are_left_out_by_name():
    add_triangle("Good")
    add_triangle("Flat").scale = (1, 0, 1)
    parent, child = add_object("Parent", None), add_triangle("Child")
    parent.rotation_euler, parent.scale = (0.3, 0.7, 0.1), (1, 1, 0)
    child.parent = parent
    child.rotation_euler = (0.2, 0.5, 0.9)
    scene = exported()
    assert [scene.object_names[i] for i in scene.instances.object] == ["Good"]
    assert len(scene.warnings) == 2
    for name in ("Flat", "Child"):
        assert any(f"“{name}”" in warning and "scale" in warning for warning in scene.warnings)


def test_objects_that_are_nowhere_are_left_out_by_name():
    add_triangle("Good")
    lost = add_triangle("Lost")
    lost.matrix_world = Matrix(((1, 0, 0, math.nan), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    scene = exported()
    assert [scene.object_names[i] for i in scene.instances.object] == ["Good"]
    (warning,) = scene.warnings
    assert "“Lost”" in warning and "not finite" in warning


def test_small_and_stretched_objects_are_not_taken_for_singular():
    turn = np.array(Matrix.Rotation(0.7, 4, "X") @ Matrix.Rotation(1.1, 4, "Y"))[:3]
    for scale in ((1e-12, 1e-12, 1e-12), (1, 1, 1e-9), (1e6, 1, 1e-6)):
        assert not is_singular((turn @ np.diag([*scale, 1])).astype(np.float32)[None])[0]
    for scale in ((1, 1, 0), (0, 0, 0)):
        assert is_singular((turn @ np.diag([*scale, 1])).astype(np.float32)[None])[0]


def test_what_is_not_supported_is_listed_by_name(scene):
    add_object("Smoke", bpy.data.volumes.new("Smoke"))
    scene.render.use_motion_blur = True
    text = "\n".join(exported().warnings)
    for name in ("“Smoke”", "sharp"):
        assert name in text


def test_shadow_catchers_have_bits_of_their_own_and_ask_for_a_pass(scene):
    add_triangle("Catcher").is_shadow_catcher = True
    add_triangle("Hidden").is_shadow_catcher, bpy.data.objects["Hidden"].visible_shadow = True, False
    add_triangle("Other")
    got = exported()
    seen = dict(zip((got.object_names[i] for i in got.instances.object), got.instances.visibility.tolist()))
    all_bits, unshaded = int(Visibility.ALL), int(Visibility.ALL) & ~int(Visibility.SHADOW)
    assert seen == {
        "Catcher": all_bits | catcher_bits(all_bits),
        "Hidden": unshaded | catcher_bits(unshaded),
        "Other": all_bits,
    }
    assert CATCHER_SHADOWS in got.frame.passes and got.warnings == ()
    scene.view_layers[0].cycles.use_pass_shadow_catcher = True
    lamp = add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    got = exported()
    assert got.frame.passes == ("Combined", CATCHER_PASS) and got.warnings == ()
    lamp.is_shadow_catcher = False
    got = exported()
    assert got.lights[0].light_sets == ALL_LIGHT_SETS & ~(1 << COPY_SET) and got.warnings == ()
    for obj in bpy.data.objects:
        obj.is_shadow_catcher = False
    assert exported().lights[0].light_sets == ALL_LIGHT_SETS


def test_instances_of_a_catcher_catch_and_a_holdout_of_one_is_a_hole(scene):
    tiles = add_collection(scene, "Tiles", add_triangle("Tile"))
    for catches in (True, False):
        instancer(tiles).is_shadow_catcher = catches
    assert sorted(catchers(exported())) == [False, True]
    add_triangle("Hole").is_shadow_catcher = bpy.data.objects["Hole"].is_holdout = True
    got = exported()
    camera = (got.instances.visibility & int(Visibility.CAMERA)) != 0
    is_hole = np.array([got.object_names[i] == "Hole" for i in got.instances.object])
    assert (catchers(got) & is_hole).tolist() == (is_hole & ~camera).tolist()


def test_a_holdout_object_is_a_hole_for_the_camera_alone(scene):
    add_triangle("Hole").is_holdout = True
    got = exported()
    seen = {
        int(bits): got.materials[got.slot_materials[slot]].name
        for bits, slot in zip(got.instances.visibility, got.instances.slot_first)
    }
    assert seen == {int(Visibility.ALL & ~Visibility.CAMERA): "default", int(Visibility.CAMERA): "holdout"}
    assert got.warnings == ()


def test_a_holdout_object_blocks_light_as_its_shadow_set_says(scene):
    hole, lamp = add_triangle("Hole"), add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.light_linking.blocker_collection = add_collection(scene, "Blockers")
    lamp.light_linking.blocker_collection.objects.link(hole)
    linked = exported().instances.visibility.tolist()
    hole.is_holdout = True
    bits = {each & ~int(Visibility.ALL) for each in exported().instances.visibility.tolist()}
    assert linked[0] & ~int(Visibility.ALL) in bits - {0}


def test_lights_are_exported_and_instanced(scene):
    lamp = add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    collection = add_collection(scene, "Group", lamp)
    for x in range(2):
        instancer(collection, (x, 0, 0))
    got = exported()
    assert sorted(light.transform[0, 3] for light in got.lights) == [0, 1]


def test_an_empty_scene_has_its_world(scene):
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.1, 0.2, 0.3)
    got = exported()
    assert got.meshes == () and len(got.instances) == 0 and len(got.lights) == 0
    assert max(got.world.radiance) > 0


def test_an_export_can_be_cancelled():
    add_triangle()
    assert export_scene(bpy.context.evaluated_depsgraph_get(), cancelled=lambda: True) is None


def test_what_is_another_behind_clear_glass_is_said(scene):
    obj = add_triangle()
    scene.render.film_transparent = scene.cycles.film_transparent_glass = True

    def said():
        return any("Transparent Glass" in line for line in exported().warnings)

    assert not said()
    obj.is_holdout = True
    assert said()


def test_border_passes_and_alpha_of_the_frame(scene):
    render, layer = scene.render, scene.view_layers[0]
    render.resolution_x, render.resolution_y, render.resolution_percentage = 333, 99, 50
    render.film_transparent = True
    layer.use_pass_z = layer.use_pass_normal = True
    frame = exported().frame
    assert (frame.width, frame.height, frame.border, frame.transparent) == (166, 49, None, True)
    assert frame.glass_roughness is None
    scene.cycles.film_transparent_glass, scene.cycles.film_transparent_roughness = True, 0.25
    assert exported().frame.glass_roughness == 0.25
    assert frame.passes == ("Combined", "Depth", "Normal")
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.5, 0.1, 0.9
    assert exported().frame.border == (41, 4, 83, 44)


def test_matrices_are_read_row_by_row():
    matrix = Matrix([[float(4 * row + column) for column in range(4)] for row in range(4)])
    rows = np.arange(16, dtype=np.float32).tobytes()
    assert row_bytes(matrix) == rows
    assert row_bytes([list(row) for row in matrix]) == rows, "as from a Blender whose matrices give no view"
