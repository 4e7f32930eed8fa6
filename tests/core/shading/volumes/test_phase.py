"""Phase functions on the device: against formulas of float64, over the sphere, and against what is sampled."""

import itertools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.volumes.phase import PhaseLobe
from raybatch_addon.core.wavefront.volumes.medium import Coefficients, phase_sample, phase_sum
from tests.core.shading.bsdf.closure_probe import chi_squared_deviate

U = 2.0**-24
COUNT = 100_000  # draws
ONE = (1.0, 1.0, 1.0)
OPS = {
    K.HENYEY_GREENSTEIN: "volume_henyey_greenstein",
    K.DRAINE: "volume_draine",
    K.FOURNIER_FORAND: "volume_fournier_forand",
    K.RAYLEIGH: "volume_rayleigh",
    "MIE": "volume_mie",
}
CASES = [
    *((K.HENYEY_GREENSTEIN, g) for g in (-0.999, -0.7, -0.02, 0.0, 5e-4, 0.3, 0.9, 0.99, 0.999)),
    *((K.DRAINE, g, alpha) for g in (-0.999, -0.4, 0.0, 0.6, 0.999) for alpha in (0.0, 1.0, 250.0)),
    # index of refraction and share of light that goes back; delta is 1 at a right angle and backwards in the last two
    *((K.FOURNIER_FORAND, *both) for both in ((1.01, 0.0183), (1.01, 0.49), (1.2, 0.1), (1.33, 0.1), (1.33, 0.49))),
    *((K.FOURNIER_FORAND, *both) for both in ((1.0 + (2 / 3) ** 0.5, 0.49), (1.0 + (4 / 3) ** 0.5, 0.49))),
    (K.RAYLEIGH,),
    *(("MIE", diameter) for diameter in (0.05, 0.8, 3.0, 20.0)),
]
# Roundings of float32, of which three sum up lobes. Terms are of one sign, so that none of them grows: by Henyey and
# Greenstein 3 in squares of 1 - |g|, a sum, 6 and 2 in its power of 3/2, 3 before and 2 behind the quotient
ROUNDINGS = {K.HENYEY_GREENSTEIN: 20, K.DRAINE: 32, K.FOURNIER_FORAND: 5, K.RAYLEIGH: 8, "MIE": 34}
# Intervals over the sphere: logarithms of 1 - cosine below 0, and above it of 1 + cosine with the sign changed
STEPS = np.linspace(-60.0, 60.0, 1921)

each_case = pytest.mark.parametrize(
    "case", CASES, ids=lambda case: "-".join([getattr(case[0], "name", "MIE"), *(f"{x:g}" for x in case[1:])])
)


@wp.kernel(**KERNEL_OPTIONS)
def evaluate_kernel(
    lobes: wp.array(dtype=PhaseLobe),
    medium: Coefficients,
    cosines: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec2),
):
    i = wp.tid()
    both = phase_sum(lobes, medium, wp.vec3(1.0), cosines[i])
    found[i] = wp.vec2(both.value[0], both.pdf)


@wp.kernel(**KERNEL_OPTIONS)
def sample_kernel(
    lobes: wp.array(dtype=PhaseLobe), medium: Coefficients, u: wp.array(dtype=wp.vec2), cosines: wp.array(dtype=float)
):
    i = wp.tid()
    cosines[i] = phase_sample(lobes, medium, wp.vec3(1.0), u[i][0], u[i][1])


def closures_of(case):
    """The scattering closures of a material of weight 1, as (kind, weight, first, second)."""
    builder = ProgramBuilder()
    builder.closure(OPS[case[0]], ONE, *case[1:])
    found = []
    for closure in builder.constant_closures():
        fournier_forand = closure.kind == K.FOURNIER_FORAND
        first, second = (closure.ior, closure.roughness) if fournier_forand else (closure.mean_cosine, closure.aspect)
        found.append((K(closure.kind), closure.weight[0], float(np.float32(first)), float(np.float32(second))))
    return found


