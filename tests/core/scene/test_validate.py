"""Damaged scenes are refused before a kernel trusts them."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.film import PASSES
from raybatch_addon.core.scene.description import Frame, InstanceMaps, SkySun, World
from raybatch_addon.core.scene.motion import instance_maps, map_sizes, moving_instances
from raybatch_addon.core.scene.validate import PASS_NAMES, checked_scene
from tests.support import scenes


def plain():
    return scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], lights=[scenes.sun()])


def with_mesh(**changes):
    scene = plain()
    return dataclasses.replace(scene, meshes=(dataclasses.replace(scene.meshes[0], **changes),))


def with_instances(**changes):
    scene = plain()
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, **changes))


@pytest.mark.parametrize(
    "scene, words",
    [
        (with_mesh(triangle_slot=np.array([0, 200_000_000], np.int32)), "object 0.*material slot"),
        (with_instances(slot_first=np.array([5], np.int32)), "object 0.*material slot"),
        (with_instances(slot_first=np.array([-1], np.int32)), "object 0.*material slot"),
        (with_instances(mesh=np.array([3], np.int32)), "mesh that does not exist"),
        (dataclasses.replace(plain(), slot_materials=np.array([7], np.int32)), "material that does not exist"),
        (dataclasses.replace(plain(), frame=Frame(4, 4, passes=("Combined", "Fog"))), "Fog"),
        (dataclasses.replace(plain(), camera=scenes.camera(lens_radius=0.1, focus_distance=0.0)), "focus distance"),
        (dataclasses.replace(plain(), world=World(sun=SkySun((0.0, 0.0, 2.0), 0.01))), "sun of the world"),
        (dataclasses.replace(plain(), world=World(sun=SkySun((0.0, 0.0, np.nan), 0.01))), "sun of the world"),
        (dataclasses.replace(plain(), world=World(sun=SkySun((0.0, 0.0, 1.0), 0.0))), "sun of the world"),
    ],
    ids=range(10),
)
def test_indices_and_numbers_that_lead_nowhere_are_refused_by_name(scene, words):
    with pytest.raises(SceneError, match=words):
        checked_scene(scene)


@pytest.mark.parametrize(
    "scene, words",
    [
        (with_mesh(triangle_slot=np.zeros(1, np.int32)), "plane.*material slots"),
        (with_mesh(corner_normals=np.zeros((1, 3, 3), np.float32)), "plane.*normals"),
        (with_mesh(triangles=np.array([[0, 1, 9]], np.int32)), "plane.*vertices that do not exist"),
        (
            scenes.scene([(scenes.plane(size=20), scenes.translation(0, 0, 0, 5e17), scenes.diffuse())]),
            "object 0.*beyond",
        ),
        (dataclasses.replace(plain(), world=World((np.nan, 1, 1))), "world"),
        (dataclasses.replace(plain(), world=World((-1, 0, 0))), "world"),
        (dataclasses.replace(plain(), lights=(scenes.sun(np.nan),)), "sun"),
    ],
    ids=range(7),
)
def test_what_cannot_be_rendered_is_left_out_and_named(scene, words):
    checked = checked_scene(scene)
    assert len(checked.warnings) == 1
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(checked.warnings[0])
    assert np.isfinite(checked.world.radiance).all()


def test_a_good_scene_is_left_alone():
    scene = plain()
    assert checked_scene(scene) is scene
    assert set(PASS_NAMES) == set(PASSES)


def test_meshes_that_move_in_other_steps_than_most_stand_still():
    """Kernels read as many steps of each mesh that moves."""
    made = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())] * 3, lights=[scenes.sun()])
    mesh = made.meshes[0]
    meshes = [dataclasses.replace(mesh, motion=np.stack([mesh.positions] * steps)) for steps in (3, 3, 5)]
    checked = checked_scene(dataclasses.replace(made, meshes=(*meshes, *made.meshes[3:])))
    assert [each.motion is None for each in checked.meshes[:3]] == [False, False, True]
    assert "5 steps" in checked.warnings[-1]


def three_planes(*, moving=(1, 2), lost=None):
    """Three planes, of which those called `moving` go along x while the shutter is open, and one may have no size."""
    made = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())] * 3, lights=[scenes.sun()])
    transform = made.instances.transform.copy()
    if lost is not None:
        transform[lost, :, :3] = 0
    maps = np.repeat(transform[list(moving), None].astype(np.float32), 3, 1)
    maps[..., 0, 3] += np.float32([0, 1, 2]) + 10 * np.float32(moving)[:, None]
    motion = InstanceMaps(np.array(moving, np.int32), maps)
    return dataclasses.replace(
        made, instances=dataclasses.replace(made.instances, transform=transform, motion=motion, frames=motion)
    )


def test_maps_stay_with_their_instances_where_others_are_left_out():
    checked = checked_scene(three_planes(lost=1))
    for moved in (checked.instances.motion, checked.instances.frames):
        assert moved.instance.tolist() == [1] and moved.maps[0, :, 0, 3].tolist() == [20, 21, 22]
    assert moving_instances(checked).tolist() == [False, True] and len(checked.instances) == 2


def test_instances_whose_motion_is_not_finite_stand_still_and_others_move():
    scene = three_planes()
    scene.instances.motion.maps[0, 1, 0, 3] = np.nan
    checked = checked_scene(scene)
    assert checked.instances.motion.instance.tolist() == [2] and "“object 1”" in checked.warnings[-1]
    assert checked.warnings[-1].objects == ("object 1",)
    assert moving_instances(checked).tolist() == [False, False, True]


@pytest.mark.parametrize(
    "which, maps", [([0, 3], (2, 3, 3, 4)), ([2, 0], (2, 3, 3, 4)), ([0], (2, 3, 3, 4)), ([0], (1, 1, 3, 4))]
)
def test_maps_of_other_instances_than_there_are_move_nothing(which, maps):
    scene = three_planes()
    motion = InstanceMaps(np.array(which, np.int32), np.zeros(maps, np.float32))
    checked = checked_scene(dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, motion=motion)))
    assert checked.instances.motion is None and "do not belong" in checked.warnings[-1].replace("does", "do")


def test_what_is_flat_for_a_moment_is_rendered_and_has_an_inverse():
    """Where an instance has none in the middle it is placed as at the nearest step that has one; one that is flat all
    the time is left out.
    """
    maps = np.repeat(np.array(scenes.IDENTITY)[None, None], 5, 1).repeat(3, 0)
    maps[:, :, 2, 2] = (1, 0.5, 0, -0.5, -1)
    maps[1, :, 2, 2] = 0
    maps[2, 1, 2, 2] = 0
    scene = three_planes()
    instances = dataclasses.replace(scene.instances, transform=maps[:, 2].copy(), motion=instance_maps(maps))
    checked = checked_scene(dataclasses.replace(scene, instances=instances))
    assert np.array_equal(checked.instances.transform, np.stack([maps[0, 1], maps[2, 3]]))
    assert np.array_equal(checked.instances.motion.maps, maps[[0, 2]])
    assert len(checked.warnings) == 1 and "flat" in checked.warnings[0]
    # without a message the scene is another one too
    whole = dataclasses.replace(instances, transform=maps[:1, 2].repeat(3, 0), motion=instance_maps(maps[[0, 0, 0]]))
    checked = checked_scene(dataclasses.replace(scene, instances=whole))
    assert not checked.warnings and (checked.instances.transform == maps[0, 1]).all()


def test_what_moves_alone_has_keys():
    from raybatch_addon.core.scene.flatten import flatten

    motion = flatten(three_planes(moving=(1,))).motion
    assert motion.row.tolist() == [-1, 0, -1] and motion.keys.shape[:2] == (1, 3)
    still = three_planes()
    maps = instance_maps(np.repeat(still.instances.transform[:, None].astype(np.float32), 3, 1))
    still = dataclasses.replace(still, instances=dataclasses.replace(still.instances, motion=maps))
    assert flatten(still).motion is None


@pytest.mark.parametrize("flatness", [1.0, 0.5, 0.11, 0.09, 1e-3, 1e-6, 1e-12, 0.0])
def test_sizes_of_maps_are_singular_values(flatness):
    """Of maps that turn, scale and flatten, in all orders of size, with equal sizes among them."""
    rng = np.random.default_rng(7)
    turns, back = (np.linalg.qr(rng.normal(size=(500, 3, 3)))[0] for _ in range(2))
    sizes = np.ones((500, 3))
    sizes[:, 2] = flatness
    sizes[:200, 1] = rng.uniform(flatness, 1, 200)
    sizes[200:350, 1] = flatness
    sizes *= 10.0 ** rng.uniform(-18, 18, (500, 1))
    maps = np.concatenate([(turns * sizes[:, None]) @ back, rng.normal(size=(500, 3, 1))], 2)
    finite, found, regular = map_sizes(maps)
    assert finite.all() and (regular == (flatness > np.finfo(np.float32).eps)).all()
    expected = np.sort(sizes, 1)[:, ::-1]
    assert np.allclose(found[:, 0], expected[:, 0], rtol=1e-5, atol=0)
    atol = 0 if flatness > 1e-10 else 1e-10  # what decomposition itself leaves
    assert np.allclose(found / found[:, :1], expected / expected[:, :1], rtol=1e-5, atol=atol)
    maps[3, 1, 1], maps[4, :, :3] = np.inf, 0
    finite, found, regular = map_sizes(maps[:5].astype(np.float32))
    assert finite.tolist() == [True, True, True, False, True] and not regular[4] and not found[4].any()
