"""Faces of volumes that lie on surfaces, which are moved off them. NumPy alone."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.displacement.boundaries import PLANES_MOST, MovedBoundaries
from raybatch_addon.core.scene.description import Mesh, Scene
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.scene.motion import instance_maps
from tests.renders.volumes.boundaries.test_boundaries import block
from tests.renders.volumes.test_volumes import filled, medium
from tests.support import scenes

SMOKE = filled(medium(0.5))
# a quarter turn, mirrored and stretched, of the floor at z = 0 to x = 3
TURNED = np.array([(0, 0, 2, 3), (1.5, 0, 0, 1), (0, 0.5, 0, 2)], np.float32)


def frozen(mesh: Mesh) -> Mesh:
    freeze(mesh.positions), freeze(mesh.triangles)
    return mesh


FLOOR = frozen(scenes.plane(size=20.0))
CUBE = frozen(block((-1, -1, 0), (1, 1, 2)))


def room(*things, floor=scenes.diffuse(0.5), transform=scenes.IDENTITY, view=None) -> Scene:
    """`things` (mesh, transform, material) and a floor at z = 0."""
    return scenes.scene([*things, (FLOOR, transform, floor)], view=view)


def offsets(scene: Scene, instance: int = 0) -> np.ndarray:
    """By how much vertices of an instance are moved, float64, shape [n, 3]."""
    moved = MovedBoundaries().moved(scene)
    before, after = (each.meshes[each.instances.mesh[instance]] for each in (scene, moved))
    assert after is before or after.base_positions is before.positions
    return after.positions.astype(np.float64) - before.positions


def test_the_face_on_the_floor_is_moved_into_it_and_no_other():
    moved = offsets(room((CUBE, scenes.IDENTITY, SMOKE)))
    on_floor = CUBE.positions[:, 2] == 0
    assert (moved[on_floor, 2] < -1e-6).all() and (moved[on_floor, 2] > -1e-3).all()
    assert (moved[:, :2] == 0).all() and (moved[~on_floor] == 0).all()


def test_so_it_is_where_a_transform_puts_both():
    """Turned, mirrored and stretched: the face is moved along its normal in the world, to the outside."""
    scene = room((CUBE, TURNED, SMOKE), transform=TURNED)
    there = offsets(scene) @ TURNED[:, :3].T
    on_floor = CUBE.positions[:, 2] == 0
    assert (there[on_floor, 0] < -1e-6).all() and (there[~on_floor] == 0).all()
    # a mesh whose coordinates are as large, but of a smaller object, is moved as far in the world
    tiny = np.array(TURNED)
    tiny[:, :3] *= 1e-3
    small = offsets(room((CUBE, tiny, SMOKE), transform=TURNED)) @ tiny[:, :3].T
    assert small[on_floor, 0] == pytest.approx(there[on_floor, 0], rel=0.51)


@pytest.mark.parametrize(
    "scene",
    {
        "above the floor": room((block((-1, -1, 1e-3), (1, 1, 2)), scenes.IDENTITY, SMOKE)),
        "beside the floor": room((block((11, -1, 0), (13, 1, 2)), scenes.IDENTITY, SMOKE)),
        "across the floor": room((block((-1, -1, -1), (1, 1, 1)), scenes.IDENTITY, SMOKE)),
        "on a floor that is a volume's": room((CUBE, scenes.IDENTITY, SMOKE), floor=SMOKE),
        "with a surface": room((CUBE, scenes.IDENTITY, dataclasses.replace(scenes.diffuse(), volume=medium(0.5)))),
        "without a volume": room((CUBE, scenes.IDENTITY, dataclasses.replace(SMOKE, volume=None))),
        "flat": room((CUBE, np.diag([1, 1, 0, 1])[:3].astype(np.float32), SMOKE)),
        "alone": scenes.scene([(CUBE, scenes.IDENTITY, SMOKE)]),
        "nothing": scenes.scene([]),
    }.items(),
    ids=lambda each: each[0],
)
def test_others_stay_where_they_are(scene):
    assert MovedBoundaries().moved(scene[1]) is scene[1]


def test_what_moves_stays_where_it_is():
    scene = room((CUBE, scenes.IDENTITY, SMOKE))
    for moving in (0, 1):
        maps = np.stack([scene.instances.transform] * 2, 1)
        maps[moving, 1, 0, 3] += 0.5
        moved = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, motion=instance_maps(maps)))
        assert MovedBoundaries().moved(moved) is moved


def test_parts_that_stand_side_by_side_stay_one_volume():
    parts = [block((-1, -1, 0), (0, 1, 2)), block((0, -1, 0), (1, 1, 2))]
    triangles = np.concatenate([parts[0].triangles, parts[1].triangles + len(parts[0].positions)])
    joined = Mesh("joined", np.concatenate([part.positions for part in parts]), triangles)
    scene = room((joined, scenes.IDENTITY, SMOKE))
    assert MovedBoundaries().moved(scene) is scene


def test_what_is_round_stays_and_what_has_vertices_apart_stays_closed():
    ball = scenes.sphere(segments=PLANES_MOST + 1)
    lying = dataclasses.replace(ball, positions=ball.positions + np.array([0, 0, 1], np.float32))
    scene = room((lying, scenes.IDENTITY, SMOKE))
    assert MovedBoundaries().moved(scene) is scene
    corners = CUBE.positions[CUBE.triangles.reshape(-1)]
    loose = Mesh("loose", corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    scene = room((loose, scenes.IDENTITY, SMOKE))
    there = loose.positions + offsets(scene)
    assert len(np.unique(there, axis=0)) == len(CUBE.positions)
    assert there[:, 2].min() < 0


def test_instances_share_a_mesh_and_the_next_frame_has_it_too():
    above = scenes.translation(0, 5, 0.5)
    things = [(CUBE, scenes.IDENTITY, SMOKE), (CUBE, above, SMOKE)]
    kept = MovedBoundaries()
    first = kept.moved(room(*things))
    assert first.instances.mesh[0] == first.instances.mesh[1] and len(first.meshes) == 2  # with that of the floor
    nearby = kept.moved(room(*things, view=scenes.camera(eye=(0, -4.1, 0))))
    assert nearby.meshes[nearby.instances.mesh[0]] is first.meshes[first.instances.mesh[0]]
    farther = kept.moved(room(*things, view=scenes.camera(eye=(0, -4000, 0))))
    low, lower = (each.meshes[each.instances.mesh[0]].positions[:, 2].min() for each in (first, farther))
    assert lower < 50 * low < 0  # distances to the camera are rounded more coarsely