def lobes_of(case, device):
    """The lobes of a case in an array, and their coefficients."""
    lobes, medium = [], Coefficients()
    for kind, weight, first, second in closures_of(case):
        lobe = PhaseLobe()
        lobe.kind, lobe.weight, lobe.first, lobe.second = int(kind), wp.vec3(weight), first, second
        lobes.append(lobe)
    medium.lobes, medium.scattering = len(lobes), wp.vec3(*ONE)
    return wp.array(lobes, dtype=PhaseLobe, device=device), medium


def evaluate(case, cosines, device):
    """Values and densities of samples [1/sr] at float32 cosines, as float64."""
    given = wp.array(np.ascontiguousarray(cosines, np.float32), dtype=float, device=device)
    found = wp.empty(len(given), dtype=wp.vec2, device=device)
    wp.launch(evaluate_kernel, len(given), [*lobes_of(case, device), given, found], device=device)
    return found.numpy().astype(float).T


def sample(case, count, seed, device):
    """Sampled cosines, float32 as float64."""
    u = np.random.default_rng(seed).integers(0, 2**24, (count, 2)) * 2.0**-24
    found = wp.empty(count, dtype=float, device=device)
    given = wp.array(u.astype(np.float32), dtype=wp.vec2, device=device)
    wp.launch(sample_kernel, count, [*lobes_of(case, device), given, found], device=device)
    return found.numpy().astype(float)


# --- the functions in float64, by 1 - cosine and 1 + cosine, without a loss where either is small


def henyey_greenstein(g, ahead, behind):
    spread = (1 - abs(g)) ** 2 + 2 * abs(g) * (ahead if g > 0 else behind)
    return (1 - g * g) / (4 * np.pi * spread**1.5)


def fournier_forand(index, back, ahead):
    s = ahead / 2
    scale = 4 / (3 * (index - 1) ** 2)
    # of a delta that is 1 the function takes a neighbour
    at_90, at_180 = (1 + 1e-6 if abs(x - 1) < 1e-6 else x for x in (scale / 2, scale))
    delta = scale * s
    nu = -np.log(2 * back * (at_90 - 1) + 1) / np.log(at_90)
    rest = -np.expm1(nu * np.log(delta))
    near = nu * (1 - delta) - rest + scale * rest - nu * (1 - delta) / s
    far = -np.expm1(nu * np.log(at_180)) / (4 * (at_180 - 1) * at_180**nu)
    return (near / ((1 - delta) ** 2 * delta**nu) + far * (3 * (1 - ahead) ** 2 - 1)) / (4 * np.pi)


def value_of(case, ahead, behind, as_density=False):
    """The phase function [1/sr], or the density of samples."""
    total, square = 0.0, ((behind - ahead) / 2) ** 2
    for kind, weight, first, second in closures_of(case):
        if kind == K.RAYLEIGH:
            value = 3 / (16 * np.pi) * (1 + square)
        elif kind == K.FOURNIER_FORAND:
            value = fournier_forand(first, second, ahead)
        else:
            value = henyey_greenstein(first, ahead, behind)
        if kind == K.DRAINE and not as_density:
            value = value * (1 + second * square) / (1 + second * (1 + 2 * first**2) / 3)
        total = total + weight * value
    return total


def density_of(case, ahead, behind):
    """The density of samples [1/sr]."""
    return value_of(case, ahead, behind, as_density=True)


def places_of(x):
    """1 - cosine and 1 + cosine at places of the scale of `STEPS`, and solid angle there by the unit of the scale."""
    near = np.exp(-np.abs(x))
    return np.where(x < 0, near, 2 - near), np.where(x < 0, 2 - near, near), 2 * np.pi * near


