"""Directions to the sun of a sky are chosen within it, with the density that is stated."""

import math
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Frame, Image, SkySun, World
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights import world_sun
from raybatch_addon.core.shading.lights.world import (
    WorldLight,
    WorldTable,
    is_even,
    sample_world,
    sampled_world,
    world_pdf,
)
from raybatch_addon.core.sky.atmosphere import SunDisc, sky_table, sun_direction
from tests.support import scenes
from tests.support.under_test import DEVICE

COUNT = 1 << 14
ELEVATIONS = [math.pi / 2, math.pi / 2 - 0.003, 0.6, 0.0, -1.2]
WHITE = (0.95046, 1.0, 1.08906)  # XYZ


@wp.kernel
def draw(table: WorldTable, direction: wp.array(dtype=wp.vec3), pdf: wp.array(dtype=wp.vec2)):
    i = wp.tid()
    rng = wp.rand_init(7, i)
    found = sample_world(table, wp.vec2(wp.randf(rng), wp.randf(rng)))
    direction[i] = found.direction
    pdf[i] = wp.vec2(found.pdf, world_pdf(table, found.direction))


def drawn(table):
    direction = wp.zeros(COUNT, dtype=wp.vec3, device=DEVICE)
    pdf = wp.zeros(COUNT, dtype=wp.vec2, device=DEVICE)
    wp.launch(draw, COUNT, [table], [direction, pdf], device=DEVICE)
    return direction.numpy().astype(float), pdf.numpy().astype(float)


def angle_between(directions, axis):
    """Precise for small angles."""
    return 2 * np.arctan2(np.linalg.norm(directions - axis, axis=1), np.linalg.norm(directions + axis, axis=1))


def sun_at(elevation, size, azimuth=0.7):
    return SkySun(sun_direction(elevation, azimuth), size)


def sky(height=64):
    rows = np.linspace(2.0, 1.0, height, dtype=np.float32)[:, None]
    return np.repeat(rows, 2 * height, 1)


@pytest.mark.parametrize("elevation", ELEVATIONS)
@pytest.mark.parametrize("size", [0.0005, 0.0095, 0.3, 3.0])
def test_directions_within_are_spread_evenly(elevation, size):
    sun = sun_at(elevation, size)
    found = world_sun.directions_within(sun, 4096).astype(float)
    angle = angle_between(found, np.array(sun.direction))
    assert angle.max() <= size / 2 + 2e-7
    # 1 - cos of the angle is uniform, and so is the angle around
    assert np.mean(np.sin(angle / 2) ** 2) == pytest.approx(math.sin(size / 4) ** 2 / 2, rel=1e-2)
    mean, length = found.mean(0), np.linalg.norm(found.mean(0))
    assert angle_between(mean[None] / length, np.array(sun.direction))[0] < 0.01 * size
    assert length == pytest.approx(math.cos(size / 4) ** 2, rel=1e-4)


