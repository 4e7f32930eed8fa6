"""Edits of which Blender tells less than they change."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export.live.live_scene import LiveScene
from tests.blender.viewport.reader import as_exported
from tests.blender.viewport.regions import view_space
from tests.support.blender_builders import add_object


def animated(tree, _objects):
    socket = tree.nodes["Diffuse"].inputs["Color"]
    for frame, value in ((1, 0.2), (10, 0.9)):
        socket.default_value = (value, 0, 0, 1)
        socket.keyframe_insert("default_value", frame=frame)


def placed(tree, objects):
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    coordinates.object = objects[2]
    tree.links.new(coordinates.outputs["Object"], tree.nodes["Diffuse"].inputs["Color"])


def looked_up(tree, _objects):
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_type, attribute.attribute_name = "VIEW_LAYER", "level"
    tree.links.new(attribute.outputs["Fac"], tree.nodes["Diffuse"].inputs["Roughness"])


@pytest.mark.parametrize("change", [animated, placed, looked_up])
def test_a_material_that_can_be_kept_no_longer_stays_as_it_became(reader, objects, change):
    tree = objects[0].data.materials[0].node_tree
    reader.edit(lambda: change(tree, objects))
    assert as_exported(reader.live)
    reader.edit(lambda: setattr(bpy.data.lights["Light"], "energy", 5))
    assert as_exported(reader.live)


@pytest.mark.parametrize("name, expression", [("hide_viewport", "frame > 5"), ("pass_index", "frame")])
def test_an_object_that_is_driven_is_not_moved_alone(reader, objects, scene, name, expression):
    def drive():
        objects[1].driver_add("location", 1).driver.expression = "frame"
        objects[1].driver_add(name).driver.expression = expression
        tree = objects[1].data.materials[0].node_tree
        info = tree.nodes.new("ShaderNodeObjectInfo")
        tree.links.new(info.outputs["Object Index"], tree.nodes["Diffuse"].inputs["Roughness"])

    reader.edit(drive)
    bpy.app.handlers.frame_change_post.append(receive := lambda _scene, graph: reader.receive(graph))
    try:
        for frame in (2, 9, 4):
            scene.frame_set(frame)
            assert as_exported(reader.live)
    finally:
        bpy.app.handlers.frame_change_post.remove(receive)


def test_another_frame_reads_more_than_places(reader, scene):
    """Images may change with it."""
    reader.edit(lambda: setattr(scene.camera.driver_add("location", 1).driver, "expression", "frame"))
    before = reader.live.counts["passes"]
    bpy.app.handlers.frame_change_post.append(receive := lambda _scene, graph: reader.receive(graph))
    try:
        scene.frame_set(7)
    finally:
        bpy.app.handlers.frame_change_post.remove(receive)
    assert reader.live.counts["passes"] == before + 1


def test_local_collections_show_what_is_in_them(objects):
    space, live = view_space(), LiveScene()
    space.use_local_collections = True
    try:
        objects[0].location.z = 1
        bpy.context.view_layer.update()
        live.look_again()
        live.read(bpy.context.evaluated_depsgraph_get(), space, 10.0)
        assert len(live.scene.instances) == 3
    finally:
        space.use_local_collections = False


def test_many_instances_are_read_in_few_slices(scene, objects):
    collection = bpy.data.collections.new("Shared")
    for number in range(300):
        each = bpy.data.objects.new(f"Shared {number}", objects[0].data)
        collection.objects.link(each)
    for number in range(40):
        place = add_object(f"Place {number}", None)
        place.instance_type, place.instance_collection = "COLLECTION", collection
    live, depsgraph = LiveScene(), bpy.context.evaluated_depsgraph_get()
    while not live.is_current:
        live.read(depsgraph, None, 1e-6)
        assert live.counts["slices"] < 3000, "it is found again and again"
    assert len(live.scene.instances) == 40 * 300 + 3