def integral(function, edges):
    """Integrals of a function of 1 - cosine and 1 + cosine over parts of the sphere."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    half = np.diff(edges)[:, None] / 2
    ahead, behind, area = places_of(edges[:-1, None] + half * (1 + nodes))
    return (function(ahead, behind) * area * half) @ weights


# --- tests


@each_case
def test_formulas_of_float64_integrate_to_1(case):
    for function in (value_of, density_of):
        parts = integral(lambda *place, of=function: of(case, *place), STEPS)
        assert parts.sum() == pytest.approx(1, rel=2 * U)  # shares of mixtures are float32


@each_case
def test_values_are_those_of_float64_and_integrate_to_1(case, device):
    """Where the device is off from float64, by cosines of float32, so is its integral."""
    bound = ROUNDINGS[case[0]] * U

    def cosines(x):
        ahead, behind, _ = places_of(x)
        return np.where(x < 0, 1 - ahead, behind - 1).astype(np.float32)

    nodes = np.polynomial.legendre.leggauss(24)[0]
    at = cosines(STEPS[:-1, None] + np.diff(STEPS)[:, None] / 2 * (1 + nodes))
    exact = at.astype(float)
    inside = np.abs(exact) < 1
    for found, function in zip(evaluate(case, at.ravel(), device), (value_of, density_of), strict=True):
        expected = np.ones(at.shape)
        expected[inside] = function(case, 1 - exact[inside], 1 + exact[inside])
        ratio = np.where(inside, found.reshape(at.shape) / expected, 1.0)
        assert np.abs(ratio - 1).max() < bound
        whole = integral(lambda *place, of=function, ratio=ratio: of(case, *place) * ratio, STEPS).sum()
        assert abs(whole - 1) < bound + 1e-9


@pytest.mark.parametrize("g", [-0.999, -0.5, 0.0, 0.5, 0.99, 0.999])
def test_the_peak_and_its_opposite(g, device):
    """Straight on and straight back, where formulas that subtract have no digits left."""
    ends = np.array([1.0, -1.0])
    expected = henyey_greenstein(float(np.float32(g)), 1 - ends, 1 + ends)
    found, _ = evaluate((K.HENYEY_GREENSTEIN, g), ends, device)
    assert found == pytest.approx(expected, rel=ROUNDINGS[K.HENYEY_GREENSTEIN] * U)


@each_case
def test_samples_are_as_dense_as_is_said(case, device):
    """Chi-squared over rings that narrow towards both ends, down to four steps of float32."""
    steps = np.unique(np.round(2 ** np.arange(2.0, 23.6, 0.5)))
    widths = (steps + 0.5) * U  # between two numbers of float32
    edges = np.concatenate([[-60.0], np.log(widths), [0.0], -np.log(widths)[::-1], [60.0]])
    # the parts between edges, each in pieces that are short enough for the quadrature
    pieces = np.concatenate([np.linspace(a, b, 64, endpoint=False) for a, b in itertools.pairwise(edges)] + [[60.0]])
    expected = integral(lambda *place: density_of(case, *place), pieces).reshape(-1, 64).sum(1)
    assert expected.sum() == pytest.approx(1, abs=1e-6)
    limits = np.concatenate([[-np.inf], -1 + widths, [0.0], 1 - widths[::-1], [np.inf]])
    for seed in (1, 2):
        cosines = sample(case, COUNT, seed, device)
        assert (np.abs(cosines) <= 1).all()
        observed = np.histogram(cosines, limits)[0][::-1]
        assert chi_squared_deviate(observed, COUNT * expected, COUNT) < 4.9  # one false alarm in a million


@each_case
def test_samples_carry_all_light(case, device):
    """The mean weight of samples is 1."""
    value, density = evaluate(case, sample(case, COUNT, 3, device), device)
    weights = value / density
    assert abs(weights.mean() - 1) < 4 * weights.std() / COUNT**0.5 + 64 * U


@pytest.mark.parametrize("diameter", [0.0, 0.05, 0.1, 0.5, 1.5, 3.0, 5.0, 50.0])
def test_droplets_are_a_mixture_of_all_light(diameter):
    closures = closures_of(("MIE", diameter))
    assert sum(weight for _, weight, _, _ in closures) == pytest.approx(1, rel=4 * U)
    assert all(weight > 0 and abs(first) <= 0.999 and second >= 0 for _, weight, first, second in closures)
