"""A viewport while its file is edited as people do: undone and redone, deleted, in other modes, in other scenes and
files. Each time its picture is that of a viewport that has just been opened.
"""

import random

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
import bmesh

from tests.blender.viewport.regions import region_context
from tests.blender.viewport.shown import Shown, edit
from tests.support.blender_builders import add_grid, add_object, material_of, node_tree


def assert_as_fresh(shown):
    """The picture is the one of a new viewport, and so is what is said of it."""
    fresh = Shown(shown.context)
    try:
        shown.until(shown.is_finished)
        fresh.update(bpy.context.evaluated_depsgraph_get())
        fresh.until(fresh.is_finished)
        assert shown.viewport.status() == fresh.viewport.status()
        own, new = shown.viewport.render.picture, fresh.viewport.render.picture
        assert own.samples == new.samples == 4
        assert np.array_equal(own.pixels, new.pixels)
    finally:
        fresh.viewport.close()
        assert fresh.viewport.render.join(60)
    return own.pixels


def assert_other(pixels, before):
    assert not np.array_equal(pixels, before)


def raised(height):
    """Move a vertex that the picture shows."""
    data = bpy.data.objects["Grid"].data
    data.vertices[20].co.xz = height, height
    data.update()


def add_shining(name, location):
    obj = add_grid(name, 3)
    obj.location = location
    tree, surface = node_tree(material_of(obj, f"Material of {name}"))
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (0.1, 0.9, 0.3, 1)
    tree.links.new(shader.outputs[0], surface)
    return obj


@pytest.fixture
def two(shown):
    """Another shining grid, and a light that a third one reflects."""
    add_shining("Other", (1, -2, 0.5))
    add_grid("Grey", 3).location = (-1, 1, 0.2)
    light = add_object("Light", bpy.data.lights.new("Light", "POINT"))
    light.location, light.data.energy = (0, 1, 3), 200
    bpy.context.view_layer.update()
    shown.until(shown.is_finished)
    return shown


def emission():
    return bpy.data.materials["Material of Other"].node_tree.nodes["Emission"].inputs["Strength"]


STEPS = {
    "mesh": lambda: raised(height=random.random()),
    "place": lambda: setattr(bpy.data.objects["Other"].location, "x", random.random()),
    "material": lambda: setattr(emission(), "default_value", random.random()),
    "light": lambda: setattr(bpy.data.lights["Light"], "energy", 500 * random.random()),
    "deletion": lambda: bpy.data.objects.remove(bpy.data.objects["Grey"]),
    "new mesh": lambda: add_shining("New", (0, 0.5, 0.3)),
    "modifier": lambda: bpy.data.objects["Grid"].modifiers.new("Row", "ARRAY"),
    "assigned": lambda: setattr(bpy.data.objects["Other"], "data", bpy.data.objects["Grid"].data),
    "many vertices": lambda: bpy.data.objects["Grid"].modifiers.new("Finer", "SUBSURF"),
}


def test_what_is_undone_and_redone_is_shown(two):
    random.seed(1)
    pictures = [assert_as_fresh(two)]
    bpy.ops.ed.undo_push(message="begun")
    for name, step in STEPS.items():
        edit(step)
        bpy.ops.ed.undo_push(message=name)
        pictures.append(assert_as_fresh(two))
        assert not np.array_equal(*pictures[-2:]), name
    for before in reversed(pictures[:-1]):
        bpy.ops.ed.undo()
        bpy.context.view_layer.update()
        assert np.array_equal(assert_as_fresh(two), before)
    for after in pictures[1:]:
        bpy.ops.ed.redo()
        bpy.context.view_layer.update()
        assert np.array_equal(assert_as_fresh(two), after)
    for _ in range(6):  # many at once, as in Blender's list of them
        back = random.randrange(1, len(STEPS))
        for _ in range(back):
            bpy.ops.ed.undo()
        assert np.array_equal(assert_as_fresh(two), pictures[len(STEPS) - back])
        for _ in range(back):
            bpy.ops.ed.redo()
        assert np.array_equal(assert_as_fresh(two), pictures[-1])


