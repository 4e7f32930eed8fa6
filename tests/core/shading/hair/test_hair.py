"""Closures of hair: sampling against density, energy, and known limits."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.shading.bsdf.bsdf import GLOSSY, TRANSMISSION, ClosureFeatures
from tests.core.shading.bsdf.closure_probe import (
    UP,
    WHITE,
    K,
    chi_squared_deviate,
    evaluate,
    frame_of,
    fresnel,
    polar_cells,
    sample,
)

FEATURES = ClosureFeatures((K.DIFFUSE, K.HAIR_REFLECTION, K.HAIR_TRANSMISSION, K.PRINCIPLED_HAIR))
TANGENT = (0.6, 0.8, 0.0)
CLEAR = (0.0, 0.0, 0.0)


def fibre(sigma=CLEAR, along=0.1, around=0.3, outside=0.1, tilt=0.05, ior=1.55, weight=WHITE):
    return Closure(
        K.PRINCIPLED_HAIR,
        weight,
        roughness=along,
        ior=ior,
        color=sigma,
        aspect=around,
        tangent=TANGENT,
        film_ior=tilt,
        mean_cosine=outside,
    )


def lobe(kind, along=0.2, around=0.5, shift=0.1):
    return Closure(kind, WHITE, roughness=along, aspect=around, tangent=TANGENT, film_ior=shift)


CASES = {
    "clear": (fibre(),),
    "dark": (fibre((0.3, 0.8, 2.0)),),
    "smooth": (fibre((0.1, 0.2, 0.3), 0.01, 0.08, 0.005),),
    "rough": (fibre((0.5, 0.5, 0.5), 0.6, 1.5, 0.6, 0.2),),
    "low index": (fibre(ior=1.1),),
    "reflects": (lobe(K.HAIR_REFLECTION),),
    "passes": (lobe(K.HAIR_TRANSMISSION),),
    "mixed": (Closure(K.DIFFUSE, (0.3, 0.3, 0.3)), fibre((0.2, 0.4, 0.8), weight=(0.5, 0.5, 0.5))),
}
VIEWS = [(0.1, -0.2, 0.9), (0.7, 0.5, 0.3), (-0.5, 0.35, 0.15)]


def toward(wo):
    return np.asarray(wo) / np.linalg.norm(wo)


def sphere_points(wo, heights=24, turns=48):
    return polar_cells(np.asarray(TANGENT), 1.0, heights, turns)


@pytest.mark.parametrize("wo", VIEWS)
@pytest.mark.parametrize("name", CASES)
def test_samples_follow_their_density(name, wo):
    wo, count = toward(wo), 20_000
    u = np.random.default_rng(2).random((count, 3), np.float32)
    direction, weight, pdf, bits = sample(CASES[name], wo, count, frame_of(), FEATURES, u=u)
    assert np.isfinite(weight).all() and (pdf[bits != 0] > 0).all()
    assert np.allclose(np.linalg.norm(direction[bits != 0], axis=1), 1, atol=1e-5)
    bin_of, points, solid = sphere_points(wo)
    _, density = evaluate(CASES[name], wo, points.reshape(-1, 3), frame_of(), FEATURES)
    expected = count * (density.reshape(solid.shape) * solid).sum(1)
    observed = np.bincount(bin_of(direction[bits != 0]), minlength=len(expected))
    assert chi_squared_deviate(observed, expected, count) < 4.9  # one false alarm in a million


@pytest.mark.parametrize("wo", VIEWS)
def test_a_clear_fibre_loses_nothing(wo):
    wo = toward(wo)
    for name in ("clear", "low index"):
        _, points, solid = sphere_points(wo, 48, 96)
        value, density = evaluate(CASES[name], wo, points.reshape(-1, 3), frame_of(), FEATURES)
        albedo = (value.mean(1).reshape(solid.shape) * solid).sum()
        assert albedo == pytest.approx(1, abs=0.01)
        assert (density.reshape(solid.shape) * solid).sum() == pytest.approx(1, abs=0.01)


def test_weights_of_a_clear_fibre_are_one():
    _, weight, _, bits = sample((fibre(),), toward(VIEWS[0]), 10_000, frame_of(), FEATURES)
    assert np.allclose(weight[bits != 0], 1, atol=1e-3)


def test_a_fibre_that_absorbs_all_only_reflects_on_its_surface():
    wo = toward((0.0, 0.0, 1.0))
    black = (fibre((50.0, 50.0, 50.0)),)
    _, points, solid = sphere_points(wo, 48, 96)
    value, _ = evaluate(black, wo, points.reshape(-1, 3), frame_of(), FEATURES)
    assert (value[:, 0].reshape(solid.shape) * solid).sum() == pytest.approx(fresnel(1.0, 1.55), rel=0.02)
    _, _, _, bits = sample(black, wo, 1000, frame_of(), FEATURES)
    assert set(bits[bits != 0]) == {GLOSSY}


def test_lobes_stay_on_their_sides_of_the_fibre_whatever_the_surface():
    """They lose nothing, also where they go through the surface."""
    along = np.asarray(TANGENT, float)
    for view in (VIEWS[0], (0.8, -0.6, 0.05)):
        wo = toward(view)
        across = np.asarray(wo, float) - np.dot(wo, along) * along
        through = False
        for name, bit, side in (("reflects", GLOSSY, 1), ("passes", TRANSMISSION, -1)):
            direction, weight, _, bits = sample(CASES[name], wo, 4000, frame_of(), FEATURES)
            assert set(bits) == {bit}
            assert (direction @ across * side > -1e-5).all()
            ends = np.abs(direction @ along) > 1 - 1e-5  # there nothing is scattered
            assert weight[~ends] == pytest.approx(1, abs=1e-3) and ends.mean() < 0.01
            through |= bool((direction @ np.asarray(UP) * side < -0.1).any())
        assert through


@pytest.mark.parametrize("wo", [TANGENT, (-0.6, -0.8, 0.0), (0.6, 0.8, 1e-7)])
def test_views_along_the_fibre_are_finite(wo):
    for closures in CASES.values():
        direction, weight, pdf, _ = sample(closures, toward(wo), 400, frame_of(), FEATURES)
        assert np.isfinite(direction).all() and np.isfinite(weight).all() and np.isfinite(pdf).all()
        value, density = evaluate(closures, toward(wo), np.eye(3), frame_of(), FEATURES)
        assert np.isfinite(value).all() and np.isfinite(density).all() and (value >= 0).all()
