"""Volumes that emit, and are aimed at or left to rays: by what sees them and what lies around them."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Frame, Scene, Visibility, Volume
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volume_lights import ONCE, UNWEIGHED, assert_same_mean, over_floor, rising, run_means
from tests.renders.volumes.test_volumes import filled, medium, picture
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

EDGE = 1.0


def placed(scene: Scene, *offsets) -> Scene:
    """`scene`, whose last objects are moved by these `offsets`."""
    transform = np.array(scene.instances.transform, np.float32)
    transform[-len(offsets) :, :, 3] += np.asarray(offsets, np.float32)
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=transform))


def seen_by(scene: Scene, visibility: int) -> Scene:
    """`scene`, whose last object is seen by these kinds of rays alone."""
    seen = np.array(scene.instances.visibility)
    seen[-1] = visibility
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=seen))


def assert_rays_find_the_same(session, scene: Scene, **changes) -> None:
    found = [run_means(session, scene, nee=nee, **ONCE | dict(sample_count=128) | changes) for nee in ("ON", "OFF")]
    assert found[0].mean() > 0
    assert_same_mean(*found)


ALL = int(Visibility.ALL)
TWO = over_floor(medium(emission=10.0), medium(emission=4.0), edge=EDGE)
ROUND_THE_FLOOR = placed(over_floor(medium(emission=10.0), medium(0.1, emission=0.5), edge=EDGE), (-0.6, -0.3, -1.3))


@pytest.mark.parametrize("lacking", [Visibility.SHADOW, Visibility.DIFFUSE, ALL ^ int(Visibility.CAMERA)])
@pytest.mark.parametrize("scene", [TWO, ROUND_THE_FLOOR], ids=["in one another", "round the floor"])
def test_beside_a_volume_that_some_rays_do_not_see(session, scene, lacking):
    """Shadow rays and scattered rays do not agree there about which volumes they are in."""
    assert_rays_find_the_same(session, seen_by(scene, ALL & ~int(lacking)), bounce_max=2)


def test_what_the_camera_does_not_see_is_aimed_at(session):
    """Less noise tells that it is."""
    scene = seen_by(over_floor(medium(emission=10.0)), ALL & ~int(Visibility.CAMERA))
    with_nee, alone = (picture(session, scene, **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 10, (with_nee, alone)


def test_in_fog_of_the_world_that_may_emit_rays_alone_find_light():
    """All volumes lie in one that emits: no cell would be weighed."""
    for fog, aimed in ((medium(0.1), True), (medium(emission=0.1), False), (rising(0.1), False)):
        scene = over_floor(medium(emission=1.0))
        scene = dataclasses.replace(scene, world=dataclasses.replace(scene.world, volume=fog))
        assert derive_features(scene, RenderSettings()).volume_lights == aimed


def test_what_is_not_weighed_keeps_its_closed_form(session):
    """Two cubes in one place, of which neither is weighed, beside one that is, below the floor: all that is found
    there is found by rays, and the picture is that of rays alone to the last bit.
    """
    emits = medium(emission=2.0)
    scene = placed(over_floor(emits, emits, emits, edge=EDGE), (0, 0, -8), (-0.3, -0.2, -0.25), (-0.6, -0.4, -0.5))
    first, second = (picture(session, scene, nee=nee, bounce_max=2) for nee in ("ON", "OFF"))
    assert first.mean() > 0
    assert np.array_equal(first, second)


def sheets(emission: float, period: float, share: float) -> Volume:
    """Emits in thin layers, one each `period` [m] of height, in a `share` of it; of the ops of `rising`, whose kernels
    render it.
    """
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    counted = builder.value("math", int(MathOperation.MULTIPLY), False, height, 1 / period, 0.0)
    within = builder.value("math", int(MathOperation.FRACT), False, counted, 0.0, 0.0)
    lit = builder.value("math", int(MathOperation.LESS_THAN), False, within, share, 0.0)
    bright = builder.value("math", int(MathOperation.MULTIPLY), False, lit, emission, 0.0)
    builder.closure("emission", builder.value("multiply_colors", (1.0, 1.0, 1.0), builder.value("splat", bright)))
    builder.closure("volume_absorption", (0.0, 0.0, 0.0))
    return Volume(program=builder.finish())


def test_light_that_bounds_have_missed_is_missed_by_shadow_rays_too(session, examples):
    """About half of the bounds of thin layers are 0, where rays do not look."""
    scene = over_floor(sheets(1000.0, EDGE / 32, 0.003), edge=EDGE, place=np.array([0.0, 0.0, 0.6]))
    # a GPU's bounds leave fewer layers to be found, by rarer and brighter samples
    sample_count = 16384 if wp.get_device(DEVICE).is_cuda else examples(2048)
    assert_rays_find_the_same(session, scene, **UNWEIGHED, sample_count=sample_count)


def scaled(size: float) -> Scene:
    """A cube over a floor, `size` times as large, and so much fainter that the picture is the same."""
    view = scenes.camera(eye=(0, -4 * size, 2 * size), half_width=1e-4)
    floor = scenes.plane(size=40 * size), scenes.IDENTITY, scenes.diffuse(0.8)
    place = scenes.translation(0.3 * size, 0.1 * size, size)
    cube = scenes.box("cube", 0.5 * size), place, filled(medium(0.5 / size, emission=10.0 / size))
    return scenes.scene([floor, cube], view=view, frame=Frame(8, 8))


@pytest.mark.parametrize("size", [1e-15, 2e14])
def test_a_picture_does_not_change_with_the_size_of_all_there_is(session, size):
    """Volumes and squares of lengths are beyond float32."""
    found, expected = (run_means(session, scaled(each)) for each in (size, 1.0))
    np.testing.assert_allclose(found, expected, rtol=1e-2)
    with_nee, alone = (picture(session, scaled(size), **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 2, (with_nee, alone)


@pytest.mark.parametrize("lacking", [Visibility.SHADOW, Visibility.DIFFUSE])
def test_what_others_are_seen_by_does_not_concern_a_volume(session, lacking, examples):
    """Beside one that shadow rays or scattered rays do not see, a volume is aimed at."""
    scene = placed(over_floor(medium(emission=10.0), medium(emission=0.1)), (3.0, 0.0, 3.0))
    scene = seen_by(scene, ALL & ~int(lacking))
    with_nee, alone = (picture(session, scene, **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 10, (with_nee, alone)
    assert_rays_find_the_same(session, scene, sample_count=examples(1024))


BROKEN = {
    "flat": np.diag([1.0, 1.0, 0.0]),
    "a line": np.diag([0.0, 0.0, 1.0]),
    "tiny": np.diag([1e-30] * 3),
    "huge": np.diag([1e30] * 3),
}


@pytest.mark.parametrize("name", [*BROKEN, "far"])
def test_a_volume_that_has_no_inside_does_not_concern_others(session, name):
    scene = over_floor(medium(emission=10.0), medium(emission=1.0))
    transform = np.array(scene.instances.transform, np.float32)
    transform[-1, :, :3] = BROKEN.get(name, np.eye(3))
    transform[-1, :, 3] = (0.0, 0.0, -1e33 if name == "huge" else -1e30 if name == "far" else -5.0)
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=transform))
    with_nee, alone = (picture(session, scene, **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 10, (with_nee, alone)
