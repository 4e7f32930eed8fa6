"""Gabor noise against sums of wavelets in float64, and at the ends of the range of numbers."""

import math

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.ops.textures.gabor import gabor_2d, gabor_3d
from tests.support.under_test import DEVICE
from tests.twins.hash_reference import jenkins

DEFAULTS = {"scale": 1.0, "frequency": 2.0, "anisotropy": 1.0, "angle": 0.6, "direction": (0.3, -0.5, 0.8)}


@wp.kernel(**KERNEL_OPTIONS)
def flat(positions: wp.array(dtype=wp.vec3), numbers: wp.vec4, direction: wp.vec3, out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = gabor_2d(positions[i], numbers[0], numbers[1], numbers[2], numbers[3])


@wp.kernel(**KERNEL_OPTIONS)
def solid(positions: wp.array(dtype=wp.vec3), numbers: wp.vec4, direction: wp.vec3, out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    out[i] = gabor_3d(positions[i], numbers[0], numbers[1], numbers[2], direction)


def evaluate(dimensions, positions, **values):
    chosen = {**DEFAULTS, **values}
    out = wp.zeros(len(positions), dtype=wp.vec3, device=DEVICE)
    numbers = wp.vec4(chosen["scale"], chosen["frequency"], chosen["anisotropy"], chosen["angle"])
    inputs = [
        wp.array(np.asarray(positions, np.float32), dtype=wp.vec3, device=DEVICE),
        numbers,
        wp.vec3(*chosen["direction"]),
    ]
    wp.launch(flat if dimensions == 2 else solid, len(positions), [*inputs, out], device=DEVICE)
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


def expected(dimensions, position, **values):
    """Value, phase and intensity: all wavelets of the cells around, one by one."""
    chosen = {**DEFAULTS, **values}
    position = np.asarray(position, np.float64)[:dimensions]
    phasor = 0j
    for step in np.ndindex(*(3,) * dimensions):
        cell = np.floor(position) + np.array(step) - 1
        for i in range(8):
            seeds = [(*cell, 3 * i + k) for k in range(3)]
            away = position - cell - centre(dimensions, seeds[1])
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
    positions = np.random.default_rng(5).integers(-4096, 4096, (12, 3)) / 1024.0
    found = evaluate(dimensions, positions, anisotropy=anisotropy)
    for position, result in zip(positions, found, strict=True):
        assert result == pytest.approx(expected(dimensions, position, anisotropy=anisotropy), abs=2e-5)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_values_fill_the_unit_range(dimensions):
    positions = np.random.default_rng(6).uniform(-40, 40, (4000, 3))
    found = evaluate(dimensions, positions)
    assert found[:, 0].mean() == pytest.approx(0.5, abs=0.01)
    assert found[:, 0].min() > -0.1 and found[:, 0].max() < 1.1
    assert found[:, 1].min() >= 0.0 and found[:, 1].max() <= 1.0
    assert found[:, 2].min() >= 0.0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_any_input_gives_finite_numbers(dimensions):
    extremes = [0.0, -0.0, 1e7, -1e7, 2.0**31, 1e30, np.inf, -np.inf, np.nan]
    positions = np.random.default_rng(7).choice(extremes, (40, 3))
    settings = [
        {},
        {"scale": np.inf},
        {"scale": 1e30},
        {"frequency": np.inf},
        {"frequency": 1e38},
        {"frequency": -5.0},
        {"anisotropy": np.nan},
        {"angle": np.inf},
        {"angle": 1e30, "anisotropy": 0.0},
        {"direction": (0, 0, 0)},
        {"direction": (np.nan, np.inf, 0)},
        {"direction": (0, 0, 1), "anisotropy": 0.5},
        {"direction": (1e30, 1e30, 0), "anisotropy": 0.5},
    ]
    for values in settings:
        assert np.isfinite(evaluate(dimensions, positions, **values)).all(), values


def test_directions_that_cannot_be_turned_give_nothing():
    positions = np.random.default_rng(8).uniform(-4, 4, (10, 3))
    assert not evaluate(3, positions, direction=(0, 0, 0)).any()
    assert not evaluate(3, positions, direction=(0, 0, 2), anisotropy=0.5).any()
    assert evaluate(3, positions, direction=(0, 0, 2)).any()
