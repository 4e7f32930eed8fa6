"""White furnaces: the albedo of closures and stacks of them, over the whole range of their parameters."""

from __future__ import annotations

import itertools

import numpy as np

from raybatch_addon.core.programs.builder import Value
from raybatch_addon.core.programs.ops.closures.facets import Distribution
from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.export.nodes.shaders.principled import Layers, layered_closures
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import (
    COSINES,
    GRAZING,
    LEAST_ROUGH,
    ROUGHNESSES,
    SMOOTH,
    STATISTICS,
    WHITE,
    albedo,
    plastic,
    sample,
)
from tests.stability.uniform import UNIT_ROUNDOFF

# Albedo tables are raised until interpolation is below the truth nowhere at the points of each cell where the truth is
# known. Between those points, and by their quadrature's error (3e-4), they may still be too low by this, against a
# finer quadrature at random points
_GAIN, _GAIN_GLASS, _GAIN_GLASS_GRAZING = 1e-3, 2e-3, 0.012  # the second value also for coats at grazing angles


def _add_furnace(
    bench: Bench, sweep: Sweep, closures, cosine: float, entering: int, loss: float, gain: float, note: str
) -> None:
    """Compare the albedo with 1, less `loss` at most and plus `gain` at most."""
    measured, spread = albedo(bench, closures, cosine, entering)
    over = measured > 1
    bound = (gain if over else loss) + spread + 16 * UNIT_ROUNDOFF
    sweep.add(measured, 1.0, bound, f"{note}, cosine {cosine:g}, {'entering' if entering else 'leaving'}")


@case(
    "furnace: diffuse, transparent and delta lobes of albedo exactly 1",
    "materials",
    "Every sample of a white Lambertian, a transparent, and a perfectly smooth white closure has the weight 1, so "
    "that no path loses or gains by it.",
    "The first two exactly; of smooth ones a product of three numbers: 4 roundings.",
    traces=False,
    quick=True,
)
def exactly_one(bench: Bench) -> Outcome:
    """Sweep over kinds and angles."""
    sweep = Sweep()
    for cosine in (*COSINES, *GRAZING):
        for kind, roughness, tolerance in (
            (K.DIFFUSE, 0.0, 0.0),
            (K.TRANSPARENT, 0.0, 0.0),
            (K.GLOSSY, 0.0, 4.0),
            (K.METAL, SMOOTH, 4.0),
            (K.GLASS, SMOOTH, 4.0),
            (K.GLASS, 0.0, 4.0),
            (K.SHEET, SMOOTH, 4.0),
        ):
            weight = sample(bench, (Closure(kind, WHITE, roughness, 1.5),), probe.toward(cosine), 1024)[1]
            worst = weight.flat[np.argmax(np.abs(weight - 1))]
            sweep.add(worst, 1.0, tolerance * UNIT_ROUNDOFF, f"{kind.name.lower()} {roughness:g}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "furnace: white metal and glossy of roughness 0 to 1",
    "materials",
    "White facets return all light: what single scattering loses between them is given back.",
    f"{STATISTICS}; against float64 quadrature the table of albedos is too high by 0.002 of itself at most, and too "
    "low by 5e-4 (1e-3 is allowed).",
    traces=False,
    quick=True,
)
def furnace_metal(bench: Bench) -> Outcome:
    """Sweep over kinds, roughnesses and angles up to grazing."""
    sweep = Sweep()
    for kind, roughness, cosine in itertools.product((K.GLOSSY, K.METAL), ROUGHNESSES, (*COSINES, *GRAZING)):
        _add_furnace(
            bench,
            sweep,
            (Closure(kind, WHITE, roughness),),
            cosine,
            1,
            2.5e-3,
            _GAIN,
            f"{kind.name.lower()} {roughness:g}",
        )
    return sweep.outcome()


_IORS = (1.0, 1.0 + 1e-7, 1.001, 1.05, 1.5, 2.4, 10.0, 100.0, 1e3)


