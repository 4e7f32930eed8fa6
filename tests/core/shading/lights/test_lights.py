"""Lights without mesh against closed forms: irradiance, densities, and the light that rays meet."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.scene.description import Light, LightKind, Visibility
from raybatch_addon.core.shading.lights.lights import LightFeatures, make_lights
from tests.core.shading.lights.light_probe import (
    ALL,
    COUNT,
    DEVICES,
    UP,
    assert_mean,
    facing,
    kernel_for,
    polygon_irradiance,
    probe,
    scene_of,
)
from tests.support.under_test import SOURCE_SUFFIX


def area_quadrature(light, position, normal, count=1201):
    """Irradiance under an area light by a midpoint rule, spread included."""
    m = light.transform.astype(float)
    g = (np.arange(count) + 0.5) / count - 0.5
    u, v = np.meshgrid(g, g)
    inside = (u * u + v * v <= 0.25) if light.kind == LightKind.ELLIPSE else np.ones_like(u, bool)
    points = m[:, 3] + u[..., None] * light.size[0] * m[:, 0] + v[..., None] * light.size[1] * m[:, 1]
    to = points - np.asarray(position)
    square = (to**2).sum(-1)
    direction = to / np.sqrt(square)[..., None]
    there = np.maximum(direction @ m[:, 2], 0)
    here = np.maximum(direction @ normal, 0)
    factor = np.ones_like(there)
    if light.spread < np.pi:
        a = light.spread / 2
        tangent = np.sqrt(np.maximum(1 - there**2, 0)) / np.maximum(there, 1e-9)
        factor = np.maximum((np.tan(a) - tangent) / (np.tan(a) - a), 0)
    return (inside * factor * there * here / square).mean() * light.size[0] * light.size[1] * light.emission[0]


D = np.array([0.5, -0.3, 2.0])  # from the shaded point (the origin) to the lights
DIST2 = float(D @ D)
COSINE = D[2] / np.sqrt(DIST2)


def sized_lights():
    down = facing(D, -D)
    tilted = facing(D, (0.1, 0.3, -1.0))
    yield "sphere", Light("l", LightKind.POINT, down, (3, 2, 1), radius=0.4, soft_falloff=False)
    yield "disk", Light("l", LightKind.POINT, down, (3, 2, 1), radius=0.4)
    yield (
        "spot sphere",
        Light("l", LightKind.SPOT, down, (3, 2, 1), radius=0.4, soft_falloff=False, angle=0.5, blend=0.7),
    )
    yield (
        "spot disk",
        Light("l", LightKind.SPOT, tilted, (3, 2, 1), radius=0.4, angle=1.2, blend=1.0, spot_scale=(0.5, 1.3)),
    )
    yield "sun", Light("l", LightKind.SUN, facing((0, 0, 0), -D), (3, 2, 1), angle=0.6)
    yield "rectangle", Light("l", LightKind.RECTANGLE, tilted, (3, 2, 1), size=(1.5, 0.7))
    yield "far rectangle", Light("l", LightKind.RECTANGLE, tilted, (3, 2, 1), size=(0.03, 0.05))
    yield "ellipse", Light("l", LightKind.ELLIPSE, tilted, (3, 2, 1), size=(1.5, 0.7))
    yield "spread rectangle", Light("l", LightKind.RECTANGLE, tilted, (3, 2, 1), size=(1.5, 2.5), spread=1.0)
    yield "spread ellipse", Light("l", LightKind.ELLIPSE, tilted, (3, 2, 1), size=(2.5, 1.7), spread=0.8)


SIZED = dict(sized_lights())


@pytest.mark.parametrize("name", SIZED)
def test_sampled_and_met_lights_agree(name):
    """A ray along a sampled direction meets the light with the same density and radiance, and no others find it."""
    r = probe(scene_of(SIZED[name]))
    found = r.pdf > 0
    assert found.mean() > 0.3 and (r.delta == 0).all()
    # equal densities weigh one half each
    lit = found & (r.radiance[:, 0] > 0)
    agree = np.isclose(r.met[lit], r.radiance[lit] / 2, rtol=2e-3).all(1)
    assert agree.mean() > 0.999  # at the very rim, rounding decides


@pytest.mark.parametrize("name", SIZED)
def test_density_integrates_to_one(name):
    light = SIZED[name]
    axis = D / np.sqrt(DIST2)
    r = probe(scene_of(light), cone_axis=axis, cone=0.02 if name == "far rectangle" else 0.25)
    # density of the light sampler along each direction, from the weight that it left
    met = r.cone_met[:, 0] > 0
    weight = r.cone_weighted[met, 0] / r.cone_met[met, 0]
    density = np.zeros(len(met))
    density[met] = np.sqrt(np.maximum(1 / weight - 1, 0)) / r.cone_solid_angle
    expected = (r.radiance[:, 0] > 0).mean()  # part of the samples that carry light
    assert_mean(density * r.cone_solid_angle, expected, relative=0.01)


@pytest.mark.parametrize("name", SIZED)
@pytest.mark.parametrize("device", DEVICES)
def test_irradiance_by_light_sampling_scattering_and_both(name, device):
    light = SIZED[name]
    if light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
        expected = area_quadrature(light, (0, 0, 0), UP)
        if name == "rectangle":
            m = light.transform.astype(float)
            corners = [
                m[:, 3] + sx * 0.75 * m[:, 0] + sy * 0.35 * m[:, 1] for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))
            ]
            assert polygon_irradiance(np.array(corners), UP, 3) == pytest.approx(expected, rel=1e-4)
    elif light.kind == LightKind.SUN:
        expected = 3 * COSINE
    elif name == "sphere":
        expected = 3 * COSINE / DIST2
    elif name == "disk":
        expected = 3 * COSINE / (DIST2 + 0.4**2)
    else:
        expected = None  # a spot with a size: the three estimates must agree
    r = probe(
        scene_of(light), cone_axis=D / np.sqrt(DIST2), cone=0.02 if name == "far rectangle" else 0.25, device=device
    )
    by_light = r.irradiance_by_lights()[:, 0]
    by_ray = r.cone_met[:, 0] * np.maximum(r.cone_direction[:, 2], 0) * r.cone_solid_angle
    if expected is None:
        expected = np.concatenate([by_light, by_ray]).mean()
        assert expected > 0
        assert_mean(by_light - by_ray, 0.0, 0)
    assert_mean(by_light, expected, 5e-4)
    assert_mean(by_ray, expected, 5e-4)
    both = r.mis_irradiance(UP)
    assert_mean(both[:, 0], expected, 5e-4)
    np.testing.assert_allclose(both.mean(0) / both[:, 0].mean(), [1, 2 / 3, 1 / 3], rtol=1e-4)


def smoothstep(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def test_irradiance_under_lights_without_size():
    down = facing(D, -D)
    point = probe(scene_of(Light("l", LightKind.POINT, down, (3, 2, 1))), count=16)
    assert (point.delta == 1).all() and (point.met == 0).all()
    np.testing.assert_allclose(
        point.irradiance_by_lights(), [[3 * COSINE / DIST2, 2 * COSINE / DIST2, COSINE / DIST2]] * 16, rtol=1e-5
    )
    np.testing.assert_allclose(point.distance, np.sqrt(DIST2), rtol=1e-6)

    sun = probe(scene_of(Light("l", LightKind.SUN, facing((0, 0, 0), -D), (3, 2, 1))), count=16)
    np.testing.assert_allclose(sun.irradiance_by_lights()[:, 0], 3 * COSINE, rtol=1e-5)
    assert np.isinf(sun.distance).all() and (sun.delta == 1).all()

    # a spot that looks down from (0, 0, 2), its cone twice as wide along x, seen from the side
    matrix = np.column_stack([np.eye(3), [0, 0, 2]]).astype(np.float32)
    for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 0.7), (1.5, 0.2), (0.0, 1.8)):
        spot = Light("l", LightKind.SPOT, matrix, (3, 3, 3), angle=1.2, blend=0.8, spot_scale=(2, 1))
        local = np.array([x / 2, y, 2])
        cosine = local[2] / np.linalg.norm(local)
        attenuation = smoothstep((cosine - np.cos(0.6)) / ((1 - np.cos(0.6)) * 0.8))
        square = x * x + y * y + 4
        r = probe(scene_of(spot), position=(x, y, 0), count=4)
        np.testing.assert_allclose(
            r.irradiance_by_lights()[:, 0], 3 * attenuation * 2 / square**1.5, rtol=1e-4, atol=1e-7
        )
    hard = Light("l", LightKind.SPOT, matrix, (3, 3, 3), angle=1.2, blend=0.0)
    for x, inside in ((2 * np.tan(0.59), 1), (2 * np.tan(0.61), 0)):
        r = probe(scene_of(hard), position=(x, 0, 0), count=4)
        np.testing.assert_allclose(r.irradiance_by_lights()[:, 0], inside * 3 * 2 / (x * x + 4) ** 1.5, rtol=1e-4)


def test_parallel_area_light_lights_its_own_shadow_only():
    light = Light(
        "l",
        LightKind.ELLIPSE,
        np.column_stack([np.eye(3), [0, 0, 3]]).astype(np.float32),
        (2, 2, 2),
        size=(2, 1),
        spread=0.0,
    )
    inside = probe(scene_of(light), position=(0.9, 0, 0), count=4)
    np.testing.assert_allclose(inside.irradiance_by_lights()[:, 0], 2 * np.pi, rtol=1e-6)
    assert (inside.delta == 1).all() and (inside.distance == 3).all()
    assert (probe(scene_of(light), position=(0.9, 0.3, 0), count=4).pdf == 0).all()
    assert (probe(scene_of(light), position=(0, 0, 4), count=4).pdf == 0).all()


def test_thin_spread_keeps_the_power():
    """However thin the spread, a wide light gives the irradiance of its radiosity."""
    for spread in (1e-6, 1e-3, 0.1, 1.0):
        light = Light(
            "l",
            LightKind.RECTANGLE,
            np.column_stack([np.eye(3), [0, 0, 1]]).astype(np.float32),
            (2, 2, 2),
            size=(9, 9),
            spread=spread,
        )
        r = probe(scene_of(light))
        assert_mean(r.irradiance_by_lights()[:, 0], 2 * np.pi, 1e-3)


def test_inside_a_sphere_light():
    light = Light("l", LightKind.POINT, facing((0.5, 0, 0.2), -UP), (3, 2, 1), radius=1.5, soft_falloff=False)
    radiance = 3 / (np.pi * 1.5**2)
    r = probe(scene_of(light))
    np.testing.assert_allclose(r.radiance[:, 0], radiance, rtol=1e-5)
    np.testing.assert_allclose(r.pdf, 1 / (4 * np.pi), rtol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(r.direction * r.distance[:, None] - [0.5, 0, 0.2], axis=1), 1.5, rtol=1e-5
    )
    assert_mean(r.irradiance_by_lights()[:, 0], np.pi * radiance)
    np.testing.assert_allclose(r.cone_met[:, 0], radiance, rtol=1e-5)
    spot = dataclasses.replace(light, kind=LightKind.SPOT, angle=0.3)  # no cone inside, as in Cycles
    np.testing.assert_allclose(probe(scene_of(spot)).cone_met[:, 0], radiance, rtol=1e-5)


@pytest.mark.parametrize("size", [(200.0, 0.5), (0.5, 200.0), (50.0, 50.0)])
@pytest.mark.parametrize("height", [0.05, 1.0])
def test_spherical_rectangle_of_extreme_shape(size, height):
    """Uniform in solid angle also where the rectangle is long or the point near: each quarter gets its share."""
    centre = np.array([size[0] * 0.1, size[1] * 0.3, height])
    light = Light(
        "l", LightKind.RECTANGLE, np.column_stack([np.eye(3), centre]).astype(np.float32), (1, 1, 1), size=size
    )
    r = probe(scene_of(light))
    assert (r.pdf > 0).all() and np.ptp(r.pdf) == 0

    def solid_angle(x0, x1, y0, y1):
        def f(x, y):
            return np.arctan2(x * y, height * np.sqrt(x * x + y * y + height * height))

        return f(x1, y1) - f(x0, y1) - f(x1, y0) + f(x0, y0)

    x0, x1 = centre[0] - size[0] / 2, centre[0] + size[0] / 2
    y0, y1 = centre[1] - size[1] / 2, centre[1] + size[1] / 2
    whole = solid_angle(x0, x1, y0, y1)
    assert 1 / r.pdf[0] == pytest.approx(whole, rel=1e-3)
    hit = r.direction * (height / r.direction[:, 2])[:, None]
    for sx in (0.01 * size[0], 0.3 * size[0], -0.2 * size[0]):
        for sy in (0.01 * size[1], -0.1 * size[1]):
            share = ((hit[:, 0] < sx) & (hit[:, 1] < sy)).mean()
            expected = solid_angle(x0, sx, y0, sy) / whole
            assert abs(share - expected) < 4 * np.sqrt(expected / COUNT) + 2e-3


def test_lights_shine_from_one_side_and_by_ray_kind():
    light = Light(
        "l",
        LightKind.RECTANGLE,
        np.column_stack([np.eye(3), [0, 0, 1]]).astype(np.float32),
        (1, 1, 1),
        visibility=int(Visibility.DIFFUSE),
    )
    scene = scene_of(light)
    assert (probe(scene, position=(0, 0, 2), count=64, cone_axis=-UP, visibility=2).pdf == 0).all()
    assert (probe(scene, position=(0, 0, 2), count=64, cone_axis=-UP, visibility=2).cone_met == 0).all()
    assert (probe(scene, count=64, visibility=int(Visibility.CAMERA)).cone_met == 0).all()
    assert probe(scene, count=64, visibility=int(Visibility.DIFFUSE)).cone_met.any()
    assert not probe(scene, count=64, visibility=int(Visibility.DIFFUSE), t_max=0.9).cone_met.any()
    assert not probe(scene, count=64, visibility=int(Visibility.DIFFUSE), t_min=2.0).cone_met.any()


def test_rays_gather_all_of_many_lights():
    """Lights neither hide one another nor are missed by the tree."""
    rng = np.random.default_rng(3)
    centres = rng.normal(size=(500, 3)) * 4
    radii = rng.uniform(0.01, 0.6, 500)
    lights = [
        Light(str(i), LightKind.POINT, facing(c, -UP), (1, 0, 0), radius=r, soft_falloff=False)
        for i, (c, r) in enumerate(zip(centres, radii))
    ]
    r = probe(scene_of(*lights), position=(0.3, 0.1, -3), count=4096, cone=2.0, t_max=5.0)
    offset = centres - [0.3, 0.1, -3]
    along = r.cone_direction @ offset.T
    square = (offset**2).sum(1)
    beside = square - along**2
    chord = np.sqrt(np.maximum(radii**2 - beside, 0))
    inside = square <= radii**2
    t = np.where(inside, along + chord, along - chord)
    meets = (beside <= radii**2) & (t > 0) & (t < 5.0)
    expected = meets @ (1 / (np.pi * radii**2))
    close = np.isclose(r.cone_met[:, 0], expected, rtol=1e-3)
    assert close.mean() > 0.995  # the reference rounds at the rims too
    assert (expected > 0).mean() > 0.1


def test_degenerate_lights_give_no_invalid_numbers():
    at = facing((0, 0, 1), -UP)
    degenerate = [
        Light("a", LightKind.RECTANGLE, at, (1, 1, 1), size=(0.0, 1.0)),
        Light("b", LightKind.ELLIPSE, at, (1, 1, 1), size=(0.0, 0.0), spread=0.0),
        Light("c", LightKind.SPOT, at, (1, 1, 1), angle=0.0, blend=1.0),
        Light("d", LightKind.SPOT, at, (1, 1, 1), angle=0.0, radius=0.5, spot_scale=(0.0, 0.0)),
        Light(
            "e",
            LightKind.SPOT,
            at,
            (1, 1, 1),
            angle=np.pi,
            blend=1.0,
            radius=0.5,
            soft_falloff=False,
            spot_scale=(0, 5),
        ),
        Light("f", LightKind.POINT, at, (1e30, 1e30, 1e30), radius=1e-25),
        Light("g", LightKind.POINT, at, (1e-30, 1e-30, 1e-30), radius=1e-9, soft_falloff=False),
        Light("h", LightKind.SUN, at, (1e30, 1e30, 1e30), angle=np.pi),
        Light("i", LightKind.SUN, at, (0, 0, 0), angle=1e-12),
        Light("j", LightKind.RECTANGLE, at, (1, 1, 1), spread=1e-5, size=(1e-6, 1e6)),
        Light("k", LightKind.POINT, facing((0, 0, 0), -UP), (1, 1, 1), radius=0.1),
        Light("l", LightKind.POINT, facing((0, 0, 0), -UP), (1, 1, 1)),
    ]
    # from below, from the plane of the lights, and from their very position
    for position in ((0, 0, 0), (0.2, 0, 1), (0, 0, 1)):
        for light in degenerate:
            r = probe(scene_of(light), position=position, count=256, cone=2.0)
            estimate = r.irradiance_by_lights()
            assert np.isfinite(estimate).all() and (estimate >= 0).all(), light.name
            assert np.isfinite(r.pdf).all() and (r.pdf >= 0).all(), light.name
            for met in (r.cone_met, r.cone_weighted, r.met):
                assert np.isfinite(met).all() and (met >= 0).all(), light.name
        r = probe(scene_of(*degenerate), position=position, count=256, cone=2.0)
        assert np.isfinite(r.pdf).all() and np.isfinite(r.cone_met).all()


def test_no_emitters():
    r = probe(scene_of(), count=16)
    assert (r.pdf == 0).all() and (r.cone_met == 0).all()


def test_specialisation_leaves_the_rest_out():
    """Fewer features give the same answers with less code."""
    features = LightFeatures(lights=(LightKind.POINT,))
    point = scene_of(Light("l", LightKind.POINT, facing(D, -UP), (3, 2, 1)))
    few, full = probe(point, features=features, count=64), probe(point, count=64)
    np.testing.assert_array_equal(few.radiance, full.radiance)
    assert make_lights(features) is make_lights(LightFeatures(lights=(LightKind.POINT,)))
    few, full = generated_code(features), generated_code(ALL)
    for name in ("sample_area_light", "meet_sphere", "sample_sun", "find_triangle", "next_met"):
        assert name in full and name not in few


def generated_code(features: LightFeatures) -> str:
    # in folders of this module alone: others come and go while tests run side by side
    sources = Path(wp.config.kernel_cache_dir).glob(f"*{kernel_for(features).module.name}*/*.{SOURCE_SUFFIX}")
    return max(sources, key=lambda path: path.stat().st_mtime).read_text()
