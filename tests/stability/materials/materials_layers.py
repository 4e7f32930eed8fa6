"""Layers above a Principled base: sheen, coat, tints, thin walls, at the ends of their ranges and stacked."""

from __future__ import annotations

import itertools

import numpy as np

from raybatch_addon.core.programs.builder import Value
from raybatch_addon.core.programs.ops.closures.facets import Distribution
from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.export.nodes.node import WHITE as WHITE_VALUE
from raybatch_addon.export.nodes.node import Graph, Node
from raybatch_addon.export.nodes.shaders.principled import Coat, Layers, Sheen, add_layers
from tests.core.programs.host_program import closures_seen_at
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import (
    COSINES,
    GRAZING,
    LEAST_ROUGH,
    ROUGHNESSES,
    STATISTICS,
    WHITE,
    albedo,
    evaluate,
    sample,
)
from tests.stability.materials.materials_sampling import CHI_ABOUT, CHI_BOUND, add_deviate, chi_squared
from tests.stability.uniform import UNIT_ROUNDOFF

_NORMAL = Value.of((0.0, 0.0, 0.0))


def _seen(layers: Layers, cosine: float) -> tuple[Closure, ...]:
    graph = Graph()
    add_layers(Node(graph, None), WHITE_VALUE, layers)
    return closures_seen_at(graph.builder.finish(), cosine)


def _coat(weight: float, roughness: float, ior: float, tint=WHITE) -> Coat:
    return Coat(Value.of(weight), Value.of(roughness), Value.of(ior), Value.of(tint), _NORMAL)


def _sheen(weight: float, roughness: float, tint=WHITE) -> Sheen:
    return Sheen(Value.of(weight), Value.of(roughness), Value.of(tint))


@case(
    "furnace: sheen and coat above white",
    "materials",
    "Sheen above a coat above a white base, diffuse or metal, at the ends and in the middle of their shares, "
    "roughnesses and indices: no more light comes back than came. With smooth layers, which hide nothing of "
    "themselves, all of it.",
    f"{STATISTICS}; 0.003 of tables for what is gained. A rough coat loses what its facets hide from each other, as "
    "in Cycles.",
    traces=False,
)
def furnace_layers(bench: Bench) -> Outcome:
    """Sweep over the corners of the range of parameters."""
    sweep = Sweep()
    rng = np.random.default_rng(11)
    ends = (0.0, 0.5, 1.0)
    for metallic, sheen, coat, roughness, ior in itertools.product(
        (0.0, 1.0), ends, ends, (0.0, LEAST_ROUGH, 0.3, 1.0), (1.0, 1.5, 10.0)
    ):
        cosine = float(rng.uniform(0.1, 1))
        closures = _seen(
            Layers(
                Value.of(WHITE),
                Value.of(metallic),
                Value.of(0.0),
                coat=_coat(coat, roughness, ior) if coat else None,
                sheen=_sheen(sheen, float(rng.uniform(0, 1))) if sheen else None,
            ),
            cosine,
        )
        measured, spread = albedo(bench, closures, cosine, 1, 8)
        note = (
            f"metallic {metallic:g}, sheen {sheen:g}, coat {coat:g} of roughness {roughness:.3g} and index "
            f"{ior:g}, cosine {cosine:.3f}"
        )
        lossless = roughness <= LEAST_ROUGH or coat == 0 or ior == 1
        sweep.add(measured if lossless else max(measured, 1.0), 1.0, 0.003 + spread, note)
    return sweep.outcome()


