"""Anisotropic and Beckmann facets, cloth and rough diffuse, over the whole range of their parameters."""

from __future__ import annotations

import itertools
import math

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.sheen import load_sheen
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import LEAST_ROUGH, STATISTICS, WHITE, albedo, evaluate, sample
from tests.stability.uniform import UNIT_ROUNDOFF

_ALONG = (1.0, 0.0, 0.0)
# anisotropy 1 of Principled and Metallic, and 0.8 and -0.8 of Glossy
_ASPECTS = (math.sqrt(10.0), 0.2, 5.0)


def _single_scattering(alpha_x: float, alpha_y: float, wo: np.ndarray, beckmann: bool = False) -> float:
    """Albedo of facets that reflect all light once.

    Float64 Gauss-Legendre quadrature over the cosine and the azimuth of wi.
    """
    nodes, weights = np.polynomial.legendre.leggauss(300)
    c = ((nodes + 1) / 2)[:, None]
    phi = (np.pi * (nodes + 1))[None, :]
    s = np.sqrt(1 - c**2)
    wi = np.stack(np.broadcast_arrays(s * np.cos(phi), s * np.sin(phi), c))
    h = wi + wo[:, None, None]
    stretch = (h[0] / alpha_x) ** 2 + (h[1] / alpha_y) ** 2
    length2 = (h**2).sum(0)
    if beckmann:
        d = np.exp(-stretch / h[2] ** 2) / (np.pi * alpha_x * alpha_y * (h[2] ** 2 / length2) ** 2)
    else:
        d = length2**2 / (np.pi * alpha_x * alpha_y * (stretch + h[2] ** 2) ** 2)

    def shadow(w) -> np.ndarray:
        slope = np.sqrt((alpha_x * w[0]) ** 2 + (alpha_y * w[1]) ** 2) / w[2]
        if not beckmann:
            return (np.sqrt(1 + slope**2) - 1) / 2
        a = 1 / np.maximum(slope, 1e-9)
        erf = np.vectorize(math.erf)(np.minimum(a, 7.0))
        return (erf - 1) / 2 + np.exp(-(np.minimum(a, 26.0) ** 2)) / (2 * a * math.sqrt(math.pi))

    f = d / (1 + shadow(wi) + shadow(wo)) / (4 * wo[2])
    return float((f * weights[:, None] / 2 * weights[None, :] * np.pi).sum())


def _alphas(roughness: float, aspect: float) -> tuple[float, float]:
    alpha = roughness**2
    return min(alpha * aspect, 1.0), min(alpha / aspect, 1.0)


@case(
    "albedo of anisotropic facets",
    "materials",
    "White glossy and metal facets of anisotropy 1 (Principled) and of 0.8 and -0.8 (Glossy): what single scattering "
    "reflects, by float64 quadrature, over the same for isotropic facets of as wide a spread of slopes, whose losses "
    "are all given back.",
    f"{STATISTICS}; the table of isotropic facets is off by 0.002 of itself at most, and 1e-3 of the quadrature.",
    traces=False,
)
def anisotropic_furnace(bench: Bench) -> Outcome:
    """Sweep over kinds, aspects, roughnesses and angles."""
    sweep = Sweep()
    for kind, aspect, roughness, cosine in itertools.product(
        (K.GLOSSY, K.METAL), _ASPECTS, (0.6, 0.8, 1.0), (0.9, 0.5, 0.2)
    ):
        wo = probe.toward(cosine)
        two = _alphas(roughness, aspect)
        mean = math.sqrt(two[0] * two[1])
        expected = _single_scattering(*two, wo) / _single_scattering(mean, mean, wo)
        closure = Closure(kind, WHITE, roughness, aspect=aspect, tangent=_ALONG)
        measured, spread = albedo(bench, (closure,), cosine)
        sweep.add(
            measured,
            expected,
            5e-3 + spread,
            f"{kind.name.lower()} {roughness:g}, aspect {aspect:.3g}, cosine {cosine:g}",
        )
    return sweep.outcome()


