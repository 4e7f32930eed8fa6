"""Hair of facets: sampling against density, energy, and absorption."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.shading.bsdf.bsdf import ClosureFeatures
from tests.core.shading.bsdf.closure_probe import WHITE, K, chi_squared_deviate, evaluate, frame_of, polar_cells, sample

FEATURES = ClosureFeatures((K.FACET_HAIR, K.OWN_NORMAL, K.ANISOTROPIC))
TANGENT = (0.6, 0.8, 0.0)
CLEAR = (0.0, 0.0, 0.0)
VIEWS = [(0.1, -0.2, 0.9), (0.5, -0.3, 0.5), (-0.5, 0.5, 0.3)]


def fibre(sigma=CLEAR, alpha=0.3, aspect=1.0, tilt=0.03, ior=1.55, factors=(1.0, 1.0, 1.0), major=CLEAR):
    return Closure(
        K.FACET_HAIR,
        WHITE,
        roughness=alpha,
        ior=ior,
        color=sigma,
        aspect=aspect,
        tangent=TANGENT,
        film_ior=tilt,
        edge=factors,
        normal=major,
    )


CASES = {
    "clear": fibre(),
    "dark": fibre((0.3, 0.8, 2.0), 0.2),
    "smooth": fibre((0.1, 0.2, 0.3), 0.12),
    "rough": fibre((0.5, 0.5, 0.5), 0.7, tilt=0.1),
    "elliptical": fibre((0.1, 0.2, 0.3), 0.3, 0.7, major=(0.8, -0.6, 0.3)),
    "low index": fibre(ior=1.15),
    "reflects": fibre(factors=(1.0, 0.0, 0.0)),
}


def toward(wo):
    return np.asarray(wo) / np.linalg.norm(wo)


def sphere_points(heights=24, turns=48):
    return polar_cells(np.asarray(TANGENT), 1.0, heights, turns)


@pytest.mark.parametrize("wo", VIEWS)
@pytest.mark.parametrize("name", CASES)
def test_samples_follow_their_density(name, wo):
    wo, count = toward(wo), 20_000
    u = np.random.default_rng(2).random((count, 3), np.float32)
    direction, weight, pdf, bits = sample((CASES[name],), wo, count, frame_of(), FEATURES, u=u)
    assert np.isfinite(weight).all() and (pdf[bits != 0] > 0).all()
    bin_of, points, solid = sphere_points(48, 96)
    _, density = evaluate((CASES[name],), wo, points.reshape(-1, 3), frame_of(), FEATURES)
    expected = count * (density.reshape(solid.shape) * solid).sum(1)
    observed = np.bincount(bin_of(direction[bits != 0]), minlength=len(expected))
    assert abs(expected.sum() - observed.sum()) < 0.01 * count
    assert chi_squared_deviate(observed, expected, count) < 4.9  # one false alarm in a million


def albedo(closure, count=400):
    """Mean share of light that leaves, of views around a point of the fibre."""
    rng = np.random.default_rng(3)
    shares = []
    for _ in range(count):
        wo = toward(rng.normal(size=3) * [0.3, 0.3, 0.1] + [0, 0, 1])
        _, weight, _, bits = sample((closure,), wo, 64, frame_of(), FEATURES)
        shares.append(np.where(bits[:, None] != 0, weight, 0).mean(0))
    return np.mean(shares, 0)


def test_a_clear_fibre_hardly_loses_light():
    # facets shadow each other in ways that the factors for one surface do not give back
    assert albedo(fibre(alpha=0.1)) == pytest.approx(1, abs=0.06)
    assert albedo(fibre(alpha=0.3)) == pytest.approx(1, abs=0.15)


def test_absorption_takes_light_by_channel():
    dark = albedo(fibre((0.1, 0.5, 3.0)))
    assert dark[0] > dark[1] > dark[2] > 0.02
    assert albedo(fibre((50.0, 50.0, 50.0)))[0] < 0.1


@pytest.mark.parametrize("wo", [TANGENT, (0.6, 0.8, 1e-7), (0.0, 0.0, 1.0)])
def test_extreme_views_are_finite(wo):
    for closure in CASES.values():
        direction, weight, pdf, _ = sample((closure,), toward(wo), 400, frame_of(), FEATURES)
        assert np.isfinite(direction).all() and np.isfinite(weight).all() and np.isfinite(pdf).all()
        value, density = evaluate((closure,), toward(wo), np.eye(3), frame_of(), FEATURES)
        assert np.isfinite(value).all() and np.isfinite(density).all() and (value >= 0).all()
