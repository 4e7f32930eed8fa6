"""Closures: sampling against density, energy, reciprocity, delta lobes, extremes, and the compiled code."""

import dataclasses
import itertools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.shading.bsdf.bsdf import DELTA, DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT, ClosureFeatures
from raybatch_addon.core.shading.bsdf.fresnel import fresnel_dielectric
from tests.core.shading.bsdf.closure_probe import (
    EVERYTHING,
    ROUGH,
    SMOOTH,
    UP,
    WHITE,
    K,
    albedo,
    chi_squared_deviate,
    evaluate,
    frame_of,
    fresnel,
    hemisphere_albedo,
    kernels,
    launch,
    polar_cells,
    sample,
    stratified,
    table_of,
    toward,
)
from tests.support.under_test import DEVICE


def reflects_alone(name):
    """Whether no closure of ROUGH[name] lets light through."""
    return not {closure.kind for closure in ROUGH[name]} & {
        K.GLASS,
        K.REFRACTION,
        K.SHEET,
        K.TRANSLUCENT,
        K.TRANSPARENT,
    }


@pytest.mark.parametrize("entering", [1, 0])
@pytest.mark.parametrize("cosine", [0.95, 0.5, 0.12])
@pytest.mark.parametrize("name", ROUGH)
def test_samples_follow_their_density(name, cosine, entering):
    """Pearson's chi-squared on either side; the samples are random, not stratified, so that it applies."""
    if entering == 0 and reflects_alone(name):
        pytest.skip("the same from both sides")
    wo, frame, count = toward(cosine), frame_of(entering=entering), 20_000
    u = np.random.default_rng(1).random((count, 3), np.float32)
    direction, _weight, _pdf, lobe = sample(ROUGH[name], wo, count, frame, u=u)
    direction = direction[(lobe != 0) & (lobe & DELTA == 0)]
    ior = 1.4 if reflects_alone(name) else ROUGH[name][0].ior
    eta = ior if entering else 1 / ior
    behind = -wo / eta
    behind[2] = -np.sqrt(max(1 - behind[0] ** 2 - behind[1] ** 2, 0))
    for axis, side in (([-wo[0], -wo[1], wo[2]], 1), (behind, -1)):
        bin_of, points, solid = polar_cells(axis, 3.0, 20, 12)
        _, density = evaluate(ROUGH[name], wo, points.reshape(-1, 3), frame)
        density = density.reshape(solid.shape) * (points[..., 2] * side > 0)
        expected = count * (density * solid).sum(1)
        observed = np.bincount(bin_of(direction[direction[:, 2] * side > 0]), minlength=len(expected))
        assert chi_squared_deviate(observed, expected, count) < 4.9  # one false alarm in a million


@pytest.mark.parametrize("name", ROUGH)
def test_samples_agree_with_evaluation(name):
    """A sample's weight is value over density, and its density is that of `evaluate`."""
    wo = toward(0.6)
    direction, weight, pdf, lobe = sample(ROUGH[name], wo, 1000)
    found = (lobe != 0) & (lobe & DELTA == 0)
    value, density = evaluate(ROUGH[name], wo, direction[found])
    np.testing.assert_allclose(pdf[found], density, rtol=1e-5)
    np.testing.assert_allclose(weight[found] * density[:, None], value, rtol=2e-5, atol=1e-9)
    assert np.all(weight[~found & (lobe == 0)] == 0)


def test_a_lone_diffuse_closure_gives_its_weight_to_the_bit():
    """The white furnace is exact to rounding, in a module for this kind alone and in one for every kind."""
    color = (0.8, 0.31415927, 1.0)
    for features in (ClosureFeatures((K.DIFFUSE,)), EVERYTHING):
        u = stratified(4096)
        u[:5] = [
            (0, 0, 0),
            (0, 1 - 2.0**-24, 1 - 2.0**-24),
            (0, 0, 1 - 2.0**-24),
            (0, 0.5, 0.5),
            (1 - 2.0**-24, 0, 0.5),
        ]
        _, weight, pdf, lobe = sample((Closure(K.DIFFUSE, color),), toward(0.3), 0, features=features, u=u)
        np.testing.assert_array_equal(weight, np.broadcast_to(np.float32(color), weight.shape))
        assert np.all(lobe == DIFFUSE) and np.all(pdf > 0)


