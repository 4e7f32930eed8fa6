"""Volumes that emit, whose points are aimed at: closed forms, the light that scattered rays find, and its noise."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.scene.description import Frame, Scene, Visibility, Volume
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import bytes_per_path
from tests.renders.volumes.test_volumes import filled, medium, picture
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

ALBEDO, EDGE, PLACE = 0.8, 0.2, np.array([0.3, 0.1, 1.0])
NARROW = scenes.camera(eye=(0, -4, 2), half_width=1e-4)
# Standard error of a difference of means, beside the mean: what is lost or counted twice would be more than 5 of them
ERROR_MOST = 0.03
ONCE = dict(bounce_max=0, sample_count=64)


def rising(emission: float, absorption=0.0) -> Volume:
    """By a program: as bright as it is high, in the world, to the fourth power; it absorbs evenly."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    square = builder.value("math", 2, False, height, height, 0.0)
    fourth = builder.value("math", 2, False, square, square, 0.0)
    builder.closure(
        "emission", builder.value("multiply_colors", Value.of((emission,) * 3), builder.value("splat", fourth))
    )
    builder.closure("volume_absorption", (absorption,) * 3)
    return Volume(program=builder.finish())


def over_floor(*volumes: Volume, edge=EDGE, place=PLACE, view=NARROW, frame=Frame(8, 8)) -> Scene:
    """Small cubes of `volumes`, the second of which begins within the first, over a floor; there is no other light."""
    floor = scenes.plane(size=40), scenes.IDENTITY, scenes.diffuse(ALBEDO)
    cubes = [
        (scenes.box(f"{k}", edge), scenes.translation(*(place + k * np.array([0.3, 0.2, 0.25]) * edge)), filled(volume))
        for k, volume in enumerate(volumes)
    ]
    return scenes.scene([floor, *cubes], view=view, frame=frame)


def floor_radiance(emission, absorption: float) -> float:
    """Radiance of the floor below a cube, by quadrature over its points; `emission(points)` [W/(m³ sr)]."""
    nodes, weights = np.polynomial.legendre.leggauss(48)
    local = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), -1).reshape(-1, 3) * EDGE / 2
    weight = np.einsum("i,j,k", weights, weights, weights).ravel() * (EDGE / 2) ** 3
    points = local + PLACE
    square = (points**2).sum(1)
    down = -points / np.sqrt(square)[:, None]
    way = ((np.sign(down) * EDGE / 2 - local) / down).min(1)  # to the face through which light leaves
    light = weight * emission(points) * np.exp(-absorption * way) * -down[:, 2] / square
    return ALBEDO / math.pi * float(light.sum())


def run_means(session, scene, runs=8, **changes) -> np.ndarray:
    """Means of pictures of several seeds, shape [runs]."""
    return np.array([picture(session, scene, seed=seed, **ONCE | changes).mean() for seed in range(runs)])


def assert_same_mean(first: np.ndarray, second: np.ndarray) -> None:
    error = math.hypot(first.std(ddof=1), second.std(ddof=1)) / math.sqrt(len(first))
    assert error < ERROR_MOST * second.mean(), (first, second)
    assert abs(first.mean() - second.mean()) < 5 * error, (first.mean(), second.mean(), error)


@pytest.mark.parametrize(
    "volume, emission, absorption",
    [
        (medium(emission=10.0), lambda points: 10.0, 0.0),
        (medium(8.0, emission=10.0), lambda points: 10.0, 8.0),
        (rising(10.0, 4.0), lambda points: 10.0 * points[:, 2] ** 4, 4.0),
    ],
    ids=["clear", "absorbing", "program"],
)
def test_the_light_of_a_small_cube_on_a_floor(session, volume, emission, absorption):
    """Its integral is known, and what noise is left is a small part of it: rays alone would miss the cube mostly."""
    expected = floor_radiance(emission, absorption)
    scene = over_floor(volume)
    means = run_means(session, scene, sample_count=256)
    assert abs(means.mean() - expected) < 5 * means.std(ddof=1) / math.sqrt(len(means)) + 1e-4 * expected, (
        means,
        expected,
    )
    with_nee, alone = (picture(session, scene, **ONCE, nee=nee).var() for nee in ("ON", "OFF"))
    assert with_nee < alone / 10, (with_nee, alone)


FOG = medium(0.2, 0.6, 0.3, g=0.3)
WIDE = scenes.camera(eye=(0, -4, 2), half_width=0.3)


def sheared(scene: Scene) -> Scene:
    """`scene`, whose last object is placed by a matrix that is no rotation."""
    placed = np.array(scene.instances.transform, np.float32)
    placed[-1, :, :3] = [[0.8, 0.5, 0.0], [0.0, 1.5, 0.3], [-0.4, 0.0, 1.2]]
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=placed))


def shared(scene: Scene) -> Scene:
    """`scene`, whose last object is one more of the mesh of that before it, elsewhere and mirrored."""
    placed, mesh = np.array(scene.instances.transform, np.float32), np.array(scene.instances.mesh)
    placed[-1, :, :3] = np.diag([-1.5, 0.8, 1.0])
    placed[-1, :, 3] += (0.4, 0.3, 0.2)
    mesh[-1] = mesh[-2]
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, transform=placed, mesh=mesh))