@case(
    "furnace: coat over white of index 1 to 1000",
    "materials",
    "A white base below a dielectric coat returns all light.",
    f"{STATISTICS}; against float64 quadrature the table of coats is too high by 0.0035 at most at such cosines, and "
    "too low by 1e-5.",
    traces=False,
    quick=True,
)
def furnace_coat(bench: Bench) -> Outcome:
    """Sweep over indices, roughnesses and angles."""
    sweep = Sweep()
    for ior, roughness, cosine in itertools.product(_IORS, ROUGHNESSES, COSINES):
        _add_furnace(
            bench, sweep, plastic(roughness, ior), cosine, 1, 4e-3, _GAIN, f"index {ior:.7g}, roughness {roughness:.4g}"
        )
    return sweep.outcome()


@case(
    "furnace: coat over white at grazing angles",
    "materials",
    "As above, at cosines of 0.03 to 1e-6.",
    f"{STATISTICS}; the known loss is larger here, where Fresnel's rise and the shadows of facets crowd into less "
    "than a cell of the table: up to 0.16 by float64 quadrature, at an index of almost 1. The table is too low by "
    "2e-3 at most.",
    traces=False,
)
def furnace_coat_grazing(bench: Bench) -> Outcome:
    """Sweep over indices, roughnesses and angles."""
    sweep = Sweep()
    for ior, roughness, cosine in itertools.product(_IORS, ROUGHNESSES, GRAZING):
        _add_furnace(
            bench,
            sweep,
            plastic(roughness, ior),
            cosine,
            1,
            0.16,
            _GAIN_GLASS,
            f"index {ior:.7g}, roughness {roughness:.4g}",
        )
    return sweep.outcome()


_GLASS_IORS = (1.0, 1.0 + 1e-7, 1.001, 1.05, 1.5, 2.4, 100.0, 0.1, 0.9)


@case(
    "furnace: glass of index 0.1 to 100, from outside and inside",
    "materials",
    "White glass reflects and refracts all light.",
    f"{STATISTICS}; against float64 quadrature the table is too high by 0.03 of itself at most, near the critical "
    "angle and index 1, and too low by 2e-3.",
    traces=False,
)
def furnace_glass(bench: Bench) -> Outcome:
    """Sweep over indices, sides, roughnesses and angles."""
    sweep = Sweep()
    for ior, entering, roughness, cosine in itertools.product(_GLASS_IORS, (1, 0), ROUGHNESSES, COSINES):
        _add_furnace(
            bench,
            sweep,
            (Closure(K.GLASS, WHITE, roughness, ior),),
            cosine,
            entering,
            0.03,
            _GAIN_GLASS,
            f"index {ior:.7g}, roughness {roughness:.4g}",
        )
    return sweep.outcome()


@case(
    "furnace: glass at grazing angles",
    "materials",
    "As above, at cosines of 0.03 to 1e-6: it makes no light. (Its loss: 'albedo of rough glass'.)",
    f"{STATISTICS}; never above 1 by more than 1.1 % by float64 quadrature. The known loss may be any share here: "
    "from inside glass of an index near 1, rough facets send nearly all of such light to the side that single "
    "scattering cannot serve.",
    traces=False,
)
def furnace_glass_grazing(bench: Bench) -> Outcome:
    """Sweep over indices, sides, roughnesses and angles."""
    sweep = Sweep()
    for ior, entering, roughness, cosine in itertools.product(_GLASS_IORS, (1, 0), ROUGHNESSES, GRAZING):
        measured, spread = albedo(bench, (Closure(K.GLASS, WHITE, roughness, ior),), cosine, entering)
        over = max(measured - 1, 0.0) if measured == measured else measured
        note = f"index {ior:.7g}, roughness {roughness:.4g}, cosine {cosine:g}, entering {entering}"
        sweep.add(over, 0.0, _GAIN_GLASS_GRAZING + spread, note)
    return sweep.outcome()