@pytest.mark.parametrize("entering", [1, 0])
def test_smooth_white_glass_gives_1_to_the_bit(entering):
    """Reflected and refracted samples: the weight makes up for the probability of each."""
    rng, count = np.random.default_rng(1), 4096
    wo = toward(rng.uniform(0.01, 1.0, count), rng.uniform(0.0, 2 * np.pi, count)).T
    for ior in (0.4, 0.7, 1.001, 1.1, 1.33, 1.5, 2.4, 10.0):
        glass = (Closure(K.GLASS, WHITE, 0.0, ior),)
        _, weight, _, lobe = sample(glass, wo, 0, frame_of(entering=entering), u=rng.random((count, 3), np.float32))
        np.testing.assert_array_equal(weight, 1.0, err_msg=f"IOR {ior}")
        assert set(lobe) == {GLOSSY | DELTA, TRANSMISSION | DELTA}


COSINES = (1.0, 0.5, 0.2, 0.03)


ROUGHNESSES = (SMOOTH, 0.02, 0.15, 0.37, 0.7, 1.0)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
@pytest.mark.parametrize("cosine", COSINES)
def test_white_furnace_reflection(roughness, cosine):
    """White facets return all light, whatever the roughness and the angle."""
    for closures in ((Closure(K.GLOSSY, WHITE, roughness),), (Closure(K.METAL, WHITE, roughness),)):
        mean, error = albedo(closures, cosine)
        np.testing.assert_allclose(mean, 1, atol=0.008 + 4 * error)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
@pytest.mark.parametrize("ior", (1 + 1e-7, 1.001, 1.05, 1.5, 2.4, 10.0, 100.0, 1000.0))
def test_white_furnace_coat(roughness, ior):
    """A white base below a coat returns all light; above an index of 4.6 Fresnel's reflectance is not monotonic."""
    for cosine in COSINES:
        closures = (Closure(K.DIELECTRIC, WHITE, roughness, ior), Closure(K.LAYERED_DIFFUSE, WHITE, roughness, ior))
        mean, error = albedo(closures, cosine)
        np.testing.assert_allclose(mean, 1, atol=0.008 + 4 * error)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
@pytest.mark.parametrize("ior", (1.05, 1.5, 2.4))
@pytest.mark.parametrize("entering", (1, 0))
def test_white_furnace_glass(roughness, ior, entering):
    """White glass reflects and refracts all light, from outside and from inside."""
    for cosine in COSINES:
        mean, error = albedo((Closure(K.GLASS, WHITE, roughness, ior),), cosine, entering)
        np.testing.assert_allclose(mean, 1, atol=(0.03 if ior < 1.1 and not entering else 0.012) + 4 * error)
        assert np.all(mean < 1.008 + 4 * error)


def test_refraction_that_hardly_bends_is_not_lost_beyond_the_critical_angle():
    """Glass of an index of almost 1, from inside at a grazing angle.

    A facet refracts light that the flat surface would reflect.
    """
    weight = sample((Closure(K.GLASS, WHITE, 0.45, 1 + 1e-7),), toward(1e-4), 2**12, frame_of(entering=0))[1]
    np.testing.assert_allclose(weight.mean(0), 1, atol=1e-2)


def test_single_scattering_loses_what_theory_says():
    """Without compensation the albedo is that of one bounce, by an independent quadrature."""
    for roughness, cosine in itertools.product((0.3, 0.7, 1.0), (0.9, 0.4, 0.1)):
        closure = Closure(K.GLOSSY, WHITE, roughness, multiscatter=False)
        mean, error = albedo((closure,), cosine)
        expected = hemisphere_albedo(roughness**2, cosine)
        np.testing.assert_allclose(mean, expected, atol=2e-3 + 4 * error)


def test_a_coat_withholds_what_it_reflects():
    """The coat's sampled albedo, and the table that scales the layer below, against quadrature."""
    for roughness, ior, cosine in itertools.product((0.3, 0.7, 1.0), (1.2, 1.5, 2.4), (0.9, 0.4, 0.1)):
        expected = hemisphere_albedo(roughness**2, cosine, ior)
        coat, error = albedo((Closure(K.DIELECTRIC, WHITE, roughness, ior, multiscatter=False),), cosine)
        np.testing.assert_allclose(coat, expected, atol=2e-3 + 4 * error)
        # light that single scattering loses between facets is lost to the layer below too, as in Cycles: the layer
        # gets what facets do not reflect
        reflected = expected / hemisphere_albedo(roughness**2, cosine)
        below, _ = albedo((Closure(K.LAYERED_DIFFUSE, WHITE, roughness, ior, multiscatter=False),), cosine)
        np.testing.assert_allclose(below, 1 - reflected, atol=3e-3)


