"""Light that is looked for along rays through volumes of programs: single scattering of a lamp, whose integral along
the ray is computed in float64.
"""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Frame, Light, LightKind, Scene, Volume
from tests.renders.volumes.test_volumes import filled, in_box, medium, picture, varying
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

LAMP, INTENSITY, SCATTERING = np.array([0.05, 0.1, 0.3]), 2.0, np.array([0.2, 0.4, 0.8])
SEEDS = 16  # pictures; their spread is known to a sixth
ONCE = dict(bounce_max=0, roulette_bounce=10, sample_count=64)


def lit(volume: Volume, view, kind=LightKind.POINT) -> Scene:
    """A cube of `volume` with a lamp in it; the rectangle is there, dark, so that tests share kernels."""
    lamp = Light("lamp", kind, scenes.translation(*LAMP), (INTENSITY,) * 3)
    return dataclasses.replace(in_box(volume, view, 0.0), lights=(*in_box(medium(1.0)).lights, lamp))


def once_scattered(origin, direction, begin: float, end: float, depth) -> np.ndarray:
    """Radiance by channel of light that is scattered once, by a coefficient of SCATTERING times a density, on the piece
    of a ray from `begin` to `end` [m]. `depth(a, b)`: integral of the density between points, shape [n, 3], and the
    density at `b`.
    """
    # by angles as seen from the lamp, which takes the square of the distance out of the integral
    nearest = (LAMP - origin) @ direction
    aside = np.linalg.norm(origin + nearest * direction - LAMP)
    low, high = np.arctan2(begin - nearest, aside), np.arctan2(end - nearest, aside)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    t = nearest + aside * np.tan(0.5 * (high - low) * nodes + 0.5 * (high + low))
    at, first = origin + t[:, None] * direction, np.broadcast_to(origin + begin * direction, (len(t), 3))
    before, density = depth(first, at)
    passed = np.exp(-SCATTERING[:, None] * (before + depth(np.broadcast_to(LAMP, at.shape), at)[0]))
    inner = SCATTERING[:, None] * density * passed * INTENSITY / (4 * math.pi)
    return (inner * weights).sum(1) * 0.5 * (high - low) / aside


def by_height(a, b) -> tuple[np.ndarray, np.ndarray]:
    """Depth and density of 0.75 (z + 1)^2, exact by Simpson's rule."""
    middle = 0.5 * (a + b)
    at = [0.75 * (each[:, 2] + 1) ** 2 for each in (a, middle, b)]
    return np.linalg.norm(b - a, axis=1) * (at[0] + 4 * at[1] + at[2]) / 6, at[2]


def even(a, b) -> tuple[np.ndarray, np.ndarray]:
    return np.linalg.norm(b - a, axis=1), np.ones(len(b))


def assert_near(session, scene, expected, largest_error: float, **changes) -> None:
    """The mean of pictures is `expected`, and differs less than `largest_error` of it between pictures of a seed."""
    means = np.array([picture(session, scene, seed=seed, **ONCE | changes).mean((0, 1)) for seed in range(SEEDS)])
    spread = means.std(0, ddof=1)
    assert np.all(np.abs(means.mean(0) - expected) < 5 * spread / math.sqrt(SEEDS) + 1e-4 * expected), (means, expected)
    assert np.all(spread < largest_error * expected), spread / expected


@pytest.mark.parametrize("aside", [0.02, 0.5])
def test_a_lamp_in_fog_of_a_program(session, aside):
    """A ray passes the lamp near and far, in fog that is denser above: its glow has little noise near the lamp too."""
    eye, target = np.array([0.05 + aside, -4.0, 0.3]), np.array([0.05 + aside, 0.0, 0.3])
    scene = lit(varying(scattering=SCATTERING), scenes.camera(eye=eye, target=target, half_width=1e-4))
    expected = once_scattered(eye, (target - eye) / 4, 3.0, 5.0, by_height)
    assert_near(session, scene, expected, 0.03)


def test_fog_of_more_flights_than_a_path_makes_at_a_time(session):
    """Even fog beside a dense layer, whose bound is the fog's too, 600 free paths along the ray: it goes on twice,
    and light is looked for on each of its pieces.
    """
    builder = ProgramBuilder()
    x = builder.value("separate_xyz", builder.value("position", 0))[0]
    near = builder.value("math", int(MathOperation.COMPARE), False, x, 0.0, 0.02)
    builder.closure("volume_absorption", builder.value("splat", builder.value("math", 2, False, near, 300.0, 0.0)))
    builder.closure("volume_henyey_greenstein", tuple(SCATTERING.tolist()), 0.0)
    eye, target = np.array([0.03, -4.0, 0.3]), np.array([0.03, 0.0, 0.3])
    scene = lit(Volume(program=builder.finish()), scenes.camera(eye=eye, target=target, half_width=1e-4))
    assert_near(session, scene, once_scattered(eye, (target - eye) / 4, 3.0, 5.0, even), 0.1, sample_count=16)


def test_light_that_has_no_place_in_fog_of_a_program(session):
    """A sun in thin fog is found by nearly every path, also where few of them scatter."""
    thin = varying(scattering=1e-3)
    view = scenes.camera(eye=(0, -4, 0), half_width=1e-4)
    scene = in_box(thin, view, 0.0, sun=1.0)
    # the density at the ray's height is 0.75, above it the depth is 1.75
    expected = 2.0 * 0.75e-3 / (4 * math.pi) * math.exp(-1.75e-3 - 0.75e-3)
    found = picture(session, scene, **ONCE)
    assert found.std() < 0.05 * expected
    np.testing.assert_allclose(found.mean(), expected, rtol=1e-2)


def test_lamps_in_front_of_a_wall_in_fog(session):
    """A white furnace of fog before walls: what is lit along the ray and what the wall sends are counted once each."""
    walls = scenes.box("walls", 3.0), scenes.IDENTITY, scenes.emitter(1.0)
    fog = scenes.box(), scenes.IDENTITY, filled(varying(scattering=(2.0, 0.7, 0.2)))
    view = scenes.camera(eye=(0, -1.4, 0), half_width=0.2)
    scene = scenes.scene([walls, fog], world=0.0, frame=Frame(8, 8), view=view, lights=in_box(medium(1.0)).lights)
    found = [
        picture(session, scene, seed=seed, bounce_max=1000, roulette_bounce=1000, sample_count=64) for seed in range(6)
    ]
    means = np.array(found).mean((1, 2))
    assert np.all(np.abs(means.mean(0) - 1) < 5 * means.std(0, ddof=1) / math.sqrt(6) + 2e-6), means