@case(
    "furnace: glass loses little of all light",
    "materials",
    "The share of diffuse light that white glass returns: the mean of its albedo over cosine-weighted directions, by "
    "Gauss-Legendre quadrature in the squared cosine.",
    f"{STATISTICS}; directions that lose more have little of the light: 2 %.",
    traces=False,
)
def furnace_glass_average(bench: Bench) -> Outcome:
    """Sweep over indices, sides and roughnesses."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    sweep = Sweep()
    for ior, entering, roughness in itertools.product(_GLASS_IORS, (1, 0), ROUGHNESSES[3:]):
        closures = (Closure(K.GLASS, WHITE, roughness, ior),)
        values = [albedo(bench, closures, float(np.sqrt((x + 1) / 2)), entering, 8) for x in nodes]
        mean = sum(w / 2 * value for w, (value, _) in zip(weights, values))
        spread = np.sqrt(sum((w / 2 * error) ** 2 for w, (_, error) in zip(weights, values)))
        note = f"index {ior:.7g}, roughness {roughness:.4g}, entering {entering}"
        sweep.add(mean, 1.0, 0.02 + spread if mean < 1 else _GAIN_GLASS + spread, note)
    return sweep.outcome()


@case(
    "furnace: stacks and mixtures",
    "materials",
    "White closures whose shares sum to 1 return all light: coat, metal, glass, glossy, diffuse and transparent "
    "together, in equal and in very unequal shares.",
    f"{STATISTICS}; the losses of the closures, each at most 1e-2 (glass from inside: 0.03), in their shares.",
    traces=False,
)
def furnace_stacks(bench: Bench) -> Outcome:
    """Sweep over shares, roughnesses and angles."""

    def stack(shares, roughness: float) -> tuple[Closure, ...]:
        a, b, c, d, e, f = shares
        single = [(K.METAL, a), (K.GLASS, b), (K.GLOSSY, c), (K.DIFFUSE, d), (K.TRANSPARENT, e)]
        lobes = [Closure(kind, (s,) * 3, roughness, 1.5, share=s) for kind, s in single]
        return (*lobes, *plastic(roughness, 1.5, share=f))

    sweep = Sweep()
    unequal = (1e-6, 1e-3, 0.0, 0.5, 1e-9)
    for shares in ((1 / 6,) * 6, (*unequal, 1 - sum(unequal)), (0.0, 0.0, 1e-30, 0.0, 0.0, 1.0)):
        for roughness, cosine, entering in itertools.product(ROUGHNESSES, COSINES, (0, 1)):
            loss = 0.01 + 0.02 * shares[1]
            note = f"shares {shares[0]:.2g}..., roughness {roughness:.4g}"
            _add_furnace(bench, sweep, stack(shares, roughness), cosine, entering, loss, _GAIN_GLASS, note)
    return sweep.outcome()


def _principled_corners():
    """Every combination of the ends and a middle of Principled's parameters."""
    ends = (0.0, 0.5, 1.0)
    return itertools.product(
        ends, (0.0, LEAST_ROUGH, 0.3, 1.0), (1.0, 1.0 + 1e-6, 1.5, 1e3), (0.0, 0.5, 1.0, 4.0), ends, (0.0, 1.0)
    )


