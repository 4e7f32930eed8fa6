"""What is read of a scene for each kind of edit, and that what is read is the scene as an export has it."""

from collections import Counter

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export.live.edits import Edits, Update
from raybatch_addon.export.live.live_scene import LiveScene, is_same
from tests.blender.viewport.reader import Reader, as_exported
from tests.blender.viewport.regions import view_space
from tests.support.blender_builders import add_grid, add_object


def test_the_first_reading_reads_all(reader):
    assert reader.live.counts == Counter(passes=1, meshes=3, materials=3, scenes=1)
    assert as_exported(reader.live)


def test_a_place_is_read_alone(reader, objects):
    def move():
        objects[1].location.y += 2

    assert reader.edit(move) == Counter(places=1, scenes=1)
    assert as_exported(reader.live)


def test_places_of_parents_move_their_children(reader, objects):
    empty = add_object("Empty", None)
    objects[0].parent = objects[2].parent = empty
    reader.edit(lambda: None)

    def move():
        empty.location.z = 1

    found = reader.edit(move)
    assert found["meshes"] == 0 and found["scenes"] == 1
    assert as_exported(reader.live)


def test_the_value_of_a_node_is_read_alone(reader, objects):
    shader = objects[1].data.materials[0].node_tree.nodes["Diffuse"]

    def change():
        shader.inputs["Color"].default_value = (0.1, 0.2, 0.3, 1)

    meshes = reader.live.scene.meshes
    assert reader.edit(change) == Counter(passes=1, materials=1, scenes=1)
    assert reader.live.scene.meshes[1].positions is meshes[1].positions
    assert as_exported(reader.live)


def test_a_graph_is_read_alone(reader, objects):
    tree = objects[1].data.materials[0].node_tree

    def change():
        noise = tree.nodes.new("ShaderNodeTexNoise")
        tree.links.new(noise.outputs[0], tree.nodes["Diffuse"].inputs["Color"])

    found = reader.edit(change)
    assert found["meshes"] == 0 and found["scenes"] == 1 and 1 <= found["materials"] <= 3
    assert as_exported(reader.live)


def test_a_mesh_is_read_alone(reader, objects):
    def change():
        objects[2].data.vertices[0].co.z += 1
        objects[2].data.update()

    assert reader.edit(change) == Counter(passes=1, meshes=1, scenes=1)
    assert as_exported(reader.live)


def test_a_modifier_reads_its_object_again(reader, objects):
    def change():
        objects[0].modifiers.new("Array", "ARRAY")

    found = reader.edit(change)
    assert found["meshes"] == 1 and found["scenes"] == 1
    assert as_exported(reader.live)


def test_a_light_and_a_world_read_no_mesh_and_no_material(reader, scene):
    def light():
        bpy.data.lights["Light"].energy = 5

    def world():
        scene.world.color = (1, 0, 0)
        if scene.world.node_tree:
            scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 0, 0, 1)

    for change in (light, world):
        assert reader.edit(change) == Counter(passes=1, scenes=1)
        assert as_exported(reader.live)


def test_hiding_and_showing_read_no_mesh_that_stayed(reader, objects):
    assert reader.edit(lambda: objects[0].hide_set(True)) == Counter(passes=1, scenes=1)
    assert len(reader.live.scene.meshes) == 2 and as_exported(reader.live)
    found = reader.edit(lambda: objects[0].hide_set(False))
    assert found["meshes"] == 1 and found["scenes"] == 1
    assert as_exported(reader.live)


def test_what_changes_nothing_makes_no_new_scene(reader, objects):
    found = reader.edit(lambda: objects[0].select_set(True))
    assert found["meshes"] == found["materials"] == found["scenes"] == 0


def test_a_camera_reads_nothing(reader, scene):
    def move():
        scene.camera.location.x = 1

    assert reader.edit(move) == Counter()


def test_a_camera_that_looks_otherwise_reads_nothing_but_the_list(reader, scene):
    found = reader.edit(lambda: setattr(scene.camera.data, "lens", 20))
    assert not {"meshes", "materials", "scenes"} & found.keys()


def test_a_group_that_materials_share_reads_these_materials(reader, objects):
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    color, output = group.nodes.new("ShaderNodeRGB"), group.nodes.new("NodeGroupOutput")
    group.links.new(color.outputs[0], output.inputs[0])

    def use():
        for obj in objects[:2]:
            tree = obj.data.materials[0].node_tree
            node = tree.nodes.new("ShaderNodeGroup")
            node.node_tree = group
            tree.links.new(node.outputs[0], tree.nodes["Diffuse"].inputs["Color"])

    def change():
        color.outputs[0].default_value = (0.9, 0.1, 0.2, 1)

    reader.edit(use)
    assert as_exported(reader.live)
    found = reader.edit(change)
    assert found["meshes"] == 0 and found["materials"] >= 2 and found["scenes"] == 1
    assert as_exported(reader.live)


def test_edits_that_come_faster_than_slices_do_not_put_it_off(objects):
    """Edits come like this while an animation plays."""
    reader, depsgraph = LiveScene(), bpy.context.evaluated_depsgraph_get()
    for _ in range(20):
        reader.note([Update("Scene", 1)])
        reader.read(depsgraph, None, 1e-3)
        if reader.scene is not None:
            return
    raise AssertionError("no pass came to its end")