@case(
    "layers at random never make energy",
    "materials",
    "300 Principled materials with sheen, tinted coat, tinted specular, rough diffuse base and thin walls, of random "
    "parameters, seeded, also at grazing angles: the albedo of the channel that reflects most is at most 1, and no "
    "number is invalid.",
    f"{STATISTICS}, and 0.02 of tables at grazing angles.",
    traces=False,
)
def layers_at_random(bench: Bench) -> Outcome:
    """Sweep over random parameters."""
    rng = np.random.default_rng(12)
    sweep = Sweep()
    for i in range(300):
        u = rng.random(24)
        layers = Layers(
            Value.of(tuple(u[:3])),
            Value.of(u[3]),
            Value.of(u[4] ** 2),
            ior=Value.of(1 + u[5]),
            level=Value.of(u[6]),
            tint=Value.of(tuple(u[7:10])),
            transmission=Value.of(u[10]),
            alpha=Value.of(u[11]),
            distribution=Distribution.MULTI_GGX if i % 3 else Distribution.GGX,
            diffuse_roughness=Value.of(u[12]) if i % 2 else None,
            thin=i % 5 == 0,
            coat=_coat(u[13], u[14] ** 2, 1 + u[15], tuple(u[16:19])),
            sheen=_sheen(u[19], u[20], tuple(u[21:24])),
        )
        cosine = float(10 ** rng.uniform(-4, 0))
        measured, spread = albedo(bench, _seen(layers, cosine), cosine, 1, 8)
        sweep.add(
            max(measured - 1, 0.0) if measured == measured else measured,
            0.0,
            0.02 + spread,
            f"number {i}, cosine {cosine:.2g}",
        )
    return sweep.outcome()


_BELOW_ONE = (0.1, 0.3, 0.5, 0.8, 0.95, 1 - 1e-3)


@case(
    "Principled of an index below 1",
    "materials",
    "A dielectric layer of index 0.1 to 1 reflects once what Fresnel's equations say, total reflection included "
    "(float64 quadrature of D G2 F / (4 cos)), with what bounces more than once at most all light; and leaves the "
    "base what a layer of the inverse index would, as in Cycles. (So such a surface as a whole may give back more "
    "light than came.)",
    f"{STATISTICS}, and 2e-3 of the quadrature at the kink of total reflection. The share left to the base: 16 "
    "roundings.",
    traces=False,
)
def below_one(bench: Bench) -> Outcome:
    """Sweep over indices, roughnesses and angles."""
    sweep = Sweep()
    for ior, roughness, cosine in itertools.product(_BELOW_ONE, (0.3, 0.6, 1.0), (0.9, 0.5, 0.2)):
        note = f"index {ior:g}, roughness {roughness:g}, cosine {cosine:g}"
        once, spread = albedo(bench, (Closure(K.DIELECTRIC, WHITE, roughness, ior, multiscatter=False),), cosine)
        sweep.add(once, probe.hemisphere_albedo(roughness**2, cosine, ior), 2e-3 + spread, note)
        bases = [(Closure(K.LAYERED_DIFFUSE, WHITE, roughness, i, multiscatter=False),) for i in (ior, 1 / ior)]
        base, inverse = (albedo(bench, each, cosine)[0] for each in bases)
        sweep.add(base, inverse, 16 * UNIT_ROUNDOFF, f"base, {note}")
    for ior, roughness, cosine in itertools.product(_BELOW_ONE, ROUGHNESSES, (*COSINES, *GRAZING)):
        measured, spread = albedo(bench, (Closure(K.DIELECTRIC, WHITE, roughness, ior),), cosine, 1, 8)
        sweep.add(
            max(measured - 1, 0.0), 0.0, 2e-3 + spread, f"index {ior:g}, roughness {roughness:.3g}, cosine {cosine:g}"
        )
    return sweep.outcome()


@case(
    "furnace: rough sheets",
    "materials",
    "A white sheet lets all light through, whatever its roughness; and f(wo, wi) = f(wi, wo) through it without what "
    "bounces more than once.",
    f"{STATISTICS}, and the table of albedos as for glossy facets. Reciprocity: as for reflection.",
    traces=False,
    quick=True,
)
def furnace_sheet(bench: Bench) -> Outcome:
    """Sweep over roughnesses and angles."""
    sweep = Sweep()
    for roughness, cosine in itertools.product(ROUGHNESSES, (*COSINES, *GRAZING)):
        measured, spread = albedo(bench, (Closure(K.SHEET, WHITE, roughness),), cosine)
        bound = (1e-3 if measured > 1 else 2.5e-3) + spread + 16 * UNIT_ROUNDOFF
        sweep.add(measured, 1.0, bound, f"roughness {roughness:.3g}, cosine {cosine:g}")
    rng = np.random.default_rng(13)
    for roughness in (0.2, 0.5, 1.0):
        closure = (Closure(K.SHEET, WHITE, roughness, multiscatter=False),)
        for _ in range(12):
            a, b = (probe.toward(rng.uniform(0.02, 1), rng.uniform(0, 6)) for _ in range(2))
            there = evaluate(bench, closure, a, b * [1, 1, -1])[0][0, 0] / b[2]
            back = evaluate(bench, closure, b, a * [1, 1, -1])[0][0, 0] / a[2]  # the frame is on the side of wo
            sweep.add(
                there / back, 1.0, (32 * 4 / roughness**2 + 32) * UNIT_ROUNDOFF, f"reciprocity, roughness {roughness:g}"
            )
    return sweep.outcome()


