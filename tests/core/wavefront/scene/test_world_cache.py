"""The sampling of a world is kept where the world is the same, and made anew where it is not."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Frame, Image, SkySun, Visibility, World
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights.world import WorldLight, sampled_world
from raybatch_addon.core.wavefront.estimates import launch
from raybatch_addon.core.wavefront.scene import device_scene
from raybatch_addon.core.wavefront.scene.world_cache import WorldCache
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=1, bounce_max=1)
PIXELS = freeze(np.random.default_rng(3).random((8, 16, 4)).astype(np.float32))


def world_of(strength=1.0, window=False):
    """An environment image, or the window's coordinates, times a number."""
    builder = ProgramBuilder()
    if window:
        color = builder.value("window_coordinates", 0)
    else:
        color, _ = builder.value("environment", 0, 1, 0, 0, builder.value("position", 0))
    builder.closure("emission", builder.value("multiply_colors", color, (strength,) * 3))
    return World(program=builder.finish(), sampling_size=16)


def scene_of(world, place=0.0, image=Image("sky", PIXELS), eye=(0, -4, 0)):
    made = scenes.scene(
        [(scenes.box(), scenes.translation(place, 0, 0), scenes.diffuse())],
        view=scenes.camera(eye=eye),
        frame=Frame(8, 8),
    )
    return replace(made, world=world, images=(image,))


@pytest.fixture
def made(monkeypatch):
    """Sizes of the tables that were made."""
    sizes = []
    real = device_scene.world_texels

    def texels(data, features, width, device):
        sizes.append(width)
        return real(data, features, width, device)

    monkeypatch.setattr(device_scene, "world_texels", texels)
    return sizes


def test_a_world_is_tabulated_again_only_where_it_is_another(made):
    session, world = Session(DEVICE), world_of()
    image = Image("sky", PIXELS)
    steps = [
        (scene_of(world, image=image), 1),
        # made anew, but of the same pixels, as exporters do it; other things moved
        (scene_of(world_of(), 0.5, Image("sky", PIXELS), eye=(1, -4, 0)), 1),
        (scene_of(world_of(2.0), image=image), 2),
        (scene_of(world_of(2.0), image=Image("sky", PIXELS[::-1].copy())), 3),
        (replace(scene_of(world_of(2.0)), world=replace(world_of(2.0), sampling_size=32)), 4),
        (replace(scene_of(world_of(2.0)), world=replace(world_of(2.0), sun=SkySun((0.0, 0.0, 1.0), 0.4))), 5),
        (replace(scene_of(world_of(2.0)), world=replace(world_of(2.0), sun=SkySun((0.0, 0.6, 0.8), 0.4))), 6),
        (scene_of(world_of(window=True)), 7),
        (scene_of(world_of(window=True), eye=(1, -4, 0)), 8),  # it looks at the camera
    ]
    for scene, count in steps:
        film = session.render(scene, SETTINGS)
        assert len(made) == count
        expected = Session(DEVICE).render(scene, SETTINGS)
        made.pop()
        assert np.array_equal(film.passes["Combined"], expected.passes["Combined"])
    assert session._at[0].cache.world.device_bytes == 4 * (8 + 8 * 16)
    session.render(replace(scene_of(world), world=World(radiance=(1.0, 1.0, 1.0))), SETTINGS)
    assert session._at[0].cache.world.device_bytes == 0


def test_pixels_that_may_change_are_looked_at_anew(made):
    session = Session(DEVICE)
    pixels = PIXELS.copy()
    scene = scene_of(world_of(), image=Image("sky", pixels))
    session.render(scene, SETTINGS)
    pixels[:, :, :3] = 0
    pixels[5, 3, :3] = 100.0
    film = session.render(scene, SETTINGS)
    assert len(made) == 2
    expected = Session(DEVICE).render(scene, SETTINGS)
    assert np.array_equal(film.passes["Combined"], expected.passes["Combined"])


def test_an_even_world_is_left_to_scattered_rays():
    """No shadow ray is sent to a world that is the same everywhere, nor to a black one, and the picture is that of the
    plain world; one that only some rays see is aimed at all the same.
    """
    even = Image("sky", np.full((8, 16, 4), 0.5, np.float32))
    seen = []
    for world, image in ((world_of(), even), (world_of(0.0), even), (world_of(), Image("sky", PIXELS))):
        film = Session(DEVICE).render(scene_of(world, image=image), SETTINGS)
        seen.append((film.statistics["rays"]["shadow"], film.passes["Combined"]))
    assert seen[0][0] == seen[1][0] == 0 < seen[2][0]
    plain = Session(DEVICE).render(replace(scene_of(world_of()), world=World(radiance=(0.5, 0.5, 0.5))), SETTINGS)
    np.testing.assert_allclose(seen[0][1], plain.passes["Combined"], rtol=1e-5)
    assert not seen[1][1][..., :3].any()
    in_part = replace(world_of(), visibility=Visibility.ALL & ~Visibility.GLOSSY)
    assert Session(DEVICE).render(scene_of(in_part, image=even), SETTINGS).statistics["rays"]["shadow"] > 0


