"""Sampling of closures against their densities, and their symmetry."""

from __future__ import annotations

import itertools
import math

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.bsdf import DELTA
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import GRAZING, LEAST_ROUGH, WHITE, evaluate, plastic, sample
from tests.stability.uniform import UNIT_ROUNDOFF

_COUNT = 20_000
# Chi-squared as a normal deviate: six occur once in 1e9, and there are fewer than 1,000
_DEVIATE = 6.0


def chi_squared(bench: Bench, closures, cosine: float, entering: int = 1) -> float:
    """The largest deviate of the samples on either side; bins are finer near the lobe."""
    wo = probe.toward(cosine)
    u = np.random.default_rng(1).random((_COUNT, 3), np.float32)
    direction, _, _, lobe = sample(bench, closures, wo, _COUNT, entering, u)
    direction = direction[(lobe != 0) & (lobe & DELTA == 0)]
    ior = next(
        (1.0 if c.kind == K.SHEET else c.ior for c in closures if c.kind in (K.GLASS, K.REFRACTION, K.SHEET)), 1.5
    )
    eta = ior if entering else 1 / ior
    behind = -wo / eta
    behind[2] = -np.sqrt(max(1 - behind[0] ** 2 - behind[1] ** 2, 0))
    if not behind.any() or np.linalg.norm(behind) > 1 + 1e-6:
        behind = np.array([-wo[0], -wo[1], -1e-3])
    largest = -np.inf
    for axis, side in (([-wo[0], -wo[1], wo[2]], 1), (behind, -1)):
        bin_of, points, solid = probe.polar_cells(axis, 3.0, 20, 12)
        _, density = evaluate(bench, closures, wo, points.reshape(-1, 3), entering)
        density = density.reshape(solid.shape) * (points[..., 2] * side > 0)
        expected = _COUNT * (density * solid).sum(1)
        observed = np.bincount(bin_of(direction[direction[:, 2] * side > 0]), minlength=len(expected))
        largest = max(largest, probe.chi_squared_deviate(observed, expected, _COUNT))
    return float(largest)


CHI_ABOUT = (
    "Pearson's chi-squared of 20,000 samples in 240 bins a side, as a standard normal deviate, against the density "
    "integrated over each bin by 8 x 8 Gauss-Legendre points"
)
CHI_BOUND = "A false alarm once in 1e9 comparisons at 6 deviations; far below 0 is as good as 0."


def add_deviate(sweep: Sweep, deviate: float, note: str) -> None:
    sweep.add(max(deviate, 0.0) if deviate == deviate else deviate, 0.0, _DEVIATE, note)


@case(
    "chi-squared: closures that reflect",
    "materials",
    f"{CHI_ABOUT}: Lambert, coat over diffuse, glossy, metal, at three angles.",
    CHI_BOUND,
    traces=False,
)
def chi_squared_reflection(bench: Bench) -> Outcome:
    """Sweep over closures and angles."""
    closures = {
        "diffuse": (Closure(K.DIFFUSE, WHITE),),
        "layered": (Closure(K.LAYERED_DIFFUSE, WHITE, 0.4, 1.5),),
        "glossy 0.2": (Closure(K.GLOSSY, WHITE, 0.2),),
        "glossy 1": (Closure(K.GLOSSY, WHITE, 1.0),),
        "metal": (Closure(K.METAL, (0.9, 0.6, 0.3), 0.4),),
        "coat": (Closure(K.DIELECTRIC, WHITE, 0.3, 1.5),),
        "plastic": plastic(0.3, 1.5, (0.8, 0.2, 0.1)),
        "plastic of index 100": plastic(0.5, 100.0),
    }
    sweep = Sweep()
    for (name, some), cosine in itertools.product(closures.items(), (0.95, 0.5, 0.12)):
        add_deviate(sweep, chi_squared(bench, some, cosine), f"{name}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "chi-squared: glass from both sides",
    "materials",
    f"{CHI_ABOUT}: glass of indices 0.5 to 2.4 and roughness 0.2 to 1, entering and leaving.",
    CHI_BOUND,
    traces=False,
)
def chi_squared_glass(bench: Bench) -> Outcome:
    """Sweep over indices, roughnesses, sides and angles."""
    sweep = Sweep()
    for ior, roughness, entering, cosine in itertools.product(
        (0.5, 1.33, 2.4), (0.2, 0.5, 1.0), (1, 0), (0.95, 0.5, 0.12)
    ):
        deviate = chi_squared(bench, (Closure(K.GLASS, WHITE, roughness, ior),), cosine, entering)
        add_deviate(sweep, deviate, f"index {ior:g}, roughness {roughness:g}, entering {entering}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "chi-squared: mixtures of all closures",
    "materials",
    f"{CHI_ABOUT}: every kind at once in equal and very unequal shares.",
    CHI_BOUND,
    traces=False,
)
def chi_squared_mixture(bench: Bench) -> Outcome:
    """Sweep over shares, sides and angles."""
    sweep = Sweep()
    kinds = [kind for kind in K if kind.is_model and not kind.is_hair and kind != K.EMISSION]
    for powers in ((0,) * 7, (-6, 0, -1, -3, 0, -2, -1), (0, -30, -3, -1, -30, 0, 0)):
        closures = tuple(
            Closure(kind, (10.0**p * 0.2, 10.0**p * 0.1, 10.0**p * 0.05), 0.4, 1.4)
            for kind, p in zip(kinds, itertools.cycle(powers))
        )
        for entering, cosine in itertools.product((1, 0), (0.95, 0.5, 0.12)):
            add_deviate(
                sweep,
                chi_squared(bench, closures, cosine, entering),
                f"powers {powers}, entering {entering}, cosine {cosine:g}",
            )
    return sweep.outcome()


