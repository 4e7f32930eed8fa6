"""Single scattering by rough facets against quadrature, and emission."""

from __future__ import annotations

import itertools

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import STATISTICS, WHITE, albedo, evaluate


@case(
    "albedo of rough facets at grazing angles",
    "materials",
    "Single scattering of GGX with F = 1 at cosines of 1 to 0.01: the integral of D G2 / (4 cos) over the hemisphere, "
    "float64 Gauss-Legendre.",
    f"{STATISTICS}, and 1e-3 of the quadrature at the least roughness that it resolves.",
    traces=False,
)
def single_scattering(bench: Bench) -> Outcome:
    """Sweep over roughnesses and angles."""
    sweep = Sweep()
    for roughness, cosine in itertools.product((0.4, 0.7, 1.0), (1.0, 0.5, 0.1, 0.03, 0.01)):
        measured, spread = albedo(bench, (Closure(K.GLOSSY, WHITE, roughness, multiscatter=False),), cosine)
        expected = probe.hemisphere_albedo(roughness**2, min(cosine, 1 - 1e-12))
        sweep.add(measured, expected, 1e-3 + spread, f"roughness {roughness:g}, cosine {cosine:g}")
    return sweep.outcome()


@case(
    "albedo of rough glass",
    "materials",
    "Single scattering of rough glass of index 0.1 to 100, from outside and inside, at cosines of 1 to 0.001: the "
    "reflected and refracted share, by float64 quadrature over the visible facets (the source of the tables, which "
    "take no part here).",
    f"{STATISTICS}, and 1e-3: the quadrature's error by kinks at the critical angle and the horizon, with 64 x 64 "
    "points.",
    traces=False,
)
def single_scattering_of_glass(bench: Bench) -> Outcome:
    """Sweep over indices, sides, roughnesses and angles."""
    from precompute.albedo_tables import reflected_and_total

    sweep = Sweep()
    iors = (0.1, 0.9, 1.05, 1.5, 2.4, 100.0)
    for roughness, cosine in itertools.product((0.3, 0.6, 1.0), (0.999, 0.5, 0.2, 0.03, 1e-3)):
        wanted = [ior if entering else 1 / ior for ior in iors for entering in (1, 0)]
        expected = iter(reflected_and_total(roughness**2, cosine, np.array(wanted))[2])
        for ior, entering in itertools.product(iors, (1, 0)):
            measured, spread = albedo(
                bench, (Closure(K.GLASS, WHITE, roughness, ior, multiscatter=False),), cosine, entering
            )
            note = f"index {ior:g}, roughness {roughness:g}, cosine {cosine:g}, entering {entering}"
            sweep.add(measured, float(next(expected)), 1e-3 + spread, note)
    return sweep.outcome()


@case(
    "emission of 1e-30 and 1e30",
    "materials",
    "A closure's emission is the given value, on both sides, also beside closures of every kind.",
    "Emission is stored as float32, and added to a 0: the float32 next to the given value, to the bit.",
    traces=False,
)
def emission(bench: Bench) -> Outcome:
    """Sweep over powers."""
    import warp as wp

    sweep = Sweep()
    for power in (0.0, 1e-30, 1.0, 1e30):
        closures = (*probe.ROUGH["all"], Closure(K.EMISSION, (power,) * 3))
        out = wp.zeros(3, dtype=wp.vec3, device=bench.device)
        probe.launch(
            probe.kernels(probe.EVERYTHING).constants,
            1,
            [probe.table_of(*closures, device=bench.device)],
            [out],
            bench.device,
        )
        sweep.add(out.numpy()[0, 0], float(np.float32(power)), 0.0, f"power {power:g}")
        value, _ = evaluate(bench, closures, probe.toward(0.5), probe.toward(0.7))
        sweep.add(float(np.isfinite(value).all()), 1.0, 0.0, "finite")
    return sweep.outcome()
