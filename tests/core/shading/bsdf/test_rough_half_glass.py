"""Rough glass that reflects alone or refracts alone: its samples, and what it leaves of all light."""

import itertools

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.shading.bsdf.bsdf import DELTA, GLOSSY, TRANSMISSION, ClosureFeatures
from tests.core.shading.bsdf.closure_probe import (
    EVERYTHING,
    ROUGH,
    WHITE,
    K,
    chi_squared_deviate,
    evaluate,
    frame_of,
    hemisphere_albedo,
    polar_cells,
    sample,
    toward,
)

GLASS = ("glass", "glass 0.2", "beckmann glass", "tinted glass", "film on glass")
# the side of the surface to which light goes, and its lobe
SIDES = {"REFLECTS": (1, GLOSSY), "REFRACTS": (-1, TRANSMISSION)}
FEATURES = ClosureFeatures(tuple(k for k in EVERYTHING.kinds if k == K.GLASS or not k.is_model), half_glass=True)


@pytest.mark.parametrize("entering", [1, 0])
@pytest.mark.parametrize("half", SIDES)
@pytest.mark.parametrize("name", GLASS)
def test_samples_follow_their_density(name, half, entering):
    """Pearson's chi-squared on either side, and the weight that `evaluate` gives. To the other side go those alone that
    could go nowhere else, from facets that reflect totally: they carry nothing.
    """
    frame, count = frame_of(entering=entering), 20_000
    asked = dict(frame=frame, features=FEATURES, half=half)
    eta = ROUGH[name][0].ior if entering else 1 / ROUGH[name][0].ior
    for cosine in (0.95, 0.5, 0.12):
        wo = toward(cosine)
        u = np.random.default_rng(1).random((count, 3), np.float32)
        direction, weight, pdf, lobe = sample(ROUGH[name], wo, count, u=u, **asked)
        assert not (lobe & DELTA).any() and not weight[lobe != SIDES[half][1]].any()
        if half == "REFLECTS" or entering:
            assert set(lobe) <= {0, SIDES[half][1]}
        found = lobe != 0
        direction = direction[found]
        value, density = evaluate(ROUGH[name], wo, direction, **asked)
        np.testing.assert_allclose(pdf[found], density, rtol=1e-5)
        np.testing.assert_allclose(weight[found] * density[:, None], value, rtol=2e-5, atol=1e-9)
        behind = -wo / eta
        behind[2] = -np.sqrt(max(1 - behind[0] ** 2 - behind[1] ** 2, 0))
        for axis, side in (([-wo[0], -wo[1], wo[2]], 1), (behind, -1)):
            bin_of, points, solid = polar_cells(axis, 3.0, 20, 12)
            _, density = evaluate(ROUGH[name], wo, points.reshape(-1, 3), **asked)
            density = density.reshape(solid.shape) * (points[..., 2] * side > 0)
            expected = count * (density * solid).sum(1)
            observed = np.bincount(bin_of(direction[direction[:, 2] * side > 0]), minlength=len(expected))
            assert chi_squared_deviate(observed, expected, count) < 4.9  # one false alarm in a million


@pytest.mark.parametrize("entering", [1, 0])
@pytest.mark.parametrize("name", GLASS)
def test_both_halves_are_the_whole(name, entering):
    """Each is what glass sends to its side, to the bit: what it lacks is lost."""
    rng, frame = np.random.default_rng(2), frame_of(entering=entering)
    wi = rng.normal(size=(2000, 3))
    wi /= np.linalg.norm(wi, axis=1)[:, None]
    for cosine in (0.95, 0.5, 0.12):
        whole, _ = evaluate(ROUGH[name], toward(cosine), wi, frame, FEATURES)
        for half, (side, _) in SIDES.items():
            value, _ = evaluate(ROUGH[name], toward(cosine), wi, frame, FEATURES, half=half)
            there = wi[:, 2] * side > 0
            np.testing.assert_array_equal(value[there], whole[there])
            assert (whole[there].any() or cosine < 0.5) and not value[~there].any()


@pytest.mark.parametrize("entering", [1, 0])
def test_what_is_reflected_alone(entering):
    """The albedo of glass that reflects alone, against quadrature in float64; both are all that the whole has."""
    for roughness, ior, cosine in itertools.product((0.3, 0.7, 1.0), (1.5, 2.4), (0.9, 0.4, 0.1)):
        glass = (Closure(K.GLASS, WHITE, roughness, ior, multiscatter=False),)
        found = {}
        for half in (*SIDES, ""):
            asked = dict(frame=frame_of(entering=entering), features=FEATURES, half=half)
            means = [sample(glass, toward(cosine), 2**12, seed=seed, **asked)[1].mean(0) for seed in range(4)]
            found[half] = np.mean(means, 0), np.std(means, 0).max() / 2
        expected = hemisphere_albedo(roughness**2, cosine, ior if entering else 1 / ior)
        mean, error = found["REFLECTS"]
        np.testing.assert_allclose(mean, expected, atol=2e-3 + 4 * error)
        both = found["REFLECTS"][0] + found["REFRACTS"][0]
        np.testing.assert_allclose(both, found[""][0], atol=2e-3 + 4 * sum(error for _, error in found.values()))