def test_what_is_undone_while_it_is_read_and_rendered_is_shown(two):
    random.seed(2)
    before = assert_as_fresh(two)
    bpy.ops.ed.undo_push(message="begun")
    for _ in range(5):
        edit(lambda: raised(height=random.random()))
        edit(STEPS["material"])
        two.draw()
        bpy.ops.ed.undo_push(message="edited")
        bpy.ops.ed.undo()
        two.draw()
    assert np.array_equal(assert_as_fresh(two), before)


DELETED = {
    "material": lambda: bpy.data.materials.remove(bpy.data.materials["Material of Other"]),
    "mesh": lambda: bpy.data.meshes.remove(bpy.data.objects["Other"].data),
    "light": lambda: bpy.data.lights.remove(bpy.data.lights["Light"]),
    "object": lambda: bpy.data.objects.remove(bpy.data.objects["Grid"]),
    "collection": lambda: bpy.data.collections.remove(bpy.data.collections["Kept"]),
    "all": lambda: bpy.data.batch_remove([*bpy.data.meshes, *bpy.data.lights, *bpy.data.materials]),
}


@pytest.mark.parametrize("kind", DELETED)
def test_what_is_deleted_in_use_is_gone(two, kind):
    kept = bpy.data.collections.new("Kept")
    bpy.context.scene.collection.children.link(kept)
    for collection in (kept, bpy.context.scene.collection):
        change = collection.objects.link if collection is kept else collection.objects.unlink
        edit(lambda change=change: change(bpy.data.objects["Other"]))
    before = assert_as_fresh(two)
    edit(lambda: raised(height=2))  # a render is under way
    two.draw()
    edit(lambda: raised(height=0))
    edit(DELETED[kind])
    assert_other(assert_as_fresh(two), before)


def test_a_world_that_is_deleted_is_gone(two, lit):
    lit.world = bpy.data.worlds.new("World")
    lit.world.color = (0.2, 0.5, 0.9)
    bpy.context.view_layer.update()
    before = assert_as_fresh(two)
    edit(lambda: bpy.data.worlds.remove(lit.world))
    assert_other(assert_as_fresh(two), before)


def test_a_camera_that_is_deleted_ends_nothing(two, lit):
    two.until(two.is_finished)
    edit(lambda: bpy.data.objects.remove(lit.camera))
    two.context.region.data.view_perspective = "PERSP"  # as Blender does
    assert_as_fresh(two)


@pytest.fixture
def active(two):
    obj = bpy.data.objects["Grid"]
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    yield two
    if bpy.context.object:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_what_is_edited_in_edit_mode_is_shown_meanwhile_and_after(active):
    pictures = [assert_as_fresh(active)]
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    assert np.array_equal(assert_as_fresh(active), pictures[0])
    data = bpy.data.objects["Grid"].data
    for height in (0.5, 1.5):
        edited = bmesh.from_edit_mesh(data)
        edited.verts.ensure_lookup_table()
        edited.verts[20].co.xz = height, height
        edit(lambda: bmesh.update_edit_mesh(data))
        pictures.append(assert_as_fresh(active))
        assert_other(pictures[-1], pictures[-2])
    edited = bmesh.from_edit_mesh(data)
    edited.faces.ensure_lookup_table()
    bmesh.ops.delete(edited, geom=edited.faces[3:9], context="FACES")
    edit(lambda: bmesh.update_edit_mesh(data))
    pictures.append(assert_as_fresh(active))
    assert_other(pictures[-1], pictures[-2])
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert np.array_equal(assert_as_fresh(active), pictures[-1])


@pytest.mark.parametrize("mode", ["SCULPT", "VERTEX_PAINT", "WEIGHT_PAINT"])
def test_what_is_edited_in_other_modes_is_shown_meanwhile_and_after(active, mode):
    before = assert_as_fresh(active)
    bpy.ops.object.mode_set(mode=mode)
    bpy.context.view_layer.update()
    assert np.array_equal(assert_as_fresh(active), before)
    edit(lambda: raised(height=1.5))
    during = assert_as_fresh(active)
    assert_other(during, before)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    assert np.array_equal(assert_as_fresh(active), during)


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="Blender 4.5 as a module breaks its memory in local view")
def test_local_view_shows_what_is_in_it(two):
    window = bpy.context.window_manager.windows[0]
    area = next(each for each in window.screen.areas if each.type == "VIEW_3D")
    region = next(each for each in area.regions if each.type == "WINDOW")
    two.context.space_data = space = area.spaces.active
    whole = assert_as_fresh(two)
    for obj in bpy.context.scene.objects:
        obj.select_set(obj.name == "Grid")
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.view3d.localview(frame_selected=False)
        try:
            assert space.local_view is not None
            alone = assert_as_fresh(two)
            assert len(two.viewport.live.scene.instances) == 1
            assert_other(alone, whole)
            bpy.data.objects["Other"].local_view_set(space, True)
            bpy.context.view_layer.update()
            assert_other(assert_as_fresh(two), alone)
            assert len(two.viewport.live.scene.instances) == 2
        finally:
            bpy.ops.view3d.localview(frame_selected=False)
    assert np.array_equal(assert_as_fresh(two), whole)


