"""Albedo tables against float64 quadrature at points between those of the tables."""

import numpy as np
import pytest
from precompute.albedo_tables import (
    IOR_LARGEST,
    fresnel,
    quantised,
    quantised_difference,
    raised,
    refined,
    reflected_and_total,
    slope,
    without_a_coat,
)

from raybatch_addon.core.programs.op import as_python
from raybatch_addon.core.shading.bsdf.albedo import coat_fresnel_average
from tests.core.programs.host_program import albedo_arrays, host_tables


def _read(table, *position):
    """Linear interpolation at a point in [0, 1] of every axis."""
    for size, x in zip(table.shape, position, strict=True):
        i = min(int(x * (size - 1)), size - 2)
        f = x * (size - 1) - i
        table = table[i] * (1 - f) + table[i + 1] * f
    return float(table)


@pytest.fixture(scope="module")
def random_points():
    """Points: roughness, cosine of at least 0.03, and its coordinate; 40 of them, seeded."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(40):
        roughness, cosine = rng.uniform(0.02, 1), rng.uniform(0.03, 1)
        alpha = roughness**2
        found.append((roughness, cosine, (cosine * (1 + alpha) / (cosine + alpha)) ** 0.5))
    return found


def test_tables_lose_little_and_make_next_to_nothing(random_points):
    tables, rng = albedo_arrays(), np.random.default_rng(6)
    for roughness, cosine, u in random_points:
        x = rng.uniform(-1, 1, 16)  # sign(l) |l|^(1/4), l = log(eta) / log(1000)
        etas = IOR_LARGEST ** (np.sign(x) * x**4)
        white, reflected, total = reflected_and_total(roughness**2, cosine, etas)
        mirror = _read(tables["reflection"], roughness, u)
        assert 0.9975 < white / mirror < 1.0005
        for i, eta in enumerate(etas):
            note = f"roughness {roughness}, cosine {cosine}, index {eta}"
            assert 0.96 < total[i] / _read(tables["glass"], 0.5 + 0.5 * x[i], roughness, u) < 1.002, note
            if eta > 1:
                mean = float(fresnel(slope(roughness**2, cosine), eta)) + _read(tables["coat"], x[i], roughness, u)
                assert -1e-4 < mirror * min(max(mean, 0), 1) - reflected[i] < 0.005, note


@pytest.mark.parametrize("ior", [0.01, 0.3, 0.8, 0.99, 1.0, 1.3, 100.0])
def test_the_mean_reflectance_of_a_dielectric_of_any_index(ior):
    mu = (np.arange(100_000) + 0.5) / 100_000  # total reflection has a kink
    expected = (2 * mu * fresnel(mu, ior)).mean()
    assert as_python(coat_fresnel_average)(host_tables(), ior) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("parts", [(4, 2, 4), (3, 1, 2)])
def test_raised_tables_are_nowhere_below_what_is_known(parts):
    shape = [p * n + 1 for p, n in zip(parts, (3, 4, 2))]
    truth = np.random.default_rng(1).random(shape)
    table = raised(truth, parts)
    assert np.all(refined(table, parts) >= truth - 1e-12)
    truth[0] = 0
    coat = without_a_coat(raised(truth, parts), truth, parts)
    assert not coat[0].any() and np.all(refined(coat, parts) >= truth - 1e-12)


def test_what_interpolates_exactly_is_kept():
    x, y = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 0.5, 5), indexing="ij")
    np.testing.assert_allclose(raised(0.25 + x / 4 + y / 2, (4, 2)), (0.25 + x / 4 + y / 2)[::4, ::2], atol=1e-12)


def test_numbers_of_a_table_are_rounded_upwards():
    assert quantised(np.array([0.0, 0.5, 1.0, 1.1])).tolist() == [0, 32768, 65535, 65535]
    assert quantised_difference(np.array([-1.0, -1e-9, 0.0, 1e-5, 1.0])).tolist() == [-32767, 0, 0, 1, 32767]