def test_an_object_that_goes_and_one_that_comes(reader, objects):
    def remove():
        bpy.data.objects.remove(objects[1])

    assert reader.edit(remove)["meshes"] <= 2
    assert len(reader.live.scene.instances) == 2 and as_exported(reader.live)
    reader.edit(lambda: add_grid("New", 5))
    assert len(reader.live.scene.instances) == 3 and as_exported(reader.live)


def test_places_that_a_graph_reads_are_no_places_alone(reader, objects):
    tree = objects[0].data.materials[0].node_tree

    def look():
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        coordinates.object = objects[1]
        tree.links.new(coordinates.outputs["Object"], tree.nodes["Diffuse"].inputs["Color"])

    def move():
        objects[1].location.z = 2

    reader.edit(look)
    assert reader.edit(move)["passes"] == 1
    assert as_exported(reader.live)


def test_many_meshes_are_read_in_slices(objects):
    """One mesh a slice where time is short; what the slices read together is the scene."""
    live, depsgraph, slices = LiveScene(), bpy.context.evaluated_depsgraph_get(), 0
    while not live.is_current:
        before = live.counts["meshes"]
        is_new = live.read(depsgraph, None, 0.0)
        assert live.counts["meshes"] - before <= 1
        assert is_new == live.is_current
        slices += 1
    assert slices >= 3 and live.counts == Counter(passes=1, meshes=3, materials=3, scenes=1, slices=slices - 1)
    assert as_exported(live)


def test_nothing_of_blenders_is_kept_between_slices(objects):
    live, depsgraph = LiveScene(), bpy.context.evaluated_depsgraph_get()
    while live.counts["meshes"] < 2:
        live.read(depsgraph, None, 0.0)
    assert not live.is_current
    seen, left = set(), [live]
    while left:
        each = left.pop()
        if id(each) in seen or isinstance(each, (type, type(bpy), str, bytes, int, float, np.ndarray)):
            continue
        seen.add(id(each))
        assert not isinstance(each, bpy.types.bpy_struct), each
        if isinstance(each, dict):
            left += [*each.keys(), *each.values()]
        elif isinstance(each, (list, tuple, set, frozenset)):
            left += list(each)
        elif type(each).__module__.startswith("raybatch_addon"):
            left += [vars(each)] if hasattr(each, "__dict__") else []
    assert len(seen) > 50


def test_an_edit_between_slices_is_seen(objects):
    reader = Reader(seconds=0.0)
    reader.live.read(bpy.context.evaluated_depsgraph_get(), None, 0.0)

    def change():
        objects[0].data.vertices[0].co.z += 1
        objects[0].data.update()

    reader.edit(change)
    assert as_exported(reader.live)


def test_a_space_shows_what_it_shows(reader):
    space = view_space()
    space.show_object_viewport_mesh = False
    try:
        reader.live.look_again()
        reader.live.read(bpy.context.evaluated_depsgraph_get(), space, 10.0)
        assert len(reader.live.scene.instances) == 0 and len(reader.live.scene.lights) == 1
    finally:
        space.show_object_viewport_mesh = True


def test_what_renders_hide_a_viewport_shows(reader, objects):
    def hide():
        objects[0].hide_render = True

    reader.edit(hide)
    assert len(reader.live.scene.instances) == 3


def test_instances_of_a_collection_are_placed_with_it(scene, objects):
    collection = bpy.data.collections.new("Shared")
    collection.objects.link(objects[0])
    places = [add_object(f"Place {number}", None) for number in range(2)]
    for number, place in enumerate(places):
        place.instance_type, place.instance_collection = "COLLECTION", collection
        place.location = (0, 3 + number, 0)
    reader = Reader()
    reader.read(bpy.context.evaluated_depsgraph_get())

    def move():
        places[0].location.z = 4

    assert reader.edit(move)["meshes"] == 0
    assert as_exported(reader.live)


def test_kinds_of_edits_are_distinguished():
    edits = Edits(any_material=False)
    edits.add([Update("Object", 1, transform=True)])
    assert edits.moved == {1} and not edits.is_whole and not edits.any_material
    edits.add([Update("Material", 2, shading=True), Update("ShaderNodeTree", 3), Update("Object", 1, shading=True)])
    assert edits.is_whole and edits.materials == {2} and not edits.any_material and not edits.reshaped
    edits.add([Update("Object", 4, geometry=True), Update("Mesh", 5, geometry=True)])
    assert edits.reshaped == {4, 5}
    edits.clear()
    assert not edits
    edits.add([Update("ShaderNodeTree", 3)])  # a group of its own
    assert edits.any_material
    edits.clear()
    edits.add([Update("Image", 3)])
    assert edits.any_material


def test_descriptions_are_compared_by_what_they_say(reader):
    assert is_same(np.arange(3), np.arange(3)) and not is_same(np.arange(3), np.arange(3.0))
    assert is_same({"a": (1, [2])}, {"a": (1, [2])}) and not is_same({"a": 1}, {"b": 1})
    assert is_same(reader.live.scene, reader.live.scene)