def test_energy_compensation_knows_the_mix_factor():
    """Half of a white glossy closure has half of its albedo: the share is no darker colour."""
    whole, _ = albedo((Closure(K.GLOSSY, WHITE, 0.9),), 0.5)
    half, _ = albedo((Closure(K.GLOSSY, (0.5,) * 3, 0.9, share=0.5),), 0.5)
    dark, _ = albedo((Closure(K.GLOSSY, (0.5,) * 3, 0.9),), 0.5)
    np.testing.assert_allclose(half, whole / 2, rtol=1e-4)
    assert np.all(dark < half - 0.02)


@pytest.mark.parametrize(
    "name",
    [
        "diffuse",
        "glossy",
        "glossy 0.2",
        "metal",
        "anisotropic",
        "anisotropic metal",
        "beckmann",
        "anisotropic beckmann",
        "conductor",
        "rough diffuse",
        "rough diffuse 1",
        "ashikhmin-shirley",
        "anisotropic ashikhmin-shirley",
        "velvet",
    ],
)
def test_reciprocity(name):
    """f(wo, wi) = f(wi, wo) for single scattering."""
    closures = [dataclasses.replace(c, multiscatter=False) for c in ROUGH[name]]
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, b = (toward(rng.uniform(0.05, 1), rng.uniform(0, 6)) for _ in range(2))
        forward, _ = evaluate(closures, a, b)
        backward, _ = evaluate(closures, b, a)
        np.testing.assert_allclose(forward / b[2], backward / a[2], rtol=1e-4, atol=1e-30)


def test_evaluation_against_textbook_formulas():
    """GGX reflection and Schlick's Fresnel, and Lambert, against formulas written out in float64."""
    rng = np.random.default_rng(4)
    f0, alpha = np.array([0.9, 0.6, 0.3]), 0.16
    for _ in range(20):
        o, i = (toward(rng.uniform(0.05, 1), rng.uniform(0, 6)) for _ in range(2))
        h = (o + i) / np.linalg.norm(o + i)
        d = alpha**2 / (np.pi * (h[2] ** 2 * (alpha**2 - 1) + 1) ** 2)
        lambdas = [(np.sqrt(1 + alpha**2 * (1 / w[2] ** 2 - 1)) - 1) / 2 for w in (o, i)]
        f = f0 + (1 - f0) * (1 - o @ h) ** 5
        value, pdf = evaluate([Closure(K.METAL, tuple(f0), 0.4, multiscatter=False)], o, i)
        np.testing.assert_allclose(value[0], f * d / (1 + sum(lambdas)) / (4 * o[2]), rtol=2e-4)
        np.testing.assert_allclose(pdf[0], d / (1 + lambdas[0]) / (4 * o[2]), rtol=2e-4)
        value, pdf = evaluate([Closure(K.DIFFUSE, (0.5, 0.25, 1.0))], o, i)
        np.testing.assert_allclose(value[0], np.array([0.5, 0.25, 1.0]) * i[2] / np.pi, rtol=1e-5)
        np.testing.assert_allclose(pdf[0], i[2] / np.pi, rtol=1e-5)


def test_fresnel_is_precise_for_every_index():
    """Float32 against float64 formulas: grazing, near the critical angle, and where the index is nearly 1."""

    @wp.kernel(**KERNEL_OPTIONS)
    def run(cosine: wp.array(dtype=float), eta: wp.array(dtype=float), out: wp.array(dtype=float)):
        i = wp.tid()
        out[i] = fresnel_dielectric(cosine[i], eta[i])

    etas = np.array([1e-3, 0.5, 1 / 1.5, 0.99, 1 - 1e-6, 1 + 1e-6, 1.0001, 1.05, 1.5, 4, 1e3], np.float32)
    cosines = np.concatenate([np.linspace(0, 1, 201), 10.0 ** -np.arange(1, 9)]).astype(np.float32)
    eta, cosine = (a.ravel() for a in np.meshgrid(etas, cosines))
    out = wp.zeros(len(eta), dtype=float, device=DEVICE)
    launch(run, len(eta), [wp.array(a, dtype=float, device=DEVICE) for a in (cosine, eta)], [out])
    # F has an infinite slope at the critical angle; elsewhere it is good to a few roundings
    expected = fresnel(cosine.astype(np.float64), eta.astype(np.float64))
    away = np.abs(eta.astype(np.float64) ** 2 - 1 + cosine.astype(np.float64) ** 2) > 1e-4
    np.testing.assert_allclose(out.numpy()[away], expected[away], rtol=2e-3, atol=1e-15)
    np.testing.assert_allclose(out.numpy(), expected, atol=0.01)