@case(
    "chi-squared: all models",
    "materials",
    f"{CHI_ABOUT}: isotropic and anisotropic facets of GGX, Beckmann and Ashikhmin-Shirley over their roughness, "
    "refraction from both sides, films, rough diffuse, translucent, sheen, velvet, and closures with normals of their "
    "own, at three angles.",
    CHI_BOUND,
    traces=False,
)
def chi_squared_models(bench: Bench) -> Outcome:
    """Sweep over models, roughnesses, sides and angles."""
    models: list[Closure] = []
    for roughness, aspect in itertools.product((0.4, 0.7, 1.0), (1.0, 0.5, math.sqrt(10.0))):
        turned = dict(aspect=aspect, tangent=(0.6, 0.8, 0.0))
        models.append(Closure(K.GLOSSY, WHITE, roughness, **turned))
        models.append(Closure(K.METAL, (0.9, 0.5, 0.1), roughness, distribution=1, multiscatter=False, **turned))
        models.append(Closure(K.ASHIKHMIN_SHIRLEY, WHITE, roughness, **turned))
    for kind, ior, d in itertools.product((K.REFRACTION, K.GLASS), (0.7, 1.5), (0, 1)):
        models.append(Closure(kind, WHITE, 0.5, ior, distribution=d, multiscatter=False))
    for thickness in (0.5, 300.0, 3e3):
        models.append(Closure(K.GLASS, WHITE, 0.4, 1.5, film_thickness=thickness, film_ior=1.8))
        models.append(
            Closure(K.CONDUCTOR, WHITE, 0.4, color=(0.2, 1.0, 2.0), edge=(3.0, 1.0, 0.0), film_thickness=thickness)
        )
    models += [
        Closure(kind, WHITE, r) for kind, r in itertools.product((K.ROUGH_DIFFUSE, K.SHEEN, K.VELVET), (0.3, 0.6, 1.0))
    ]
    turned = (K.DIFFUSE, K.ROUGH_DIFFUSE, K.TRANSLUCENT, K.GLOSSY, K.GLASS, K.SHEEN)
    models += [Closure(kind, WHITE, 0.5, normal=(0.36, 0.48, 0.8)) for kind in turned]
    sweep = Sweep()
    for closure, cosine in itertools.product(models, (0.95, 0.5, 0.15)):
        for entering in (1, 0) if closure.kind in (K.REFRACTION, K.GLASS) else (1,):
            add_deviate(
                sweep,
                chi_squared(bench, (closure,), cosine, entering),
                f"{closure}, cosine {cosine:g}, entering {entering}",
            )
    return sweep.outcome()


@case(
    "samples weigh what evaluation says",
    "materials",
    "A sample's weight times its density is the value of the BSDF there, and its density the one that evaluation "
    "gives: the largest relative difference, for every closure and mixture of the shading tests and for facets of the "
    "least roughness.",
    "Both call one function: exact but for the product of the weight and the density, 8 roundings. At the least "
    "roughness too.",
    traces=False,
    quick=True,
)
def samples_agree(bench: Bench) -> Outcome:
    """Sweep over closures, angles and sides."""
    closures = dict(probe.ROUGH)
    for kind in (K.GLOSSY, K.METAL, K.DIELECTRIC, K.GLASS):
        closures[f"sharp {kind.name.lower()}"] = (Closure(kind, WHITE, LEAST_ROUGH, 2.4),)
    sweep = Sweep()
    for (name, some), cosine, entering in itertools.product(closures.items(), (0.9, 0.3, 0.03), (1, 0)):
        wo = probe.toward(cosine)
        direction, weight, pdf, lobe = sample(bench, some, wo, 1024, entering)
        found = (lobe != 0) & (lobe & DELTA == 0)
        if not found.any():
            continue
        value, density = evaluate(bench, some, wo, direction[found], entering)
        note = f"{name}, cosine {cosine:g}, entering {entering}"
        sweep.add(np.abs(pdf[found] / density - 1).max(), 0.0, 4 * UNIT_ROUNDOFF, f"density of {note}")
        scale = np.maximum(value.max(1, keepdims=True), 1e-30)  # a value of 0 has a weight of 0
        sweep.add(
            np.abs((weight[found] * density[:, None] - value) / scale).max(),
            0.0,
            8 * UNIT_ROUNDOFF,
            f"weight of {note}",
        )
    return sweep.outcome()


