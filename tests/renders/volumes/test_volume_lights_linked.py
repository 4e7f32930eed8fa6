"""Volumes that emit, in scenes where light is linked, counted by groups, or caught: they are aimed at there too."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import ALL_LIGHT_SETS, ALL_SHADOW_SETS, Frame, Scene, Volume
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.linking import shadow_bit
from raybatch_addon.core.scene.passes import CATCHER_PASS, LIGHT_GROUP
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volume_lights import FOG, NARROW, ONCE, WIDE, assert_same_mean, over_floor, run_means
from tests.renders.volumes.test_volumes import medium, picture
from tests.support import scenes
from tests.support.feature_scenes import CATCHES
from tests.support.running.shares import each_of, thorough_but

pytestmark = pytest.mark.usefixtures("general_kernels")

GLOWS, FLAME = medium(emission=10.0), medium(1.0, emission=40.0)
PASSES = ("Combined", f"{LIGHT_GROUP}a", f"{LIGHT_GROUP}b")


def apart(scene: Scene, by=(1.2, 0.3, 0.4)) -> Scene:
    """`scene`, whose last object is moved."""
    placed = np.array(scene.instances.transform, np.float32)
    placed[-1, :, 3] += by
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=placed))


def linked(scene: Scene, lights=None, blocked_by=None) -> Scene:
    """`scene`, whose instances are each a light set, shine on the light sets `lights`, and whose light the shadow sets
    `blocked_by` block; the last is of the shadow set 1.
    """
    count = len(scene.instances)
    links = np.zeros((count, 3), np.uint64)
    links[:, 0] = np.arange(count)
    links[:, 1] = ALL_LIGHT_SETS if lights is None else lights
    links[:, 2] = ALL_SHADOW_SETS if blocked_by is None else blocked_by
    visibility = scene.instances.visibility | [shadow_bit(int(k == count - 1)) for k in range(count)]
    placed = dataclasses.replace(scene.instances, links=links, visibility=visibility.astype(np.int32))
    return dataclasses.replace(scene, instances=placed)


def grouped(scene: Scene, groups) -> Scene:
    """`scene` with passes of two groups of light, and the group of each instance."""
    frame = dataclasses.replace(scene.frame, passes=PASSES)
    placed = dataclasses.replace(scene.instances, light_group=np.array(groups, np.int32))
    return dataclasses.replace(scene, frame=frame, light_groups=("a", "b"), instances=placed)


def assert_aimed(session, scene: Scene) -> None:
    """Less noise tells that it is."""
    with_nee, alone = (picture(session, scene, **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 4, (with_nee, alone)


def test_what_is_linked_is_aimed_at(session):
    assert_aimed(session, linked(over_floor(GLOWS), lights=[ALL_LIGHT_SETS, 0b01]))


@pytest.mark.parametrize("lights", [0b001, 0b110], ids=["the floor", "all but the floor"])
def test_rays_alone_find_the_same_where_light_is_linked(session, lights, examples):
    """The second cube shines on some of the objects, among them fog that scatters."""
    scene = apart(over_floor(FOG, FLAME, edge=1.2, view=WIDE))
    scene = linked(scene, lights=[ALL_LIGHT_SETS, ALL_LIGHT_SETS, lights])
    found = [run_means(session, scene, nee=nee, bounce_max=2, sample_count=examples(256)) for nee in ("ON", "OFF")]
    assert found[0].mean() > 0
    assert_same_mean(*found)


def test_a_volume_does_not_light_what_it_is_not_linked_to(session):
    scene = linked(over_floor(GLOWS, view=NARROW), lights=[ALL_LIGHT_SETS, 0b10])
    assert not picture(session, scene, **ONCE).any()


@pytest.mark.parametrize("blocked_by", each_of(2, [0b01, 0b10]))
def test_rays_alone_find_light_that_some_objects_alone_block(session, blocked_by):
    """Scattered rays know nothing of links of shadows; the other cube is aimed at."""
    scene = apart(over_floor(GLOWS, FLAME))
    scene = linked(scene, blocked_by=[ALL_SHADOW_SETS, ALL_SHADOW_SETS, blocked_by])
    found = [run_means(session, scene, nee=nee, sample_count=512) for nee in ("ON", "OFF")]
    assert_same_mean(*found)
    assert found[0].std() < found[1].std()


def group_means(session, scene: Scene, **changes) -> dict[str, np.ndarray]:
    films = [session.render(scene, RenderSettings(**ONCE | changes, seed=seed)) for seed in range(8)]
    return {name: np.array([film.passes[name][..., :3].mean() for film in films]) for name in PASSES}


@pytest.mark.parametrize("name", ["apart", "in one another", "flame in fog"])
def test_groups_get_the_light_of_their_volumes(session, name, examples):
    volumes = (FOG, FLAME) if name == "flame in fog" else (GLOWS, medium(emission=4.0))
    scene = over_floor(*volumes, edge=1.2, view=WIDE)
    scene = grouped(apart(scene) if name == "apart" else scene, [-1, 0, 1])
    count = 512 if name == "flame in fog" else examples(512)  # there, light is rarer
    on, off = (group_means(session, scene, nee=nee, sample_count=count) for nee in ("ON", "OFF"))
    for each in PASSES:
        assert off[each].mean() > 0, each
        assert_same_mean(on[each], off[each])
    if name == "apart":  # nothing is in no group
        for found in (on, off):
            np.testing.assert_allclose(found["Combined"], sum(found[each] for each in PASSES[1:]), rtol=1e-4)


def test_what_is_in_a_group_is_aimed_at(session):
    assert_aimed(session, grouped(over_floor(GLOWS), [-1, 0]))


def left_to_rays(emission: float) -> Volume:
    """Emits the same for all kinds of rays, though its program asks for them."""
    builder = ProgramBuilder()
    nothing = builder.value("math", int(MathOperation.MULTIPLY), False, builder.value("light_path")[0], 0.0, 0.0)
    light = builder.value("math", int(MathOperation.ADD), False, nothing, emission, 0.0)
    builder.closure("emission", builder.value("splat", light))
    return Volume(program=builder.finish())


def on_catcher(volume=GLOWS, catches=(0,)) -> Scene:
    """A cube that emits, over a floor that a sun lights; instances that are catchers."""
    view = scenes.camera(eye=(0, -4, 2), half_width=1e-3)
    frame = Frame(8, 8, passes=("Combined", CATCHER_PASS), transparent=True)
    scene = over_floor(volume, edge=0.8, view=view, frame=frame)
    visibility = np.array(scene.instances.visibility)
    visibility[list(catches)] = CATCHES
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=visibility))
    return dataclasses.replace(scene, lights=(scenes.sun(1.0, 0.0),))


CATCHERS = {"the floor": (0,), "the volume too": (0, 1)}


@pytest.mark.parametrize("catcher", thorough_but(["the floor"], CATCHERS))
def test_catchers_get_the_light_of_volumes(session, catcher):
    """That of catchers they get without other objects too."""
    found = []
    for volume, count in ((GLOWS, 256), (left_to_rays(10.0), 1024)):
        asked = [RenderSettings(**ONCE | dict(sample_count=count, seed=seed)) for seed in range(8)]
        films = [session.render(on_catcher(volume, CATCHERS[catcher]), each) for each in asked]
        found.append(np.array([film.passes[CATCHER_PASS][..., :3].mean() for film in films]))
    if catcher == "the volume too":  # the same light in both of what is divided
        np.testing.assert_allclose(found, 1.0, rtol=1e-5)
    else:
        assert found[0].mean() > 1.5
        assert_same_mean(*found)
        assert found[0].std() < found[1].std() / 2


def test_kernels_of_such_scenes_aim_at_volumes():
    lit = over_floor(GLOWS)
    for scene in (linked(lit, lights=[ALL_LIGHT_SETS, 1]), grouped(lit, [-1, 0]), on_catcher()):
        assert derive_features(scene, RenderSettings()).volume_lights