def test_another_scene_in_the_window_is_shown_and_the_first_one_again(two, lit):
    """The same mesh and material are in both, and are edited in each."""
    window, other = bpy.context.window, bpy.data.scenes.new("Second")
    other.render.engine, other.camera = "RAYBATCH", lit.camera
    other.raybatch_viewport.samples = 4
    for obj in (lit.camera, bpy.data.objects["Grid"]):
        other.collection.objects.link(obj)
    first = assert_as_fresh(two)
    for turn in range(2):
        window.scene = other
        second = assert_as_fresh(two)
        assert_other(second, first)
        edit(lambda turn=turn: raised(height=1 + turn))
        assert_other(assert_as_fresh(two), second)
        window.scene = lit
        back = assert_as_fresh(two)
        assert_other(back, first)
        first = back


def test_another_view_layer_in_the_window_is_shown(two, lit):
    hidden = bpy.data.collections.new("Hidden")
    lit.collection.children.link(hidden)
    edit(
        lambda: (
            hidden.objects.link(bpy.data.objects["Other"]),
            lit.collection.objects.unlink(bpy.data.objects["Other"]),
        )
    )
    whole, window, first = assert_as_fresh(two), bpy.context.window, bpy.context.view_layer
    second = lit.view_layers.new("Second")
    second.layer_collection.children["Hidden"].exclude = True
    window.view_layer = second
    assert_other(assert_as_fresh(two), whole)
    window.view_layer = first
    assert np.array_equal(assert_as_fresh(two), whole)


def test_another_engine_and_back_shows_what_was_edited_meanwhile(two, lit):
    before = assert_as_fresh(two)
    edit(lambda: raised(height=1))
    two.draw()
    two.viewport.close()  # as Blender drops the engine
    for engine in ("BLENDER_WORKBENCH", "CYCLES"):
        edit(lambda engine=engine: setattr(lit.render, "engine", engine))
        edit(lambda: raised(height=2))
    assert two.viewport.render.join(60)
    edit(lambda: setattr(lit.render, "engine", "RAYBATCH"))
    again = Shown(region_context())
    again.update(bpy.context.evaluated_depsgraph_get())
    try:
        assert_other(assert_as_fresh(again), before)
    finally:
        again.viewport.close()


@pytest.mark.parametrize("load", ["file", "home file", "empty home file"])
def test_a_file_that_is_loaded_while_a_viewport_renders(two, lit, tmp_path, load):
    path = str(tmp_path / "scene.blend")
    before = assert_as_fresh(two)
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    lit.raybatch_viewport.samples = 10**6
    edit(lambda: raised(height=1))
    two.draw()
    if load == "file":
        bpy.ops.wm.open_mainfile(filepath=path)
    else:
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=load.startswith("empty"))
        scene = bpy.context.scene
        scene.render.engine = "RAYBATCH"
        scene.raybatch_viewport.samples = 4
        if scene.camera is None:
            scene.camera = add_object("Camera", bpy.data.cameras.new("Camera"))
        add_shining("New", (0, 0, -5))
        bpy.context.view_layer.update()
    two.viewport.close()  # as Blender drops the engine
    assert two.viewport.render.join(60) and not two.viewport.render.state.error
    again = Shown(region_context())
    again.update(bpy.context.evaluated_depsgraph_get())
    try:
        pixels = assert_as_fresh(again)
        assert np.array_equal(pixels, before) == (load == "file")
    finally:
        again.viewport.close()