@case(
    "reciprocity of reflection",
    "materials",
    "f(wo, wi) = f(wi, wo) for single scattering by Lambert, glossy, metal and coat closures; random pairs of "
    "directions, seeded.",
    "Relative: D is steep, by 4 / alpha times the half vector's error of 8 roundings, and a few products.",
    traces=False,
    quick=True,
)
def reciprocity(bench: Bench) -> Outcome:
    """Sweep over closures, roughnesses and pairs."""
    rng = np.random.default_rng(3)
    pairs = [tuple(probe.toward(rng.uniform(0.02, 1), rng.uniform(0, 6)) for _ in range(2)) for _ in range(12)]
    sweep = Sweep()
    for kind, roughness in itertools.product((K.DIFFUSE, K.GLOSSY, K.METAL, K.DIELECTRIC, K.GLASS), (0.1, 0.4, 1.0)):
        closures = (Closure(kind, (0.9, 0.6, 0.3), roughness, 1.5, multiscatter=False),)
        for a, b in pairs:
            forward = evaluate(bench, closures, a, b)[0][0] / b[2]
            backward = evaluate(bench, closures, b, a)[0][0] / a[2]
            tolerance = (32 * 4 / roughness**2 + 32) * UNIT_ROUNDOFF
            sweep.add(forward[0] / backward[0], 1.0, tolerance, f"{kind.name.lower()} {roughness:g}")
    return sweep.outcome()


@case(
    "asymmetry of what is given back",
    "materials",
    "Closures that give back what single scattering loses, and a base below a coat, depend on the albedo of the side "
    "of wo alone (Turquin 2019), so that they are not reciprocal: f(wo, wi) / f(wi, wo) = E(wi) / E(wo) for white "
    "facets of albedo E (float64 quadrature), and (1 - F(wo)) / (1 - F(wi)) for a base below a smooth coat of "
    "Fresnel's reflectance F.",
    "Two albedos of a table that is off by 0.002 of itself at most, and 1e-3 of the quadrature; Fresnel's equations "
    "and quotients: 32 roundings, of 1 where little passes a coat.",
    traces=False,
)
def asymmetry(bench: Bench) -> Outcome:
    """Sweep over closures, roughnesses and pairs."""
    rng = np.random.default_rng(4)
    pairs = [
        (probe.toward(rng.uniform(0.1, 1), rng.uniform(0, 6)), probe.toward(rng.uniform(0.1, 1), rng.uniform(0, 6)))
        for _ in range(6)
    ]
    sweep = Sweep()

    def ratio(closure, a, b):
        return evaluate(bench, (closure,), a, b)[0][0, 0] / b[2] / (evaluate(bench, (closure,), b, a)[0][0, 0] / a[2])

    for a, b in pairs:
        for kind, roughness in itertools.product((K.GLOSSY, K.METAL), (0.4, 0.7, 1.0)):
            expected = probe.hemisphere_albedo(roughness**2, b[2]) / probe.hemisphere_albedo(roughness**2, a[2])
            sweep.add(
                ratio(Closure(kind, WHITE, roughness), a, b) / expected, 1.0, 6e-3, f"{kind.name.lower()} {roughness:g}"
            )
        for ior in (1.0, 1.5, 100.0):
            passed = [1 - float(probe.fresnel(v[2], ior)) if ior > 1 else 1.0 for v in (a, b)]
            measured = ratio(Closure(K.LAYERED_DIFFUSE, WHITE, 0.0, ior), a, b)
            # a reflectance near 1 has the error of a rounding of 1
            sweep.add(
                measured / (passed[0] / passed[1]),
                1.0,
                32 * UNIT_ROUNDOFF / min(passed),
                f"below a coat of index {ior:g}",
            )
    return sweep.outcome()


