"""Gradient and fractal noise against a float64 twin over Python's integers, and at the ends of the range of numbers."""

import math

import numpy as np
import pytest

from raybatch_addon.core.programs.ops.textures.noise import DETAIL_MAX, FractalKind
from raybatch_addon.core.programs.ops.textures.perlin import PERIOD, SHIFTED_FROM
from tests.core.programs.op_probe import run_op
from tests.twins.noise_reference import signed_noise

DIMENSIONS = (1, 2, 3, 4)
AWKWARD = [0.0, -0.0, 1e-40, 1e7, -1e7, 1e12, 1e30, -1e38, 3.4e38, math.inf, -math.inf, math.nan]
KINDS = list(FractalKind)


def noise(dimensions, points, kind=FractalKind.FBM, normalize=0, skip="", **more):
    """Factor and colour at `points`, [n, 4]: x, y, z and w, of which `dimensions` matter."""
    values = {
        "scale": 1.0,
        "detail": 0.0,
        "roughness": 0.5,
        "lacunarity": 2.0,
        "offset": 0.7,
        "gain": 1.3,
        "distortion": 0.0,
    } | more
    points = np.asarray(points, np.float32)
    coordinates = {1: [points[:, 0]], 2: [points[:, :3]], 3: [points[:, :3]], 4: [points[:, :3], points[:, 3]]}[
        dimensions
    ]
    return run_op(f"noise_{dimensions}d", [kind, normalize], [*coordinates, *values.values()], skip)


def octaves_of(point, kind, detail, roughness, lacunarity, offset, gain):
    """Fractal noise at one point in float64, after Musgrave."""
    whole, rest = int(detail), detail - int(detail)
    if kind == FractalKind.RIDGED_MULTIFRACTAL:
        rest = 0.0
    parts = [1.0] * (whole + 1) + ([rest] if rest else [])
    heard = [signed_noise([x * lacunarity**k for x in point]) for k in range(len(parts))]
    value = 1.0 if kind == FractalKind.MULTIFRACTAL else 0.0
    weight = 1.0
    for k, (part, signal) in enumerate(zip(parts, heard)):
        height = roughness**k
        if kind == FractalKind.MULTIFRACTAL:
            value *= part * height * signal + 1
        elif kind == FractalKind.FBM:
            value += part * height * signal
        elif kind == FractalKind.HETERO_TERRAIN:
            value += part * height * (signal + offset) * (value if k else 1)
        elif kind == FractalKind.HYBRID_MULTIFRACTAL:
            if weight <= 0.001:
                break
            weight = min(weight, 1.0)
            value += part * weight * height * (signal + offset)
            weight *= gain * height * (signal + offset)
        else:
            ridge = weight * (offset - abs(signal)) ** 2
            value += height * ridge
            weight = min(max(gain * ridge, 0.0), 1.0)
    return value


def points_within(limit, count, seed=1):
    return np.random.default_rng(seed).uniform(-limit, limit, (count, 4)).astype(np.float32)


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_one_octave_is_gradient_noise(dimensions):
    points = np.concatenate([points_within(8, 150), points_within(9e4, 50)])
    found, _ = noise(dimensions, points)
    expected = [signed_noise([float(x) for x in point[:dimensions]]) for point in points]
    assert np.allclose(found, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detail", [0.0, 2.0, 3.4])
def test_octaves_are_put_together_as_musgrave_has_them(kind, detail):
    points = points_within(4, 60)
    more = {"detail": detail, "roughness": 0.6, "lacunarity": 2.0, "offset": 0.7, "gain": 1.3}
    found, _ = noise(3, points, kind, **more)
    expected = [octaves_of([float(x) for x in point[:3]], kind, *map(np.float32, more.values())) for point in points]
    assert np.allclose(found, expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_signed_noise_is_zero_on_the_lattice_and_within_its_range(dimensions):
    lattice = np.random.default_rng(2).integers(-1000, 1000, (500, 4))
    assert not noise(dimensions, lattice)[0].any()
    values, colors = noise(dimensions, points_within(100, 20_000), normalize=1, detail=3.5)
    assert values.min() >= -0.01 and values.max() <= 1.01  # the scales are measured: noise may exceed 1 by a little
    assert abs(values.mean() - 0.5) < 0.02 and values.std() > 0.04
    assert np.array_equal(colors[:, 0], values)
    assert np.abs(np.corrcoef(colors.T) - np.eye(3)).max() < 0.1


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_noise_is_smooth_across_cells(dimensions):
    before = np.random.default_rng(3).integers(-50, 50, (400, 4)) + 0.5
    before[:, 0] = np.round(before[:, 0])
    step = np.zeros(4)
    step[0] = 2.0**-8
    left, middle, right = (noise(dimensions, before + k * step)[0].astype(float) for k in (-1, 0, 1))
    assert np.abs(right - middle).max() < 0.04
    assert np.abs(right - 2 * middle + left).max() < 2e-4  # slopes are the same on both sides


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_noise_repeats_far_away_and_is_not_zero_beyond(dimensions):
    near = np.random.default_rng(4).integers(1, 16 * 128, (200, 4)) / 128
    assert np.array_equal(noise(dimensions, near)[0], noise(dimensions, near + PERIOD)[0])
    whole = np.random.default_rng(5).integers(int(SHIFTED_FROM), 10**7, (200, 4))
    assert (noise(dimensions, whole)[0] != 0).mean() > 0.5


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_distortion_moves_points_and_an_unwanted_color_changes_nothing(dimensions):
    points = points_within(5, 300)
    still, _ = noise(dimensions, points, detail=2.0)
    moved, color = noise(dimensions, points, detail=2.0, distortion=1.5)
    alone, nothing = noise(dimensions, points, detail=2.0, distortion=1.5, skip="V")
    assert np.abs(moved - still).mean() > 0.02
    assert np.array_equal(alone, moved) and np.array_equal(color[:, 0], moved) and not nothing.any()


def test_detail_and_roughness_end_at_their_limits():
    points = points_within(5, 100)
    most = noise(2, points, detail=DETAIL_MAX)[0]
    assert np.array_equal(noise(2, points, detail=1e9)[0], most)
    assert np.array_equal(noise(2, points, detail=-3.0)[0], noise(2, points, detail=0.0)[0])
    assert np.array_equal(
        noise(2, points, detail=4.0, roughness=-1.0)[0], noise(2, points, detail=4.0, roughness=0.0)[0]
    )


@pytest.mark.parametrize("dimensions", DIMENSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_any_input_gives_a_finite_result(dimensions, kind):
    rng = np.random.default_rng(6)
    points = rng.choice(AWKWARD, (400, 4))
    calm = {
        "scale": 2.0,
        "detail": 5.5,
        "roughness": 0.5,
        "lacunarity": 2.0,
        "offset": 0.5,
        "gain": 1.0,
        "distortion": 1.0,
    }
    wild = {name: rng.choice([*AWKWARD, value], 400) for name, value in calm.items()}
    for more in (calm, wild):
        for normalize in (0, 1):
            values, colors = noise(dimensions, points, kind, normalize, **more)
            assert np.isfinite(values).all() and np.isfinite(colors).all()