@pytest.mark.parametrize("entering", [1, 0])
def test_smooth_glass_obeys_fresnel_and_snell(entering):
    """Shares and directions of mirrored and refracted samples, and total internal reflection."""
    eta = 1.5 if entering else 1 / 1.5
    for cosine in (0.99, 0.8, 0.7, 0.3, 0.02):
        wo = toward(cosine)
        direction, weight, pdf, lobe = sample(
            [Closure(K.GLASS, WHITE, 0.0, 1.5)], wo, 2**14, frame_of(entering=entering)
        )
        assert set(lobe) <= {GLOSSY | DELTA, TRANSMISSION | DELTA}
        assert np.all(pdf == 0)
        np.testing.assert_allclose(weight, 1, rtol=1e-5)
        mirrored = lobe == (GLOSSY | DELTA)
        assert mirrored.mean() == pytest.approx(float(fresnel(cosine, eta)), abs=1e-3)
        np.testing.assert_allclose(direction[mirrored] - [-wo[0], -wo[1], wo[2]], 0, atol=1e-6)
        if not mirrored.all():
            through = direction[~mirrored]
            np.testing.assert_allclose(through[:, :2] * eta, np.broadcast_to(-wo[:2], (len(through), 2)), atol=2e-6)
            assert np.all(through[:, 2] < 0)
        value, density = evaluate([Closure(K.GLASS, WHITE, 0.0, 1.5)], wo, direction, frame_of(entering=entering))
        assert np.all(value == 0) and np.all(density == 0)


@pytest.mark.parametrize("entering", [1, 0])
def test_a_lobe_has_one_interval_of_the_random_number_and_what_is_rare_an_end_of_all(entering):
    """So evenly spaced numbers find each lobe as often as they can, whatever number they begin with."""
    glass, clear = Closure(K.GLASS, WHITE, 0.0, 1.5), Closure(K.TRANSPARENT, (0.8, 0.8, 0.8))
    count, wo = 2**12, toward(0.8)
    u = np.full((count, 3), 0.25, np.float32)
    u[:, 0] = (np.arange(count) + 0.5) / count
    share = float(fresnel(0.8, 1.5 if entering else 1 / 1.5))
    for closures, end in (([glass, clear], 0), ([clear, glass], 1)):
        _, _, _, lobe = sample(closures, wo, count, frame_of(entering=entering), u=u)
        mirrored = np.flatnonzero(lobe == (GLOSSY | DELTA))
        assert len(mirrored) == pytest.approx(share / 1.8 * count, abs=2)
        assert np.ptp(mirrored) == len(mirrored) - 1
        assert (mirrored[0] == 0) if end == 0 else (mirrored[-1] == count - 1)
    metal, matt = Closure(K.METAL, WHITE, SMOOTH, edge=WHITE), Closure(K.DIFFUSE, WHITE)
    _, _, _, lobe = sample([matt, clear, metal, glass], wo, count, frame_of(entering=entering), u=u)
    first = [np.flatnonzero(lobe == each)[0] for each in (DIFFUSE, TRANSPARENT | DELTA, GLOSSY | DELTA)]
    assert (np.diff(lobe) != 0).sum() == 4  # the last are mirrored by the glass
    np.testing.assert_allclose(first, np.array([0, 1, 1.8]) / 3.8 * count, atol=2)


def test_smooth_metal_and_coat():
    """A delta lobe's weight is its Fresnel factor."""
    wo = toward(0.3)
    f0, tint = np.array([0.9, 0.5, 0.1]), np.array([1.0, 0.9, 0.8])
    direction, weight, _, lobe = sample([Closure(K.METAL, tuple(f0), SMOOTH, edge=tuple(tint))], wo, 16)
    assert np.all(lobe == (GLOSSY | DELTA))
    dip = (f0 + (1 - f0) * (6 / 7) ** 5) * (1 - tint) / ((1 / 7) * (6 / 7) ** 6)
    np.testing.assert_allclose(
        weight, np.broadcast_to(f0 + (1 - f0) * 0.7**5 - dip * 0.3 * 0.7**6, weight.shape), rtol=1e-5
    )
    np.testing.assert_allclose(direction, np.broadcast_to([-wo[0], -wo[1], wo[2]], direction.shape), atol=1e-6)
    _, weight, _, _ = sample([Closure(K.DIELECTRIC, WHITE, 0.0, 1.5)], wo, 16)
    np.testing.assert_allclose(weight, fresnel(0.3, 1.5), rtol=1e-5)