@case(
    "furnace: Principled over its range",
    "materials",
    "Principled of white base over metallic, roughness, index (1 to 1000), specular level (0 to 4), transmission and "
    "alpha: all light comes back, at each of 1,152 corners of the range, from outside and, where light is "
    "transmitted, from inside, at seeded angles.",
    f"{STATISTICS}; the losses of its closures in their shares: 0.012 at most from outside, 0.03 from inside.",
    traces=False,
)
def furnace_principled(bench: Bench) -> Outcome:
    """Sweep over the corners of the range of parameters."""
    sweep = Sweep()
    rng = np.random.default_rng(8)
    for metallic, roughness, ior, specular, transmission, alpha in _principled_corners():
        closures = _principled(
            base=WHITE,
            metallic=metallic,
            roughness=roughness,
            ior=ior,
            level=specular,
            transmission=transmission,
            alpha=alpha,
        )
        note = (
            f"metallic {metallic:g}, roughness {roughness:.3g}, index {ior:g}, specular {specular:g}, transmission "
            f"{transmission:g}"
        )
        for entering in (1, 0) if transmission and metallic < 1 else (1,):
            cosine = float(rng.uniform(0.1, 1))
            measured, spread = albedo(bench, closures, cosine, entering, 8)
            loss = 0.012 if entering else 0.03
            note_here = f"{note}, alpha {alpha:g}, cosine {cosine:.3f}, entering {entering}"
            sweep.add(measured, 1.0, (_GAIN_GLASS if measured > 1 else loss) + spread + 1e-6, note_here)
    return sweep.outcome()


def _principled(distribution: Distribution = Distribution.MULTI_GGX, **inputs) -> tuple[Closure, ...]:
    """Closures of a Principled BSDF of constants."""
    return layered_closures(
        Layers(distribution=distribution, **{name: Value.of(value) for name, value in inputs.items()})
    )


@case(
    "Principled at random never makes energy",
    "materials",
    "300 Principled materials of random parameters and colours, seeded, from outside, also at grazing angles: the "
    "albedo of the channel that reflects most is at most 1, and no number is invalid.",
    f"{STATISTICS}, and 0.02 of tables at grazing angles.",
    traces=False,
)
def principled_at_random(bench: Bench) -> Outcome:
    """Sweep over random parameters."""
    rng = np.random.default_rng(9)
    sweep = Sweep()
    for i in range(300):
        u = rng.random(12)
        ior = float(10 ** rng.uniform(-2, 3)) if i % 2 else 1 + u[5]
        closures = _principled(
            base=tuple(u[:3]),
            metallic=u[3],
            roughness=u[4] ** 2,
            ior=ior,
            level=2 * u[6],
            # an index below 1 leaves more to the base than there is; it has a case of its own
            transmission=u[10] if ior >= 1 else 1.0,
            alpha=u[11],
            distribution=Distribution.MULTI_GGX if i % 3 else Distribution.GGX,
        )
        cosine = float(10 ** rng.uniform(-4, 0))
        measured, spread = albedo(bench, closures, cosine, 1, 8)
        sweep.add(
            max(measured - 1, 0.0) if measured == measured else measured,
            0.0,
            0.02 + spread,
            f"number {i}, cosine {cosine:.2g}",
        )
    return sweep.outcome()


@case(
    "metal at grazing angles",
    "materials",
    "A smooth metal at cosines of 1 to 1e-7: F82-tint, f0 + (1 - f0) (1 - cos)^5 - b cos (1 - cos)^6 with b from the "
    "tint, in float64 of the float32 cosine.",
    "Eight roundings of the reflectance, and the cosine's own rounding times the slopes, 5 and b.",
    traces=False,
    quick=True,
)
def grazing_metal(bench: Bench) -> Outcome:
    """Sweep over angles."""
    f0, tint = np.array([0.9, 0.5, 0.1]), np.array([1.0, 0.9, 0.8])
    dip = (f0 + (1 - f0) * (6 / 7) ** 5) * (1 - tint) / ((1 / 7) * (6 / 7) ** 6)
    sweep = Sweep()
    for cosine in (1.0, 0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-7):
        closure = Closure(K.METAL, tuple(f0), 0.0, edge=tuple(tint))
        weight = sample(bench, (closure,), probe.toward(cosine), 64)[1]
        expected = f0 + (1 - f0) * (1 - cosine) ** 5 - dip * cosine * (1 - cosine) ** 6
        for channel in range(3):
            sweep.add(weight[:, channel].mean(), expected[channel], 16 * UNIT_ROUNDOFF, f"cosine {cosine:g}")
    return sweep.outcome()
