"""What a render exports of motion: cameras, objects that bend, and the frame's own world."""

import bpy
import numpy as np
import pytest

from raybatch_addon.blender import frame
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.notice import Weight
from raybatch_addon.export.motion.shutter import Exposure
from tests.support.blender_builders import add_grid, add_object

FRAME = 10


class Enough(RayBatchError):
    """Ends a render."""


def rendered_scene(**how):
    """What the engine exports for a render of frame 10, which ends there."""
    taken = []

    def listen(_layer, exported, _settings):
        taken.append(exported)
        raise Enough("enough")

    frame.scene_listeners.append(listen)
    try:
        if not how:
            bpy.context.scene.frame_set(FRAME)
        with pytest.raises(RuntimeError, match="enough"):
            bpy.ops.render.render(**how)
    finally:
        frame.scene_listeners.remove(listen)
    (exported,) = taken
    return exported


@pytest.fixture
def blurred(scene):
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    return scene


def keyed(owner, name, before, after):
    for number, value in ((FRAME - 1, before), (FRAME + 1, after)):
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=number)


def test_a_cut_to_another_camera_is_no_motion(blurred):
    for number, x in ((1, 0.0), (FRAME, 100.0)):
        camera = add_object(f"At {number}", bpy.data.cameras.new("Camera"))
        camera.location.x = x
        blurred.timeline_markers.new(f"{number}", frame=number).camera = camera
    got = rendered_scene().camera
    assert got.motion is None and got.transform[0, 3] == 100


def test_what_its_parent_bends_moves(blurred):
    armature = add_object("Bones", bpy.data.armatures.new("Bones"))
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.data.edit_bones.new("Bone")
    bone.tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    keyed(armature.pose.bones["Bone"], "location", (0, 0, 0), (0, 2, 0))
    bent = add_grid("Bent", 1)
    bent.vertex_groups.new(name="Bone").add([0, 1, 2, 3], 1.0, "REPLACE")
    bent.parent, bent.parent_type = armature, "ARMATURE"
    (mesh,) = rendered_scene().meshes
    assert mesh.motion is not None and np.ptp(mesh.motion[:, 0], axis=0).max() > 0.1


def test_each_thing_that_an_object_is_placed_as_moves(blurred):
    for name in ("Haired", "Hole"):
        keyed(add_grid(name, 1), "location", (0, 0, 0), (2, 0, 0))
    haired = bpy.data.objects["Haired"]
    haired.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = haired.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 3
    bpy.data.objects["Hole"].is_holdout = True
    got = rendered_scene().instances
    assert len(got) == 4  # the hair, its ground, what rays see of the hole, and what the camera does
    maps = got.motion.maps
    assert got.motion.instance.tolist() == [0, 1, 2, 3]
    assert np.allclose(maps[:, [0, -1], 0, 3], maps[0, [0, -1], 0, 3]) and np.ptp(maps[0, :, 0, 3]) > 0.5


def test_no_time_is_evaluated_twice(blurred, monkeypatch):
    keyed(add_grid("Moving", 1), "location", (0, 0, 0), (2, 0, 0))
    times, as_it_is = [], Exposure._set
    monkeypatch.setattr(Exposure, "_set", lambda self, time: times.append(time) or as_it_is(self, time))
    motion = rendered_scene().instances.motion
    assert times == [FRAME - 0.5, FRAME + 0.5, FRAME]
    assert motion.maps[0, 1, 0, 3] == pytest.approx(1, abs=1e-6)


def test_mist_is_that_of_the_frame(scene):
    world = scene.world = bpy.data.worlds.new("World")
    driver = world.mist_settings.driver_add("start").driver
    driver.expression = "frame"
    scene.frame_set(1)
    scene.frame_start = scene.frame_end = FRAME
    assert rendered_scene(animation=True).frame.mist[0] == FRAME


def test_strands_of_a_render_are_whole_and_those_of_a_look_too(scene):
    from tests.support.blender_builders import exported

    ground = add_grid("Ground", 1)
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 5, 1.0
    settings.display_step, settings.render_step = 2, 5
    for got in (exported(), rendered_scene()):
        (hair,) = (mesh for mesh in got.meshes if mesh.radii is not None)
        assert hair.positions[:, 2].min() == pytest.approx(0, abs=1e-4)
        tips = hair.positions[np.setdiff1d(hair.triangles[:, 1], hair.triangles[:, 0])]
        assert len(tips) == 5 and tips[:, 2] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("what", ["motion blur", "Vector"])