@case(
    "reciprocity of refraction",
    "materials",
    "f(wo, wi) / eta_i^2 = f(wi, wo) / eta_o^2 (Veach 1997, section 5.2) between the two sides of rough glass without "
    "compensation. The core carries radiance without the factor eta^2, as Blender does, so that f itself is f_Veach "
    "for light and f(wo, wi) = eta^2 f(wi, wo).",
    "As for reflection; the half vector of refraction is shorter by |eta - 1|.",
    traces=False,
)
def reciprocity_of_refraction(bench: Bench) -> Outcome:
    """Sweep over indices, roughnesses and pairs."""
    rng = np.random.default_rng(3)
    sweep = Sweep()
    for ior, roughness in itertools.product((0.7, 1.33, 2.4), (0.3, 1.0)):
        closures = (Closure(K.GLASS, WHITE, roughness, ior, multiscatter=False),)
        for _ in range(20):
            a = probe.toward(rng.uniform(0.2, 1), rng.uniform(0, 6))
            # directions near the refracted one
            b = np.array([*(-a[:2] / ior), 0.0]) + rng.normal(0, 0.1, 3) * [1, 1, 0]
            if b @ b >= 0.98:
                continue
            b[2] = -np.sqrt(1 - b @ b)
            forward = evaluate(bench, closures, a, b)[0][0, 0] / abs(b[2])
            mirror = np.array([1, 1, -1])  # the frame is on the side of wo
            backward = evaluate(bench, closures, b * mirror, a * mirror, 0)[0][0, 0] / a[2]
            if backward == 0 and forward == 0:
                continue
            tolerance = (32 * 4 / roughness**2 / min(abs(ior - 1), 1.0) + 64) * UNIT_ROUNDOFF
            sweep.add(forward / backward / ior**2, 1.0, tolerance, f"index {ior:g}, roughness {roughness:g}")
    return sweep.outcome()


@case(
    "densities integrate to what is not absorbed",
    "materials",
    "The integral of the density over the sphere, 8 x 8 Gauss-Legendre points in each of 1,600 cells, is the share of "
    "samples that go on.",
    "Six binomial standard errors of 65,536 samples, and 2e-3 of the quadrature.",
    traces=False,
)
def densities(bench: Bench) -> Outcome:
    """Sweep over closures and angles."""
    _, points, solid = probe.polar_cells(probe.UP, 1.0, 40, 40)
    sweep = Sweep()
    for name, cosine in itertools.product(
        ("diffuse", "glossy", "glossy 1", "metal", "glass", "plastic", "all"), (0.9, 0.3)
    ):
        wo = probe.toward(cosine)
        _, density = evaluate(bench, probe.ROUGH[name], wo, points.reshape(-1, 3))
        lobe = sample(bench, probe.ROUGH[name], wo, 2**16)[3]
        share = float(((lobe != 0) & (lobe & DELTA == 0)).mean())
        spread = 6 * np.sqrt(max(share * (1 - share), 1e-9) / 2**16)
        sweep.add((density.reshape(solid.shape) * solid).sum(), share, spread + 2e-3, f"{name}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "no invalid number from any closure",
    "materials",
    "Every closure at roughness 0 to 1, indices 0 to 1e9, from both sides, at cosines down to 0 and with random "
    "numbers at the ends of their range: the number of values that are negative or not finite, or of directions that "
    "are not unit.",
    "A value, weight or density that is negative or not finite has no meaning at any parameter: none is allowed. "
    "Lengths within 1e-5 (frames of float32).",
    traces=False,
)
def finite(bench: Bench) -> Outcome:
    """Sweep over all parameters."""
    ends = np.array(list(itertools.product((0.0, 2.0**-24, 0.5, 1 - 2.0**-24), repeat=3)), np.float32)
    wos = [probe.toward(c, a) for c in (1.0, 0.5, *GRAZING, 1e-20, 0.0) for a in (0.0, 2.0)]
    wis = np.array([sign * w * mirror for w in wos for sign in (1, -1) for mirror in ([1, 1, 1], [-1, -1, 1])])
    sweep = Sweep()
    for kind in [kind for kind in K if kind.is_model and not kind.is_hair and kind not in (K.EMISSION, K.TRANSPARENT)]:
        for roughness, ior in itertools.product(
            (0.0, 1e-8, LEAST_ROUGH, 0.1, 1.0), (0.0, 0.1, 1.0, 1.0 + 1e-7, 1.5, 100.0, 1e9)
        ):
            closures = (Closure(kind, WHITE, roughness, ior),)
            bad = 0
            for wo, entering in itertools.product(wos[::3], (0, 1)):
                value, density = evaluate(bench, closures, wo, wis, entering)
                direction, weight, pdf, lobe = sample(bench, closures, wo, 0, entering, ends)
                for numbers in (value, density, weight, pdf):
                    bad += int((~np.isfinite(numbers) | (numbers < 0)).sum())
                length = np.linalg.norm(direction[lobe != 0], axis=1)
                bad += int((~(np.abs(length - 1) < 1e-5)).sum())
            sweep.add(bad, 0, 0, f"{kind.name.lower()}, roughness {roughness:g}, index {ior:g}")
    return sweep.outcome()
