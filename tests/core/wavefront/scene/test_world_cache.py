"""The sampling of a world is kept where the world is the same, and made anew where it is not."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Frame, Image, Visibility, World
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.estimates import launch
from raybatch_addon.core.wavefront.scene import device_scene
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
        (scene_of(world_of(window=True)), 5),
        (scene_of(world_of(window=True), eye=(1, -4, 0)), 6),  # it looks at the camera
    ]
    for scene, count in steps:
        film = session.render(scene, SETTINGS)
        assert len(made) == count
        expected = Session(DEVICE).render(scene, SETTINGS)
        made.pop()
        assert np.array_equal(film.passes["Combined"], expected.passes["Combined"])
    assert session._cache.world.device_bytes == 4 * (8 + 8 * 16)
    session.render(replace(scene_of(world), world=World(radiance=(1.0, 1.0, 1.0))), SETTINGS)
    assert session._cache.world.device_bytes == 0


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