def test_what_stands_still_has_no_maps_of_other_times(scene, what):
    if what == "Vector":
        scene.view_layers[0].use_pass_vector = True
    else:
        scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    leaf = add_grid("Leaf", 1)
    placed = add_grid("Meadow", 5)
    placed.instance_type = "VERTS"
    leaf.parent = placed
    keyed(add_grid("Moving", 1), "location", (0, 0, 0), (2, 0, 0))
    got = rendered_scene().instances
    moved = got.frames if what == "Vector" else got.motion
    assert len(got) > 20 and len(moved.instance) == 1
    steps = 2 if what == "Vector" else 3
    assert moved.maps.shape == (1, steps, 3, 4) and moved.maps[0, 0, 0, 3] < got.transform[moved.instance[0], 0, 3]


def test_vectors_with_motion_blur_are_reported_but_nothing_that_cycles_would_show(blurred):
    """`strict` lets them pass."""
    blurred.view_layers[0].use_pass_vector = True
    (notice,) = (each for each in rendered_scene().warnings if "the pass Vector" in each)
    assert notice.weight == Weight.REPAIRED < Weight.SETTING


def test_what_is_not_there_all_the_time_stands_still(blurred):
    for name in ("Comes", "Stays"):
        keyed(add_grid(name, 1), "location", (0, 0, 0), (2, 0, 0))
    comes = bpy.data.objects["Comes"]
    for number, hidden in ((1, True), (FRAME, False)):
        comes.hide_render = hidden
        comes.keyframe_insert("hide_render", frame=number)
    got = rendered_scene()
    (moving,) = got.instances.motion.instance
    assert got.object_names[got.instances.object[moving]] == "Stays" and len(got.instances) == 2


def test_what_is_flat_in_the_middle_of_its_motion_is_there(blurred):
    """A plate that is mirrored in the course of the frame; and one that is flat all the time is named."""
    keyed(add_grid("Mirrored", 1), "scale", (1, 1, 1), (1, 1, -1))
    flat = add_grid("Flat", 1)
    flat.scale.z = 0
    keyed(flat, "location", (0, 0, 0), (1, 0, 0))
    got = rendered_scene()
    assert [got.object_names[i] for i in got.instances.object] == ["Mirrored"]
    assert got.instances.transform[0, 2, 2] == 0 and len(got.instances.motion.maps) == 1
    assert np.allclose(got.instances.motion.maps[0][[0, -1], 2, 2], (0.6875, -0.6875))
    said = [text for text in got.warnings if "flattened" in text]
    assert len(said) == 1 and said[0].objects == ("Flat",)


def test_an_object_without_a_place_at_one_time_is_named(blurred):
    lost = add_grid("Lost", 1)
    lost.parent = add_object("Above", None)
    for obj in (lost, lost.parent):  # the product of both scales is no number of float32
        obj.driver_add("scale", 0).driver.expression = f"1.0 if frame <= {FRAME} else 1e30"
    got = rendered_scene()
    assert got.instances.motion is None
    said = [text for text in got.warnings if "not finite" in text]
    assert len(said) == 1 and said[0].objects == ("Lost",)


@pytest.mark.parametrize("is_hair", [False, True])
@pytest.mark.parametrize(
    "kind, elsewhere, values, word",
    [
        ("FLOAT_VECTOR", False, [1.0, 0.0, 0.0], ""),
        ("FLOAT_VECTOR", True, [1.0, 0.0, 0.0], "domain"),
        ("FLOAT_COLOR", False, [1.0, 0.0, 0.0, 0.0], "FLOAT_COLOR"),
        ("FLOAT_VECTOR", False, [np.nan, 0.0, 0.0], "4 values"),
    ],
)
def test_velocities_that_move_nothing_are_named(blurred, is_hair, kind, elsewhere, values, word):
    if is_hair:
        data = bpy.data.hair_curves.new("Moved")
        data.add_curves([2, 2])
        data.position_data.foreach_set("vector", np.float32([0, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0, 1]))
        add_object("Moved", data)
    else:
        data = add_grid("Moved", 1).data
    velocity = data.attributes.new("velocity", kind, ("CURVE" if is_hair else "FACE") if elsewhere else "POINT")
    name = "color" if kind == "FLOAT_COLOR" else "vector"
    velocity.data.foreach_set(name, np.float32(values * len(velocity.data)))
    got = rendered_scene()
    said = [text for text in got.warnings if "velocity" in text]
    assert (got.meshes[0].motion is None) == bool(word) == bool(said)
    if word:
        assert len(said) == 1 and word in said[0] and said[0].objects == ("Moved",)