@pytest.mark.parametrize("elevation", ELEVATIONS)
@pytest.mark.parametrize("size", [0.0005, 0.0095, 0.3])
def test_texels_that_show_the_sun_are_as_bright_as_the_sky_around(elevation, size):
    """And no others are touched."""
    sun = sun_at(elevation, size)
    clean = sky()
    height, width = clean.shape
    theta = ((np.arange(height * width) // width + 0.5) / height * np.pi)[:, None]
    phi = ((np.arange(height * width) % width + 0.5) / width * 2 * np.pi)[:, None]
    centres = np.hstack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    angle = angle_between(centres, np.array(sun.direction)).reshape(clean.shape)
    shows = angle < size / 2 + 0.72 * np.pi / height
    assert shows.any()
    lit = np.where(shows, np.float32(1e6), clean)
    found = world_sun.without_sun(lit, sun)
    assert found[shows].max() < 1.1 * clean[angle < size / 2 + 5 * np.pi / height].max()
    assert (found[~shows] >= 0.9 * clean[~shows]).all()  # at most the rim's texels are a little darker
    far = angle > size / 2 + 2 * np.pi / height
    assert np.array_equal(found[far], clean[far])


@pytest.mark.parametrize("elevation", ELEVATIONS)
@pytest.mark.parametrize("size", [0.0005, 0.0095, 0.3])
@pytest.mark.parametrize("beside_rays", [False, True])
def test_densities_are_those_of_the_sun_and_the_table_together(elevation, size, beside_rays):
    sun = sun_at(elevation, size)
    radiance = 3 * 4 * math.pi * 1.5 / world_sun.solid_angle(sun)  # three times as much light as the sky's
    table = sampled_world(WorldLight(sky(), sun, radiance), wp.get_device(DEVICE), beside_rays=beside_rays).table
    share = 1.0 - 1e-3 if beside_rays else 0.75
    assert table.sun.share == pytest.approx(share, abs=0.02)
    direction, pdf = drawn(table)
    assert np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 1e-6
    inside = angle_between(direction, np.array(sun.direction)) <= size / 2 * 1.001 + 3e-7
    assert inside.mean() == pytest.approx(share, abs=0.02)
    # but for directions that rounding takes across the cone's edge, both say the same
    same = np.abs(pdf[:, 0] / pdf[:, 1] - 1) < 1e-4
    assert same.mean() > 0.99
    assert (pdf[:, 0] >= 0.999 * pdf[:, 1]).all(), "a direction that is chosen often must not count as a rare one"
    # integrals over the cone, and over the sphere but for it
    cone = 4 * math.pi * math.sin((size / 2 * 1.001 + 3e-7) / 2) ** 2
    assert np.where(inside, 1 / pdf[:, 0], 0).mean() == pytest.approx(cone, rel=0.03)
    if not beside_rays:
        assert np.where(inside, 0, 1 / pdf[:, 0]).mean() == pytest.approx(4 * math.pi - cone, rel=0.06)


def test_a_world_with_a_sun_competes_by_all_of_its_light():
    """As much as by a fine table that has the sun in its texels."""
    sun = sun_at(0.6, 0.1)
    clean = sky(512)
    height, width = clean.shape
    theta = ((np.arange(height) + 0.5) / height * np.pi)[:, None]
    phi = (np.arange(width) + 0.5) / width * 2 * np.pi
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi
    axis = np.array(sun.direction)
    lit = np.where(x * axis[0] + y * axis[1] + z * axis[2] > math.cos(0.05), np.float32(500), clean)
    device = wp.get_device(DEVICE)
    expected = sampled_world(WorldLight(lit), device).irradiance
    found = sampled_world(WorldLight(clean, sun, 500.0), device).irradiance
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.02 * expected[0])


def test_a_sun_that_does_not_shine_leaves_its_world_as_it_is():
    device, light = wp.get_device(DEVICE), sky()
    dark = sampled_world(WorldLight(light, sun_at(0.6, 0.01), 0.0), device)
    plain = sampled_world(WorldLight(light), device)
    assert dark.table.sun.share == 0
    np.testing.assert_array_equal(dark.irradiance, plain.irradiance)
    np.testing.assert_array_equal(dark.table.first.numpy(), plain.table.first.numpy())


def test_a_world_with_a_sun_is_not_even():
    even = np.ones((8, 16), np.float32)
    assert is_even(WorldLight(even)) and is_even(WorldLight(even, sun_at(0.6, 0.01), 0.0))
    assert not is_even(WorldLight(even, sun_at(0.6, 0.01), 10.0))


def floor_under(elevation, size, sun, radiance):
    """A black sky with a white sun, above a grey floor."""
    builder = ProgramBuilder()
    table = sky_table(SunDisc(WHITE, WHITE), elevation, 0.7, size, radiance, 100.0)
    color = builder.value("sky_scattering", 0, table, builder.value("position", 0))
    builder.closure("emission", color)
    black = Image("sky", np.zeros((2, 4, 3), np.float32))
    floor = scenes.plane(), scenes.IDENTITY, scenes.diffuse(0.5)
    made = scenes.scene([floor], view=scenes.camera(eye=(0, -0.5, 3), half_width=0.1), frame=Frame(8, 8))
    return replace(made, world=World(program=builder.finish(), sampling_size=256, sun=sun), images=(black,))


@pytest.mark.parametrize("elevation", [math.pi / 2, 0.6, 0.1])
@pytest.mark.parametrize("size", [0.0005, 0.0095, 0.2])
@pytest.mark.parametrize("change", [{}, {"mis": "OFF"}], ids=["", "mis off"])
@pytest.mark.usefixtures("general_kernels")
def test_a_floor_in_the_sun_is_as_bright_as_it_must_be(elevation, size, change):
    """The limb darkens to 0.4: its mean over the disc is 0.8. And there is hardly any noise."""
    radiance = 1.0 / (math.pi * (size / 2) ** 2)
    settings = RenderSettings(device=DEVICE, sample_count=64, bounce_max=1, **change)
    film = Session(DEVICE).render(floor_under(elevation, size, sun_at(elevation, size), radiance), settings)
    picture = film.passes["Combined"][..., 1].astype(float)
    # of a disc of 0.2 rad the sine of the angle from its middle is a little less than the angle
    assert picture.mean() == pytest.approx(0.5 / math.pi * 0.8 * math.sin(elevation), rel=6e-3)
    assert picture.std() < 0.06 * picture.mean()


@pytest.mark.usefixtures("general_kernels")
def test_a_sun_said_to_be_elsewhere_changes_noise_alone():
    size, radiance = 0.3, 10.0
    means = []
    for sun in (None, sun_at(0.6, size), sun_at(0.7, size), sun_at(0.6, 0.1), sun_at(0.6, 1.0), sun_at(-0.6, size)):
        settings = RenderSettings(device=DEVICE, sample_count=1024, bounce_max=1)
        film = Session(DEVICE).render(floor_under(0.6, size, sun, radiance), settings)
        means.append(film.passes["Combined"][..., 1].astype(float).mean())
    np.testing.assert_allclose(means, means[1], rtol=0.01)