@case(
    "albedo of Beckmann's facets",
    "materials",
    "Isotropic and anisotropic facets of Beckmann that reflect all light, once: the integral of D G2 / (4 cos) over "
    "the hemisphere, in float64 with the error function of the C library.",
    f"{STATISTICS}, and 1e-3 of the quadrature at the narrowest facets that it resolves.",
    traces=False,
)
def beckmann_albedo(bench: Bench) -> Outcome:
    """Sweep over aspects, roughnesses and angles."""
    sweep = Sweep()
    for aspect, roughness, cosine in itertools.product((1.0, *_ASPECTS), (0.6, 0.8, 1.0), (0.9, 0.5, 0.2, 0.05)):
        closure = Closure(K.GLOSSY, WHITE, roughness, multiscatter=False, distribution=1, aspect=aspect, tangent=_ALONG)
        measured, spread = albedo(bench, (closure,), cosine)
        expected = _single_scattering(*_alphas(roughness, aspect), probe.toward(cosine), True)
        sweep.add(measured, expected, 1e-3 + spread, f"roughness {roughness:g}, aspect {aspect:.3g}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "furnace: rough diffuse",
    "materials",
    "White Oren-Nayar of roughness 1e-6 to 1 returns all light: what grooves hide from each other comes back after "
    "more bounces.",
    f"{STATISTICS}; the model's mean albedo is a fit, off by 1e-3 of what bounces more than once, which is 0.15 at "
    "most.",
    traces=False,
    quick=True,
)
def furnace_rough_diffuse(bench: Bench) -> Outcome:
    """Sweep over roughnesses and angles."""
    sweep = Sweep()
    for roughness, cosine in itertools.product((1e-6, 0.1, 0.4, 0.7, 1.0), (1.0, 0.7, 0.4, 0.1, 0.01)):
        measured, spread = albedo(bench, (Closure(K.ROUGH_DIFFUSE, WHITE, roughness),), cosine)
        sweep.add(measured, 1.0, 1e-3 + spread + 1e-5, f"roughness {roughness:g}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "furnace: conductors that reflect all, and translucent",
    "materials",
    "Conductors of index 0 reflect all light, rough ones after several bounces; white translucent closures pass all.",
    f"{STATISTICS}; the table of albedos as for metal; translucent samples weigh exactly 1.",
    traces=False,
)
def furnace_conductor(bench: Bench) -> Outcome:
    """Sweep over roughnesses, extinction coefficients and angles."""
    sweep = Sweep()
    for roughness, k, cosine in itertools.product((0.0, LEAST_ROUGH, 0.3, 0.7, 1.0), (0.1, 3.0, 1e3), (1.0, 0.5, 0.1)):
        closure = Closure(K.CONDUCTOR, WHITE, roughness, color=(0.0,) * 3, edge=(k,) * 3)
        measured, spread = albedo(bench, (closure,), cosine)
        sweep.add(measured, 1.0, 2.5e-3 + spread, f"roughness {roughness:.3g}, extinction {k:g}, cosine {cosine:g}")
    for cosine in (1.0, 0.5, 0.1, 1e-4):
        weight = sample(bench, (Closure(K.TRANSLUCENT, WHITE),), probe.toward(cosine), 1024)[1]
        sweep.add(weight.flat[np.argmax(np.abs(weight - 1))], 1.0, 8 * UNIT_ROUNDOFF, f"translucent, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "sheen reflects what its fit says",
    "materials",
    "A layer of fibres: every sample weighs the albedo of the fit, interpolated in float64, at roughness 0 to 1 and "
    "cosines of 1 to 0.01.",
    "Interpolation, a square root and the quotient of two densities: 64 roundings of the weight, and 16 of the table's "
    "largest entry.",
    traces=False,
    quick=True,
)
def sheen_albedo(bench: Bench) -> Outcome:
    """Sweep over roughnesses and angles."""
    table = load_sheen()[0].astype(np.float64)
    sweep = Sweep()
    for roughness, cosine in itertools.product((0.0, 0.2, 0.35, 0.5, 0.77, 1.0), (1.0, 0.8, 0.5, 0.2, 0.05, 0.01)):
        y, x = max(roughness, 1e-3) * (table.shape[0] - 1), cosine * (table.shape[1] - 1)
        i, j = min(int(y), table.shape[0] - 2), min(int(x), table.shape[1] - 2)
        rows = table[i : i + 2, j] + (table[i : i + 2, j + 1] - table[i : i + 2, j]) * (x - j)
        expected = rows[0] + (rows[1] - rows[0]) * (y - i)
        _, weight, _, lobe = sample(bench, (Closure(K.SHEEN, WHITE, roughness),), probe.toward(cosine), 1024)
        found = weight[lobe != 0, 0]
        if len(found) == 0:
            sweep.add(
                0.0 if expected < 2e-5 else expected, 0.0, 2e-5, f"no lobe: roughness {roughness:g}, cosine {cosine:g}"
            )
            continue
        worst = found[np.argmax(np.abs(found - expected))]
        sweep.add(worst, expected, (64 * expected + 16) * UNIT_ROUNDOFF, f"roughness {roughness:g}, cosine {cosine:g}")
    return sweep.outcome()


