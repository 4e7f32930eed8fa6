"""Which volumes rays are in: where faces of several coincide, and where cameras and volumes move."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Mesh, Scene, Volume
from raybatch_addon.core.scene.motion import instance_maps
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import assert_mean, color, filled, in_box, medium
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def block(low, high, name="block") -> Mesh:
    """A closed box between two corners, with coordinates of its own in world space."""
    made = scenes.box(name, 1.0)
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return dataclasses.replace(made, positions=(low + (made.positions + 0.5) * (high - low)).astype(np.float32))


def placed(low, high, name="block"):
    """The same box as a cube of 1 m that a transform puts there."""
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return scenes.box(name, 1.0), np.column_stack([np.diag(high - low), (low + high) / 2]).astype(np.float32)


def seen(
    session, things, eye, target, up=(0.0, 0.0, 1.0), half_width=0.005, world=1.0, lights=(), **changes
) -> np.ndarray:
    """What a camera sees of `things` in a world of one colour."""
    view = scenes.camera(eye=eye, target=target, up=up, half_width=half_width)
    lit = in_box(medium(1.0)).lights  # dark, so that tests share kernels
    made = scenes.scene(things, world=world, frame=Frame(8, 8), view=view)
    made = dataclasses.replace(made, lights=(*lit, *lights))
    return color(session.render(made, RenderSettings(**(dict(sample_count=4, bounce_max=8) | changes))))


# pairs of boxes with a face in common, and what lies on the line through both: their lengths by density 0.3 and 0.6
_PAIRS = {
    "beside one another": (((-1, -1, -1), (0.1, 1, 1)), ((0.1, -1, -1), (1.3, 1, 1)), (1.1, 1.2)),
    "one on the other": (((-1, -1, -1), (0.7, 1, 1)), ((0.7, -0.5, -0.5), (1.3, 0.5, 0.5)), (1.7, 0.6)),
    "one in the other": (((-1, -1, -1), (1.3, 1, 1)), ((-1, -0.5, -0.5), (0.7, 0.5, 0.5)), (2.3, 1.7)),
    "the same": (((-1, -1, -1), (1.3, 1, 1)), ((-1, -1, -1), (1.3, 1, 1)), (2.3, 2.3)),
}


@pytest.mark.parametrize("pair", _PAIRS)
@pytest.mark.parametrize("instanced", [False, True], ids=["world", "instances"])
def test_volumes_whose_faces_coincide(session, pair, instanced):
    """Whichever comes first, from either side, as meshes of the world and as instances that transforms put there."""
    first, second, lengths = _PAIRS[pair]
    expected = math.exp(-0.3 * lengths[0] - 0.6 * lengths[1])
    for swapped in (False, True):
        boxes = [(*first, 0.3), (*second, 0.6)]
        boxes = boxes[::-1] if swapped else boxes
        things = []
        for number, (low, high, density) in enumerate(boxes):
            mesh, transform = placed(low, high, f"{number}") if instanced else (block(low, high), scenes.IDENTITY)
            things.append((mesh, transform, filled(medium(density))))
        for side in (-1, 1):
            # not along the axis, so that points on the faces are rounded
            found = seen(session, things, (side * 6, 0.01, 0.02), (0, 0, 0))
            np.testing.assert_allclose(found, expected, rtol=2e-3, err_msg=f"{swapped} {side}")


def test_parts_of_one_mesh_that_stand_side_by_side_are_one_volume(session):
    """Also where the face between them is met by the triangle that leaves it."""
    parts = [block((-1, -1, -1), (0.1, 1, 1)), block((0.1, -1, -1), (1.3, 1, 1))]
    for order in (parts, parts[::-1]):
        positions = np.concatenate([part.positions for part in order])
        triangles = np.concatenate([order[0].triangles, order[1].triangles + len(order[0].positions)])
        joined = Mesh("joined", positions, triangles)
        found = seen(session, [(joined, scenes.IDENTITY, filled(medium(0.5)))], (6, 0.01, 0.02), (0, 0, 0))
        np.testing.assert_allclose(found, math.exp(-0.5 * 2.3), rtol=2e-3)


def test_light_passes_volumes_whose_faces_coincide(session):
    """A sun shines on a floor through two boxes that stand on one another: shadow rays pass them as paths do."""
    floor = scenes.plane(size=20), scenes.translation(0, 0, -3), scenes.diffuse(0.8)
    boxes = [((-2, -2, -1), (2, 2, 0.1), 0.2), ((-2, -2, 0.1), (2, 2, 1.5), 0.4)]
    things = [(block(low, high), scenes.IDENTITY, filled(medium(density))) for low, high, density in boxes]
    view = dict(eye=(0, -9, -2.5), target=(0, 0, -3), world=0.0, lights=[scenes.sun(1.0)], sample_count=64)
    lit, clear = (seen(session, all_of, **view).mean() for all_of in ([floor, *things], [floor]))
    np.testing.assert_allclose(lit / clear, math.exp(-0.2 * 1.1 - 0.4 * 1.4), rtol=1e-5)


def moved(scene: Scene, motion, instance: int = 0) -> Scene:
    """`scene` with one instance that goes through places: vectors that its transform is moved by."""
    keys = np.repeat(np.asarray(scene.instances.transform, np.float64)[:, None], len(motion), 1)
    keys[instance, :, :, 3] += motion
    instances = dataclasses.replace(scene.instances, motion=instance_maps(keys.astype(np.float32)))
    return dataclasses.replace(scene, instances=instances)


def graded() -> Volume:
    """A volume that absorbs by its object's height, in [-1, 1]: 0.5 (z + 1) [1/m]."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("object_coordinates", 0))[2]
    raised = builder.value("math", 0, False, height, 1.0, 0.0)
    builder.closure("volume_absorption", builder.value("splat", builder.value("math", 2, False, raised, 0.5, 0.0)))
    return Volume(program=builder.finish())