def test_transparency_and_emission():
    """Straight passage is a delta lobe; emission neither scatters nor is it sampled."""
    closures = [Closure(K.TRANSPARENT, (0.3, 0.6, 0.9)), Closure(K.EMISSION, (5.0, 6.0, 7.0))]
    wo = toward(0.4)
    direction, weight, pdf, lobe = sample(closures, wo, 16)
    assert np.all(lobe == (TRANSPARENT | DELTA)) and np.all(pdf == 0)
    np.testing.assert_allclose(direction, np.broadcast_to(-wo, direction.shape), rtol=1e-6)
    np.testing.assert_allclose(weight, np.broadcast_to([0.3, 0.6, 0.9], weight.shape), rtol=1e-6)

    def constants(*closures):
        out = wp.zeros(3, dtype=wp.vec3, device=DEVICE)
        launch(kernels(EVERYTHING).constants, 1, [table_of(*closures)], [out])
        return out.numpy()

    np.testing.assert_allclose(constants(*closures), [[5, 6, 7], [0.3, 0.6, 0.9], [0, 0, 0]], rtol=1e-6)
    assert constants(Closure(K.GLASS, WHITE, SMOOTH))[2, 0] == 0
    assert constants(Closure(K.GLASS, WHITE, 0.1))[2, 0] == 1
    assert constants(Closure(K.DIFFUSE, WHITE))[2, 0] == 1


def test_nothing_is_absorbed_by_an_empty_material():
    """A material without closures is black, not invalid."""
    _direction, weight, pdf, lobe = sample([], toward(0.4), 16)
    value, density = evaluate([], toward(0.4), toward(0.5))
    assert not weight.any() and not pdf.any() and not lobe.any() and not value.any() and not density.any()


@pytest.mark.parametrize("name", ["glass", "all", "plastic"])
@pytest.mark.parametrize("entering", [1, 0])
def test_turned_normals_keep_the_estimate_unbiased(name, entering):
    """The mean weight is the integral of the value, even if shading and geometric normals disagree on sides."""
    frame = frame_of((0.6, 0.0, 0.8), entering=entering)
    closures = tuple(c for c in ROUGH[name] if c.kind not in (K.TRANSPARENT, K.RAY_PORTAL))
    _, points, solid = polar_cells(UP, 1.0, 40, 30)
    for wo in (toward(0.3, 0.0), toward(0.5, 3.0)):
        value, _ = evaluate(closures, wo, points.reshape(-1, 3), frame)
        expected = (value.reshape(*solid.shape, 3) * solid[..., None]).sum((0, 1))
        weight = sample(closures, wo, 2**16, frame)[1]
        np.testing.assert_allclose(weight.mean(0), expected, rtol=0.006)


@pytest.mark.parametrize("name", ROUGH)
def test_light_does_not_leak(name):
    """With a strongly turned shading normal, reflected light stays above the triangle and refracted below."""
    normal = np.array([0.8, 0.0, 0.6])
    frame = frame_of(normal)
    for wo in (toward(0.1, 0.0), toward(0.1, 3.0), toward(0.7, 3.1)):
        direction, weight, _pdf, lobe = sample(ROUGH[name], wo, 1024, frame)
        used = weight.any(1)
        crosses = (lobe & (TRANSMISSION | TRANSPARENT)) != 0
        height = direction[:, 2]
        assert np.all(height[used & crosses] < 0) and np.all(height[used & ~crosses] > 0)
        if name not in ("velvet", "glossy toon") or normal @ wo > 0:  # these are black from behind
            assert used.mean() > 0.2  # the bent normal leaves something, though the shading normal faces away
        below = toward(0.3, 1.0) * [1, 1, -1]
        value, density = evaluate(ROUGH[name], wo, below, frame)
        if reflects_alone(name):
            assert not value.any() and not density.any()
