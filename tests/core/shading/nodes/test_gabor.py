"""Gabor noise against sums of wavelets in float64, and where numbers end."""

import math

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.nodes.gabor import gabor_2d, gabor_3d
from tests.core.shading.nodes.hash_reference import jenkins
from under_test import DEVICE

DEFAULTS = {"scale": 1.0, "frequency": 2.0, "anisotropy": 1.0, "angle": 0.6, "direction": (0.3, -0.5, 0.8)}


@wp.kernel(**KERNEL_OPTIONS)
def flat(places: wp.array(dtype=wp.vec3), numbers: wp.vec4, direction: wp.vec3, out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = gabor_2d(places[i], numbers[0], numbers[1], numbers[2], numbers[3])


@wp.kernel(**KERNEL_OPTIONS)
def solid(places: wp.array(dtype=wp.vec3), numbers: wp.vec4, direction: wp.vec3, out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = gabor_3d(places[i], numbers[0], numbers[1], numbers[2], direction)


def evaluate(dimensions, places, **values):
    chosen = {**DEFAULTS, **values}
    out = wp.zeros(len(places), dtype=wp.vec3, device=DEVICE)
    numbers = wp.vec4(chosen["scale"], chosen["frequency"], chosen["anisotropy"], chosen["angle"])
    inputs = [wp.array(np.asarray(places, np.float32), dtype=wp.vec3, device=DEVICE), numbers, wp.vec3(*chosen["direction"])]
    wp.launch(flat if dimensions == 2 else solid, len(places), [*inputs, out], device=DEVICE)
    return out.numpy()


def hashed(*numbers):
    return jenkins([int(np.float32(x).view(np.uint32)) for x in numbers]) / 2**32


def turned(dimensions, chosen, seeds):
    """The wave vector of a wavelet, of length 1."""
    isotropy = 1.0 - chosen["anisotropy"]
    if dimensions == 2:
        angle = chosen["angle"] + (hashed(*seeds) - 0.5) * math.pi * isotropy
        return np.array([math.cos(angle), math.sin(angle)])
    x, y, z = np.array(chosen["direction"]) / np.linalg.norm(chosen["direction"])
    a, b, c, d = seeds
    theta = math.acos(z) + hashed(a, b, c, d) * math.pi * isotropy
    phi = math.atan2(y, x) + hashed(c, a, d, b) * math.pi * isotropy
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def centre(dimensions, seeds):
    if dimensions == 2:
        a, b, c = seeds
        return np.array([hashed(a, b, c), hashed(c, a, b)])
    a, b, c, d = seeds
    return np.array([hashed(a, b, c, d), hashed(c, a, d, b), hashed(d, c, b, a)])


def expected(dimensions, place, **values):
    """Value, phase, intensity: all wavelets of the cells around, one by one."""
    chosen = {**DEFAULTS, **values}
    place = np.asarray(place, np.float64)[:dimensions]
    phasor = 0j
    for step in np.ndindex(*(3,) * dimensions):
        cell = np.floor(place) + np.array(step) - 1
        for i in range(8):
            seeds = [(*cell, 3 * i + k) for k in range(3)]
            away = place - cell - centre(dimensions, seeds[1])
            squared = away @ away
            if squared < 1.0:
                sign = -1.0 if hashed(*seeds[2]) < 0.5 else 1.0
                envelope = math.exp(-math.pi * squared) * (0.5 + 0.5 * math.cos(math.pi * squared))
                turns = chosen["frequency"] * (away @ turned(dimensions, chosen, seeds[0]))
                phasor += sign * envelope * np.exp(2j * math.pi * turns)
    deviation = math.sqrt(8 * 0.5 * (0.25 if dimensions == 2 else 0.25 / math.sqrt(2)))
    scaled = phasor / (6 * deviation)
    return [0.5 + 0.5 * scaled.imag, (np.angle(phasor) + math.pi) / (2 * math.pi), abs(scaled)]


@pytest.mark.parametrize("anisotropy", [1.0, 0.4, 0.0])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_sum_of_wavelets(dimensions, anisotropy):
    places = np.random.default_rng(5).integers(-4096, 4096, (12, 3)) / 1024.0
    found = evaluate(dimensions, places, anisotropy=anisotropy)
    for place, result in zip(places, found, strict=True):
        assert result == pytest.approx(expected(dimensions, place, anisotropy=anisotropy), abs=2e-5)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_values_fill_the_unit_range(dimensions):
    places = np.random.default_rng(6).uniform(-40, 40, (4000, 3))
    found = evaluate(dimensions, places)
    assert found[:, 0].mean() == pytest.approx(0.5, abs=0.01)
    assert found[:, 0].min() > -0.1 and found[:, 0].max() < 1.1
    assert found[:, 1].min() >= 0.0 and found[:, 1].max() <= 1.0
    assert found[:, 2].min() >= 0.0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_any_input_gives_finite_numbers(dimensions):
    extremes = [0.0, -0.0, 1e7, -1e7, 2.0**31, 1e30, np.inf, -np.inf, np.nan]
    places = np.random.default_rng(7).choice(extremes, (40, 3))
    settings = [
        {}, {"scale": np.inf}, {"scale": 1e30}, {"frequency": np.inf}, {"frequency": 1e38}, {"frequency": -5.0}, {"anisotropy": np.nan},
        {"angle": np.inf}, {"angle": 1e30, "anisotropy": 0.0}, {"direction": (0, 0, 0)}, {"direction": (np.nan, np.inf, 0)},
        {"direction": (0, 0, 1), "anisotropy": 0.5}, {"direction": (1e30, 1e30, 0), "anisotropy": 0.5},
    ]  # fmt: skip
    for values in settings:
        assert np.isfinite(evaluate(dimensions, places, **values)).all(), values


def test_directions_that_cannot_be_turned_give_nothing():
    places = np.random.default_rng(8).uniform(-4, 4, (10, 3))
    assert not evaluate(3, places, direction=(0, 0, 0)).any()
    assert not evaluate(3, places, direction=(0, 0, 2), anisotropy=0.5).any()
    assert evaluate(3, places, direction=(0, 0, 2)).any()
