"""Faces of volumes that lie on surfaces, which are moved off them. NumPy alone."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest

from raybatch_addon.core.displacement import boundaries
from raybatch_addon.core.displacement.boundaries import MOVED_MOST, MovedBoundaries
from raybatch_addon.core.displacement.flat_faces import PLANES_MOST
from raybatch_addon.core.scene.description import Grid, Mesh, Scene
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


def test_the_face_on_the_floor_is_moved_off_it_and_no_other():
    moved = offsets(room((CUBE, scenes.IDENTITY, SMOKE)))
    on_floor = CUBE.positions[:, 2] == 0
    assert (moved[on_floor, 2] > 1e-6).all() and (moved[on_floor, 2] < 1e-3).all()
    assert (moved[:, :2] == 0).all() and (moved[~on_floor] == 0).all()


def test_so_it_is_where_a_transform_puts_both():
    """Turned, mirrored and stretched: the face is moved along its normal in the world, inwards."""
    scene = room((CUBE, TURNED, SMOKE), transform=TURNED)
    there = offsets(scene) @ TURNED[:, :3].T
    on_floor = CUBE.positions[:, 2] == 0
    assert (there[on_floor, 0] > 1e-6).all() and (there[~on_floor] == 0).all()


@pytest.mark.parametrize("size", [20.0, 200.0, 2000.0])
def test_it_is_moved_beyond_the_errors_of_both_surfaces(size):
    """Points on a triangle are off in proportion to its edges, so that the next ray begins so far behind it."""
    floor = dataclasses.replace(FLOOR, positions=FLOOR.positions * (size / 20))
    scene = scenes.scene([(CUBE, scenes.IDENTITY, SMOKE), (floor, scenes.IDENTITY, scenes.diffuse(0.5))])
    moved = offsets(scene)[CUBE.positions[:, 2] == 0, 2]
    error = (25 + 6) * 2.0**-24 * size
    assert (moved > 2 * error).all() and (moved <= MOVED_MOST * 2).all()


@pytest.mark.parametrize("scale", [(100, 100, 1), (100, 100, 0.1), (100, 100, 100)])
def test_a_floor_that_its_transform_makes_wide_counts_as_wide(scale):
    """In the world, where its tree may be, each coordinate is off in proportion to the longest edge."""
    wide = np.diag([*scale, 1.0])[:3].astype(np.float32)
    for things in (
        [(CUBE, scenes.IDENTITY, SMOKE), (scenes.plane(), wide, scenes.diffuse(0.5))],
        [(CUBE, wide, SMOKE), (FLOOR, scenes.IDENTITY, scenes.diffuse(0.5))],
    ):
        scene = scenes.scene(things)
        there = offsets(scene) @ scene.instances.transform[0, :, :3].T
        on_floor = CUBE.positions[:, 2] == 0
        assert (there[on_floor, 2] > 2 * (25 + 6) * 2.0**-24 * 200).all() or (there == 0).all()
        assert (there[on_floor, 2] > 0).all() or scale[2] < 1  # where the cube is too low for it


def test_thin_volumes_are_not_turned_inside_out():
    """A slab of a millimetre on a plane of 2 km: flat, and turned, where its box in the world is high."""
    slab = block((-5, -5, 0), (5, 5, 1e-3))
    turn = np.array([(0.8, 0, -0.6, 0), (0, 1, 0, 0), (0.6, 0, 0.8, 0)], np.float32)
    floor = dataclasses.replace(FLOOR, positions=FLOOR.positions * 100)
    for at in (scenes.IDENTITY, turn):
        scene = scenes.scene([(slab, at, SMOKE), (floor, at, scenes.diffuse(0.5))])
        assert MovedBoundaries().moved(scene) is scene


@pytest.mark.parametrize("height", 2.0 ** np.arange(-17, -7))
def test_a_face_is_not_moved_onto_another_surface(height):
    """Neither of a carpet on the floor, nor of what another instance of its mesh lies close to."""
    floor = dataclasses.replace(FLOOR, positions=FLOOR.positions * 10)
    carpet = np.eye(4)[:3].astype(np.float32)
    carpet[2, 3] = height
    beside = np.array(carpet)
    beside[0, 3] = 4
    error = 2 * (25 + 6) * 2.0**-24 * 20
    lying = [(CUBE, scenes.IDENTITY, SMOKE), (floor, scenes.IDENTITY, scenes.diffuse(0.5))]
    on_carpet = scenes.scene([*lying, (FLOOR, carpet, scenes.diffuse(0.5))])
    small = (scenes.plane(), beside, scenes.diffuse(0.5))
    twice = scenes.scene([*lying, (CUBE, scenes.translation(4, 0, 0), SMOKE), small])
    for scene in (on_carpet, twice):
        bottom = offsets(scene)[CUBE.positions[:, 2] == 0, 2]
        assert (bottom == bottom[0]).all() and bottom[0] > 0
        assert abs(bottom[0] - height) > error / (1 if scene is on_carpet else 10)


def test_where_there_is_too_much_to_look_at_all_stays(monkeypatch):
    for name in ("TRIANGLES_MOST", "BOUNDARIES_MOST", "WORK_MOST", "_PAIRS_MOST"):
        scene = room((CUBE, scenes.IDENTITY, SMOKE))
        assert MovedBoundaries().moved(scene) is not scene
        with monkeypatch.context() as changed:
            changed.setattr(boundaries, name, 0)
            assert MovedBoundaries().moved(scene) is scene, name


def test_nothing_of_a_scene_is_kept_alive():
    cube = frozen(block((-1, -1, 0), (1, 1, 2)))
    kept, gone = MovedBoundaries(), weakref.ref(cube.positions)
    assert kept.moved(room((cube, scenes.IDENTITY, SMOKE))).meshes
    del cube
    gc.collect()
    assert gone() is None
    kept.clear()


def test_a_face_that_would_have_to_be_moved_far_stays():
    """Where the floor is so large, or the camera so far away, that errors are a share of the volume."""
    for size, eye in ((200_000.0, 4.0), (20.0, 400_000.0)):
        floor = dataclasses.replace(FLOOR, positions=FLOOR.positions * np.float32(size / 20))
        things = [(CUBE, scenes.IDENTITY, SMOKE), (floor, scenes.IDENTITY, scenes.diffuse(0.5))]
        scene = scenes.scene(things, view=scenes.camera(eye=(0, -eye, 0)))
        assert MovedBoundaries().moved(scene) is scene


@pytest.mark.parametrize("gap", [0.0, 1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3])
@pytest.mark.parametrize("side", [1, -1], ids=["above", "in the floor"])
def test_a_face_is_moved_apart_from_a_surface_or_not_at_all(gap, side):
    """Never onto one from which it was apart."""
    cube = block((-1, -1, side * gap), (1, 1, 2))
    floor = dataclasses.replace(FLOOR, positions=FLOOR.positions * 10)
    scene = scenes.scene([(cube, scenes.IDENTITY, SMOKE), (floor, scenes.IDENTITY, scenes.diffuse(0.5))])
    height = (cube.positions + offsets(scene))[cube.positions[:, 2] < 1, 2]
    error = (25 + 6) * 2.0**-24 * 200
    assert (height > 2 * error).all() or (height == np.float32(side * gap)).all()
    assert (height > 0).all() or gap > error


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
    """The faces between them stay on each other."""
    parts = [block((-1, -1, 0), (0, 1, 2)), block((0, -1, 0), (1, 1, 2))]
    triangles = np.concatenate([parts[0].triangles, parts[1].triangles + len(parts[0].positions)])
    joined = Mesh("joined", np.concatenate([part.positions for part in parts]), triangles)
    wall = np.array([(0, 0, 1, 0), (0, 1, 0, 0), (1, 0, 0, 0)], np.float32)  # in the plane between them
    scene = scenes.scene(
        [(joined, scenes.IDENTITY, SMOKE), *((FLOOR, at, scenes.diffuse(0.5)) for at in (scenes.IDENTITY, wall))]
    )
    moved = offsets(scene)
    assert (moved[:, 0] == 0).all() and (moved[joined.positions[:, 2] == 0, 2] > 0).all()


def test_the_largest_faces_of_a_mesh_are_moved():
    """Of a cylinder of many sides the bottom; of a ball, which has no face in the plane, none."""
    count = 3 * PLANES_MOST
    angles = 2 * np.pi * np.arange(count) / count
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    positions = np.concatenate([np.column_stack([ring, np.full(count, z)]) for z in (0.0, 2.0)])
    positions = np.concatenate([positions, [(0, 0, 0), (0, 0, 2)]]).astype(np.float32)
    a, b = np.arange(count), np.roll(np.arange(count), -1)
    sides = np.concatenate([np.column_stack([a, b, a + count]), np.column_stack([b, b + count, a + count])])
    caps = [np.column_stack([b, a, 0 * a + 2 * count]), np.column_stack([a + count, b + count, 0 * a + 2 * count + 1])]
    cylinder = Mesh("cylinder", positions, np.concatenate([sides, *caps]).astype(np.int32))
    moved = offsets(room((cylinder, scenes.IDENTITY, SMOKE)))
    assert (moved[positions[:, 2] == 0, 2] > 0).all() and (moved[positions[:, 2] > 0] == 0).all()
    ball = scenes.sphere()
    lying = dataclasses.replace(ball, positions=ball.positions + np.array([0, 0, 1], np.float32))
    scene = room((lying, scenes.IDENTITY, SMOKE))
    assert MovedBoundaries().moved(scene) is scene


def test_a_sharp_edge_on_the_floor_is_moved_as_far_as_the_face():
    """An attic whose roof meets its floor at 15 degrees."""
    rise = np.tan(np.radians(15))
    prism = np.float32([(x, y, z) for y in (-1, 1) for x, z in ((-2, 0), (2, 0), (0, 2 * rise))])
    triangles = np.int32([(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)])
    attic = Mesh("attic", prism, triangles)
    moved = offsets(room((attic, scenes.IDENTITY, SMOKE)))
    on_floor = prism[:, 2] == 0
    assert moved[on_floor, 2] == pytest.approx(moved[on_floor, 2].max(), rel=0.01) and moved[on_floor, 2].min() > 0


def test_what_has_vertices_apart_stays_closed():
    corners = CUBE.positions[CUBE.triangles.reshape(-1)]
    loose = Mesh("loose", corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    there = loose.positions + offsets(room((loose, scenes.IDENTITY, SMOKE)))
    assert len(np.unique(there, axis=0)) == len(CUBE.positions)
    assert there[:, 2].min() > 0


def test_a_mesh_that_is_seen_in_part_stays():
    """A crack would open between its faces."""
    mixed = dataclasses.replace(CUBE, triangle_slot=np.int32([0] * 6 + [1] * 6))
    scene = room((mixed, scenes.IDENTITY, SMOKE))
    slots = np.concatenate([scene.slot_materials, np.int32([0, 1])])  # those of the cube now, at the end
    first = np.int32([len(slots) - 2, scene.instances.slot_first[1]])
    scene = dataclasses.replace(
        scene, slot_materials=slots, instances=dataclasses.replace(scene.instances, slot_first=first)
    )
    assert MovedBoundaries().moved(scene) is scene


def test_all_but_positions_is_of_this_frame():
    """What an exporter changes beside positions that it keeps."""
    kept = MovedBoundaries()
    kept.moved(room((CUBE, scenes.IDENTITY, SMOKE)))
    grid = Grid("density", np.ones((2, 2, 2), np.float32), np.eye(4)[:3])
    changed = dataclasses.replace(CUBE, name="other", texture_space=((0, 0, 0), (3, 3, 3)), grids=(grid,))
    moved = kept.moved(room((changed, scenes.IDENTITY, SMOKE)))
    found = moved.meshes[moved.instances.mesh[0]]
    for each in dataclasses.fields(Mesh):
        if each.name not in ("positions", "base_positions"):
            assert getattr(found, each.name) is getattr(changed, each.name), each.name


def test_instances_share_a_mesh_and_the_next_frame_has_it_too():
    above = scenes.translation(0, 5, 0.5)
    things = [(CUBE, scenes.IDENTITY, SMOKE), (CUBE, above, SMOKE)]
    kept = MovedBoundaries()
    first = kept.moved(room(*things))
    assert first.instances.mesh[0] == first.instances.mesh[1] and len(first.meshes) == 2  # with that of the floor
    nearby = kept.moved(room(*things, view=scenes.camera(eye=(0, -4.1, 0))))
    farther = kept.moved(room(*things, view=scenes.camera(eye=(0, -400, 0))))
    near, far = (each.meshes[each.instances.mesh[0]].positions[:, 2].min() for each in (first, farther))
    assert far > 8 * near > 0  # distances to the camera are rounded more coarsely
    assert first.meshes[first.instances.mesh[0]].positions is nearby.meshes[nearby.instances.mesh[0]].positions