def test_a_world_that_looks_at_rays_is_aimed_at_though_one_kind_sees_it_even():
    """Texels are those that a ray of no kind sees: here all are black."""
    builder = ProgramBuilder()
    is_diffuse = builder.value("light_path")[2]
    builder.closure("emission", builder.value("combine_xyz", is_diffuse, is_diffuse, is_diffuse))
    world = World(program=builder.finish(), sampling_size=16)
    assert Session(DEVICE).render(scene_of(world), SETTINGS).statistics["rays"]["shadow"] > 0


def test_texels_have_more_points_where_they_differ_from_those_around_them(monkeypatch):
    """A pale sky with a bright patch: there the mean of four points counts, and one point elsewhere."""
    pixels = np.full((8, 16, 4), 0.5, np.float32)
    pixels[3, 5, :3] = 40.0
    scene = scene_of(world_of(), image=Image("sky", freeze(pixels)))
    found = []
    real = device_scene.world_texels
    monkeypatch.setattr(device_scene, "world_texels", lambda *arguments: found.append(real(*arguments)) or found[-1])

    def texels(difference):
        monkeypatch.setattr(launch, "_TEXEL_DIFFERENCE", difference)
        Session(DEVICE).render(replace(scene, world=replace(scene.world, sampling_size=64)), SETTINGS)
        return found[-1]

    default = launch._TEXEL_DIFFERENCE
    one, four, chosen = texels(1e30), texels(-1.0), texels(default)
    differs = one != four
    assert 0 < differs.sum() < differs.size / 4 and np.array_equal(chosen[differs], four[differs])
    assert (chosen == one)[~differs].all()
    rough = launch._is_rough(one)
    assert rough[differs].all() and rough.sum() < rough.size / 4


def of_rays(output):
    """A world that is as bright as an output of Light Path says."""
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("splat", builder.value("light_path")[output]))
    return World(program=builder.finish(), sampling_size=16)


SPOT = np.ones((8, 16), np.float32)
SPOT[2, 3] = 99.0
PORTAL = scenes.area_light(0.0, 1.0)


@pytest.mark.parametrize(
    "world, beside_rays, by_excess",
    [
        (world_of(), True, True),
        (world_of(), False, False),
        (of_rays(0), True, True),  # no scattered ray is one of the camera
        (of_rays(3), True, False),
        (replace(world_of(), visibility=Visibility.ALL & ~Visibility.GLOSSY), True, False),
        (replace(world_of(), portals=(PORTAL,)), True, False),
    ],
    ids=["plain", "alone", "camera", "glossy", "seen in part", "portals"],
)
def test_what_rays_find_as_well_is_not_aimed_at(world, beside_rays, by_excess):
    device = wp.get_device(DEVICE)
    found = WorldCache().get(scene_of(world), device, lambda: WorldLight(SPOT), beside_rays)
    expected = sampled_world(WorldLight(SPOT), device, beside_rays=by_excess)
    np.testing.assert_array_equal(found.irradiance, expected.irradiance)
    np.testing.assert_array_equal(found.table.first.numpy(), expected.table.first.numpy())


def test_a_world_that_only_cameras_tell_apart_is_left_to_rays_where_it_is_even():
    device = wp.get_device(DEVICE)
    even = np.ones((8, 16), np.float32)
    assert WorldCache().get(scene_of(of_rays(0)), device, lambda: WorldLight(even), True) is None
    assert WorldCache().get(scene_of(of_rays(2)), device, lambda: WorldLight(even), True) is not None


@pytest.mark.parametrize("visibility", [Visibility.ALL & ~Visibility.GLOSSY, Visibility.ALL & ~Visibility.TRANSMISSION])
def test_a_world_that_some_rays_do_not_see_lights_what_they_have_nothing_to_do_with(visibility):
    """A diffuse floor, beside a lamp, is as bright as in the same world that all rays see."""
    floor = scenes.plane(), scenes.IDENTITY, scenes.diffuse(0.5)
    lamp = scenes.area_light(1.0, 0.5, scenes.translation(0, 0, 2))
    view = scenes.camera(eye=(0, -0.5, 3), half_width=0.1)
    means = []
    for seen in (visibility, Visibility.ALL):
        made = scenes.scene([floor], view=view, frame=Frame(16, 16), lights=[lamp])
        made = replace(made, world=replace(world_of(), visibility=seen), images=(Image("sky", PIXELS),))
        film = Session(DEVICE).render(made, SETTINGS.replace(sample_count=256))
        means.append(film.passes["Combined"][..., :3].mean((0, 1)))
    np.testing.assert_allclose(means[0], means[1], rtol=0.01)


def test_a_world_that_the_camera_alone_sees_lights_nothing():
    floor = scenes.plane(), scenes.IDENTITY, scenes.diffuse(0.5)
    made = scenes.scene([floor], view=scenes.camera(eye=(0, -0.5, 3), half_width=0.1), frame=Frame(4, 4))
    made = replace(made, world=replace(world_of(), visibility=Visibility.CAMERA), images=(Image("sky", PIXELS),))
    film = Session(DEVICE).render(made, SETTINGS.replace(sample_count=4))
    assert film.passes["Combined"][..., :3].max() == 0