def _never_above_one() -> dict[str, list[Closure]]:
    """Closures that lose light, or keep all, by the name of their kind."""
    lossy = dict(multiscatter=False)
    return {
        "ashikhmin-shirley": [
            Closure(K.ASHIKHMIN_SHIRLEY, WHITE, r, aspect=a, tangent=_ALONG)
            for r, a in itertools.product((0.0, 0.02, 0.3, 0.7, 1.0), (1.0, *_ASPECTS, 100.0))
        ],
        "refraction": [
            Closure(K.REFRACTION, WHITE, r, ior, distribution=d)
            for r, ior, d in itertools.product((0.0, 0.02, 0.3, 1.0), (0.3, 0.9, 1.0 + 1e-6, 1.5, 10.0), (0, 1))
        ],
        "beckmann": [
            Closure(k, WHITE, r, 1.5, distribution=1, **lossy)
            for k, r in itertools.product((K.GLASS, K.METAL), (0.02, 0.3, 1.0))
        ],
        "sharp anisotropic": [
            Closure(K.GLOSSY, WHITE, r, aspect=a, tangent=_ALONG, **lossy)
            for r, a in itertools.product((0.02, 0.1), (0.01, 100.0))
        ],
        "film": [
            Closure(
                k, WHITE, 0.3, 1.5, color=(1.0, 0.2, 2.0), edge=(0.9, 3.0, 0.1), film_thickness=t, film_ior=i, **lossy
            )
            for k, t, i in itertools.product(
                (K.METAL, K.CONDUCTOR, K.DIELECTRIC), (0.2, 1.0, 300.0, 1e4, 1e9), (0.2, 1.0, 1.33, 4.0)
            )
        ],
        "sheen": [Closure(K.SHEEN, WHITE, r) for r in (0.0, 0.1, 0.5, 1.0)],
    }


@case(
    "closures without more bounces never make energy",
    "materials",
    "Ashikhmin-Shirley, refraction, Beckmann, sharp anisotropic facets, films on metals, conductors and coats, sheen, "
    "over the ranges of their parameters from both sides: the albedo is at most 1.",
    f"{STATISTICS}, and 64 roundings.",
    traces=False,
)
def never_above_one(bench: Bench) -> Outcome:
    """Sweep over kinds, parameters, sides and angles."""
    sweep = Sweep()
    for name, closures in _never_above_one().items():
        for closure, cosine in itertools.product(closures, (1.0, 0.5, 0.05)):
            for entering in (1, 0) if closure.kind in (K.REFRACTION, K.GLASS) else (1,):
                measured, spread = albedo(bench, (closure,), cosine, entering, 8)
                over = max(measured - 1, 0.0) if measured == measured else measured
                sweep.add(
                    over, 0.0, spread + 64 * UNIT_ROUNDOFF, f"{name}: {closure}, cosine {cosine:g}, entering {entering}"
                )
    return sweep.outcome()


@case(
    "reciprocity of all models",
    "materials",
    "f(wo, wi) = f(wi, wo) for single scattering by anisotropic facets, Beckmann's, conductors, films, "
    "Ashikhmin-Shirley, rough diffuse and velvet; random pairs of directions, seeded.",
    "Relative: densities are steep, by 4 / alpha^2 times the half vector's error of 8 roundings (the exponent of "
    "Ashikhmin-Shirley, and Beckmann's, more so where the value is small), and a few products.",
    traces=False,
    quick=True,
)
def reciprocity_of_models(bench: Bench) -> Outcome:
    """Sweep over models, roughnesses and pairs."""
    rng = np.random.default_rng(7)
    pairs = [
        (probe.toward(rng.uniform(0.1, 1), rng.uniform(0, 6)), probe.toward(rng.uniform(0.1, 1), rng.uniform(0, 6)))
        for _ in range(8)
    ]
    turned = dict(aspect=0.4, tangent=(0.8, 0.6, 0.0), multiscatter=False)
    sweep = Sweep()
    for roughness in (0.3, 0.6, 1.0):
        models = {
            "anisotropic": Closure(K.GLOSSY, WHITE, roughness, **turned),
            "anisotropic metal": Closure(K.METAL, (0.9, 0.5, 0.1), roughness, edge=(0.5, 0.8, 1.0), **turned),
            "beckmann": Closure(K.GLOSSY, WHITE, roughness, multiscatter=False, distribution=1),
            "conductor": Closure(
                K.CONDUCTOR, WHITE, roughness, multiscatter=False, color=(0.2, 1.0, 2.0), edge=(3.0, 1.0, 0.0)
            ),
            "film": Closure(K.DIELECTRIC, WHITE, roughness, 1.5, multiscatter=False, film_thickness=400.0),
            "ashikhmin-shirley": Closure(K.ASHIKHMIN_SHIRLEY, WHITE, roughness, **turned),
            "rough diffuse": Closure(K.ROUGH_DIFFUSE, (0.9, 0.5, 0.1), roughness),
            "velvet": Closure(K.VELVET, WHITE, roughness),
        }
        for (name, closure), (a, b) in itertools.product(models.items(), pairs):
            forward = evaluate(bench, (closure,), a, b)[0][0, 0] / b[2]
            backward = evaluate(bench, (closure,), b, a)[0][0, 0] / a[2]
            if max(forward, backward) < 1e-12:
                continue
            tolerance = (64 * 16 / roughness**4 / 0.4**2 + 64) * UNIT_ROUNDOFF
            sweep.add(forward / backward, 1.0, tolerance, f"{name} {roughness:g}")
    return sweep.outcome()