def test_the_density_of_a_volume_moves_with_it(session):
    """A cube that sinks by 1 m while the shutter is open: a ray sees the densities that pass it."""
    scene = moved(in_box(graded(), scenes.camera(eye=(0, -4, 0), half_width=0.001)), [(0, 0, 0), (0, 0, -1.0)])
    # at time t the ray is at height t of the cube, and passes 2 m of density (t + 1) / 2
    expected = math.exp(-1) - math.exp(-2)
    assert_mean(session, scene, np.full(3, expected), sample_count=64)


def test_cameras_that_move_into_volumes_and_out(session):
    """Each ray begins where the camera is at its time: half of them in the cube, as far from its end as that is."""
    view = scenes.camera(eye=(0, -3, 0), target=(0, 9, 0), half_width=0.001)
    steps = np.repeat(np.asarray(view.transform, np.float64)[None], 2, 0)
    steps[:, 1, 3] = -3, 1
    view = dataclasses.replace(view, motion=steps.astype(np.float32))
    expected = 0.5 * math.exp(-2) + 0.25 * (1 - math.exp(-2))
    assert_mean(session, in_box(medium(1.0), view), np.full(3, expected), sample_count=64)


@pytest.mark.parametrize("volume", [medium(1.0), None], ids=["fixed", "program"])
def test_volumes_that_move_over_the_camera(session, volume):
    """The same where the cube moves."""
    if volume is None:
        builder = ProgramBuilder()
        builder.closure("volume_absorption", builder.value("splat", builder.value("math", 0, False, 0.5, 0.5, 0.0)))
        volume = Volume(program=builder.finish())
    view = scenes.camera(eye=(0, 0, 0), target=(0, 9, 0), half_width=0.001)
    scene = moved(in_box(volume, view), [(0, 3, 0), (0, -1, 0)])
    expected = 0.5 * math.exp(-2) + 0.25 * (1 - math.exp(-2))
    assert_mean(session, scene, np.full(3, expected), sample_count=64)


def test_light_is_limited_when_it_arrives(session):
    """A limit is one of the light behind a volume, not of what the lamp sends into it."""
    floor = scenes.plane(size=20), scenes.translation(0, 0, -3), scenes.diffuse(0.8)
    veil = block((-4, -4, -1), (4, 4, 1)), scenes.IDENTITY, filled(medium(1.0))
    view = scenes.camera(eye=(0, -9, -2.5), target=(0, 0, -3), half_width=0.01)
    lights = [scenes.sun(1.0), *in_box(medium(1.0)).lights[1:]]
    scene = scenes.scene([floor, veil], world=0.0, frame=Frame(8, 8), view=view, lights=lights)
    free, clamped = (
        color(session.render(scene, RenderSettings(sample_count=4, clamp_direct=limit))).mean() for limit in (0.0, 0.1)
    )
    assert 0.02 < free < 0.1 and clamped == free
    tint = Closure(ClosureKind.TRANSPARENT, (0.3, 0.3, 0.3))
    clear = dataclasses.replace(scene.materials[1], volume=None, closures=(tint,))
    tinted = dataclasses.replace(scene, materials=(scene.materials[0], clear, *scene.materials[2:]))
    free, clamped = (
        color(session.render(tinted, RenderSettings(sample_count=4, clamp_direct=limit))).mean() for limit in (0.0, 0.1)
    )
    assert 0.01 < free < 0.1 and clamped == free