_AWAY = (0.0, 0.6, -0.8)
_TURNED = {
    "glossy": Closure(K.GLOSSY, WHITE, 0.5, normal=_AWAY),
    "smooth glossy": Closure(K.GLOSSY, WHITE, 0.0, normal=_AWAY),
    "metal": Closure(K.METAL, (0.9, 0.6, 0.3), 0.4, normal=_AWAY),
    "glass": Closure(K.GLASS, WHITE, 0.5, 1.5, normal=_AWAY),
    "coat": Closure(K.DIELECTRIC, WHITE, 0.3, 1.5, normal=_AWAY),
    "sheet": Closure(K.SHEET, WHITE, 0.5, normal=_AWAY),
}
_UPRIGHT = Closure(K.DIFFUSE, (0.8, 0.5, 0.2))


@case(
    "closures turned away hide no others",
    "materials",
    "Facets about a normal of their own that is turned away from the viewer reflect nothing, and are never sampled: "
    "with a diffuse closure beside them values, densities and samples are those of that closure alone, to the bit. "
    f"{CHI_ABOUT}: the same with facets of normals that are tilted, beside each other.",
    f"The same numbers. {CHI_BOUND}",
    traces=False,
)
def turned_away(bench: Bench) -> Outcome:
    """Sweep over kinds and angles."""
    sweep = Sweep()
    wo = probe.toward(0.9, 0.0)
    wi = np.array(
        [probe.toward(c, a) * [1, 1, sign] for c in (0.9, 0.4, 0.1) for a in (0.0, 2.0, 4.0) for sign in (1, -1)]
    )
    u = np.random.default_rng(14).random((256, 3), np.float32)
    alone = [*evaluate(bench, (_UPRIGHT,), wo, wi), *sample(bench, (_UPRIGHT,), wo, 0, 1, u)]
    for name, closure in _TURNED.items():
        for closures in ((_UPRIGHT, closure), (closure, _UPRIGHT)):
            both = [*evaluate(bench, closures, wo, wi), *sample(bench, closures, wo, 0, 1, u)]
            sweep.add(
                sum(int((x != y).sum()) for x, y in zip(alone, both, strict=True)), 0, 0, f"{name}, numbers that differ"
            )
        sweep.add(float(np.abs(evaluate(bench, (closure,), wo, wi)[0]).max()), 0.0, 0.0, f"{name} alone")
    tilted = (
        Closure(K.GLOSSY, (0.5, 0.4, 0.3), 0.5, normal=_AWAY),
        Closure(K.DIELECTRIC, WHITE, 0.4, 1.5, normal=(0.6, 0.0, 0.8)),
        Closure(K.METAL, (0.9, 0.6, 0.3), 0.6, normal=(-0.8, 0.0, 0.6)),
        _UPRIGHT,
        Closure(K.SHEET, (0.3, 0.3, 0.3), 0.6, normal=(0.0, 0.6, 0.8)),
    )
    for closures, cosine in itertools.product(
        (tilted, tilted[:1], tilted[2:3], (Closure(K.SHEET, WHITE, 0.4),)), (0.95, 0.5, 0.15)
    ):
        add_deviate(
            sweep,
            chi_squared(bench, closures, cosine),
            f"{len(closures)} of {closures[0].kind.name.lower()}, cosine {cosine:g}",
        )
    return sweep.outcome()