@case(
    "no invalid number from any ability",
    "materials",
    "Facets of both distributions with aspects of 1e-6 to 1e6 and tangents along, across and nearly along the normal, "
    "films of 1e-3 to 1e9 nm of index 0 to 1e6, conductors of 0 to 1e18, colours above 1, normals of their own that "
    "face away: the number of values that are negative or not finite, or of directions that are not unit.",
    "A value, weight or density that is negative or not finite has no meaning at any parameter: none is allowed. "
    "Lengths within 1e-5.",
    traces=False,
)
def finite_abilities(bench: Bench) -> Outcome:
    """Sweep over all parameters."""
    ends = np.array(list(itertools.product((0.0, 2.0**-24, 0.5, 1 - 2.0**-24), repeat=3)), np.float32)
    wos = [probe.toward(c, a) for c in (1.0, 0.5, 1e-3, 1e-7, 0.0) for a in (0.0, 2.0)]
    wis = np.array([sign * w * mirror for w in wos for sign in (1, -1) for mirror in ([1, 1, 1], [-1, -1, 1])])
    closures: list[Closure] = []
    facets = (K.GLOSSY, K.METAL, K.GLASS, K.REFRACTION, K.ASHIKHMIN_SHIRLEY)
    for kind, roughness, d in itertools.product(facets, (0.0, LEAST_ROUGH, 0.3, 1.0), (0, 1)):
        for aspect, tangent in ((1e-6, _ALONG), (1e6, _ALONG), (0.5, (0.0, 0.0, 1.0)), (0.5, (1e-20, 0.0, 1.0))):
            closures.append(
                Closure(
                    kind, WHITE, roughness, 1.5, distribution=d, aspect=aspect, tangent=tangent, multiscatter=d == 0
                )
            )
    filmed = (K.METAL, K.CONDUCTOR, K.DIELECTRIC, K.GLASS)
    for kind, thickness, index in itertools.product(filmed, (1e-3, 0.5, 400.0, 1e9), (0.0, 1.0, 1.5, 1e6)):
        colors = dict(color=(1.0, 0.0, 50.0), edge=(0.0, 1.0, 50.0))
        closures.append(Closure(kind, WHITE, 0.3, 1.5, **colors, film_thickness=thickness, film_ior=index))
    for n, k in itertools.product((0.0, 1e-18, 1.0, 1e9), (0.0, 1e-18, 1.0, 1e9)):
        closures.append(Closure(K.CONDUCTOR, WHITE, 0.3, color=(n,) * 3, edge=(k,) * 3))
    turned = (K.DIFFUSE, K.ROUGH_DIFFUSE, K.GLOSSY, K.GLASS, K.SHEEN, K.VELVET, K.TRANSLUCENT, K.LAYERED_DIFFUSE)
    for kind, normal in itertools.product(turned, ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))):
        closures.append(Closure(kind, WHITE, 0.4, 1.5, normal=normal))
    sweep = Sweep()
    for closure in closures:
        bad = 0
        for wo, entering in zip(wos[::2], itertools.cycle((0, 1))):
            value, density = evaluate(bench, (closure,), wo, wis, entering)
            direction, weight, pdf, lobe = sample(bench, (closure,), wo, 0, entering, ends)
            for numbers in (value, density, weight, pdf):
                bad += int((~np.isfinite(numbers) | (numbers < 0)).sum())
            bad += int((~(np.abs(np.linalg.norm(direction[lobe != 0], axis=1) - 1) < 1e-5)).sum())
        sweep.add(bad, 0, 0, str(closure))
    return sweep.outcome()