OTHERS = {
    "two in one another": over_floor(medium(1.0, emission=4.0), rising(8.0, 2.0), edge=0.6),
    "scatters": over_floor(FOG, edge=1.2, place=np.array([0.3, 0.0, 0.8]), view=WIDE),
    "in fog that shines": over_floor(FOG, medium(emission=3.0), edge=1.2, view=WIDE),
    "of one mesh": shared(over_floor(rising(6.0, 1.0), medium(1.0, emission=4.0), edge=0.5)),
    "sheared": sheared(over_floor(rising(6.0, 1.0), edge=0.5)),
    "camera inside": over_floor(FOG, edge=1.2, place=np.array([0.0, -3.9, 2.0]), view=WIDE),
}


@pytest.mark.parametrize("name", OTHERS)
def test_points_that_are_aimed_at_and_rays_alone_find_the_same(session, name):
    found = [run_means(session, OTHERS[name], nee=nee, bounce_max=2) for nee in ("ON", "OFF")]
    assert found[0].mean() > 1e-3
    assert_same_mean(*found)


# General kernels weigh by both ways: these changes have kernels of their own, which tests share
UNWEIGHED = dict(mis="OFF", roulette_bounce=99)


@pytest.mark.parametrize("volume", [medium(1.0, emission=4.0), FOG], ids=["absorbs", "scatters"])
def test_they_do_where_neither_way_is_weighed_by_the_other(session, volume):
    scene = over_floor(volume, rising(8.0, 2.0), edge=0.8, view=WIDE)
    found = [run_means(session, scene, nee=nee, bounce_max=2, **UNWEIGHED) for nee in ("ON", "OFF")]
    assert found[0].mean() > 1e-3
    assert_same_mean(*found)


def test_a_part_of_a_picture_may_do_without(session):
    """The left half aims at the volume, and the right half meets it by chance."""
    scene = over_floor(FOG, edge=1.2, place=np.array([0.0, 0.0, 0.8]))
    found = np.array([picture(session, scene, seed=seed, nee="HALF", **ONCE) for seed in range(8)])
    assert_same_mean(found[:, :, :4].mean((1, 2, 3)), found[:, :, 4:].mean((1, 2, 3)))


def test_its_light_is_in_the_same_pass_whichever_way_it_was_found(session):
    names = ("Combined", "Emission", "Diffuse Direct", "Diffuse Indirect", "Volume Direct", "Volume Indirect")
    scene = over_floor(FOG, edge=1.2, view=WIDE, frame=Frame(8, 8, passes=names))
    found = {}
    for nee in ("ON", "OFF"):
        films = [
            session.render(scene, RenderSettings(seed=k, nee=nee, sample_count=192, bounce_max=2)) for k in range(8)
        ]
        found[nee] = {name: np.array([film.passes[name][..., :3].mean() for film in films]) for name in names}
    for name in names:
        assert found["OFF"][name].mean() > 0, name
        assert_same_mean(found["ON"][name], found["OFF"][name])


@pytest.mark.parametrize("volume", [medium(0.1, (0.5, 1.0, 2.0), 0.1), rising(3.0, 1.0)], ids=["fixed", "program"])
def test_no_schedule_changes_its_film(session, volume):
    scene = over_floor(volume, edge=0.8, view=WIDE)
    plain = picture(session, scene, bounce_max=3)
    assert plain.std() > 0
    for changes in ({"tile_size": 3}, {"ray_count": 64}, {"sample_order": "FRAME_FIRST"}, {"batching": "ON"}):
        assert np.array_equal(picture(session, scene, bounce_max=3, **changes), plain), changes


def test_a_scene_without_such_a_volume_does_without_its_code_and_memory():
    settings = RenderSettings()
    with_one, without = (derive_features(over_floor(each), settings) for each in (medium(emission=1.0), medium(1.0)))
    assert with_one.volume_lights and with_one.shadow_rays and "volumes as lights" not in with_one.left_out()
    assert not without.volume_lights and not without.shadow_rays and "volumes as lights" in without.left_out()
    lamps = scenes.area_light(1.0), scenes.area_light(2.0)
    lit = [dataclasses.replace(over_floor(each), lights=lamps) for each in (medium(emission=1.0), medium(1.0))]
    more, less = (bytes_per_path(derive_features(each, settings)) for each in lit)
    assert more == less + 4
    assert not derive_features(over_floor(medium(emission=1.0)), settings.replace(nee="OFF")).volume_lights


def test_rays_alone_find_light_of_volumes_that_differs_by_ray():
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("splat", builder.value("light_path")[0]))
    assert not derive_features(over_floor(Volume(program=builder.finish())), RenderSettings()).volume_lights


def test_a_volume_that_some_rays_do_not_see_is_left_to_rays(session):
    """Shadow rays would not find that they are in it."""
    scene = over_floor(medium(emission=10.0), edge=1.0)
    visibility = np.array(scene.instances.visibility)
    visibility[-1] &= ~int(Visibility.SHADOW)
    hidden = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=visibility))
    assert_same_mean(run_means(session, hidden), run_means(session, scene))
