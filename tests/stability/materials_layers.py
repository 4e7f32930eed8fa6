"""Layers above a Principled base: sheen, coat, tints, thin walls, at the ends of their ranges and stacked."""

from __future__ import annotations

import itertools

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.shading.nodes.builder import Value
from raybatch_addon.core.shading.nodes.closure_ops_facets import Distribution
from raybatch_addon.export.nodes.node import WHITE as WHITE_VALUE
from raybatch_addon.export.nodes.node import Graph, Node
from raybatch_addon.export.nodes.shaders_principled import Coat, Layers, Sheen, add_layers
from tests.core.shading.nodes.host_program import closures_seen_at

from .bench import Bench
from .case import Outcome, Sweep, case
from .closures import LEAST_ROUGH, WHITE, albedo

_STATISTICS = "Six standard errors, measured over 64 independent sets of stratified samples"
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
    "furnace: sheen and coat above white", "materials",
    "Sheen above a coat above a white base, diffuse or metal, at the ends and in the middle of their shares, roughnesses and indices: no more "
    "light comes back than came. With smooth layers, which hide nothing of themselves, all of it.",
    f"{_STATISTICS}; 0.003 of tables for what is gained. A rough coat loses what its facets hide from each other, as in Cycles.",
    traces=False,
)  # fmt: skip
def furnace_layers(bench: Bench) -> Outcome:
    """Corners of the range."""
    sweep = Sweep()
    rng = np.random.default_rng(11)
    ends = (0.0, 0.5, 1.0)
    for metallic, sheen, coat, roughness, ior in itertools.product((0.0, 1.0), ends, ends, (0.0, LEAST_ROUGH, 0.3, 1.0), (1.0, 1.5, 10.0)):
        cosine = float(rng.uniform(0.1, 1))
        closures = _seen(
            Layers(
                Value.of(WHITE), Value.of(metallic), Value.of(0.0), coat=_coat(coat, roughness, ior) if coat else None,
                sheen=_sheen(sheen, float(rng.uniform(0, 1))) if sheen else None,
            ),
            cosine,
        )  # fmt: skip
        measured, spread = albedo(bench, closures, cosine, 1, 8)
        note = f"metallic {metallic:g}, sheen {sheen:g}, coat {coat:g} of roughness {roughness:.3g} and index {ior:g}, cosine {cosine:.3f}"
        lossless = roughness <= LEAST_ROUGH or coat == 0 or ior == 1
        sweep.add(measured if lossless else max(measured, 1.0), 1.0, 0.003 + spread, note)
    return sweep.outcome()


@case(
    "layers at random never make energy", "materials",
    "300 Principled materials with sheen, tinted coat, tinted specular, rough diffuse base and thin walls, of random parameters, seeded, also at grazing "
    "angles: the albedo of the channel that reflects most is at most 1, and no number is invalid.",
    f"{_STATISTICS}, and 0.02 of tables at grazing angles.",
    traces=False,
)  # fmt: skip
def layers_at_random(bench: Bench) -> Outcome:
    """Random parameters."""
    rng = np.random.default_rng(12)
    sweep = Sweep()
    for i in range(300):
        u = rng.random(24)
        layers = Layers(
            Value.of(tuple(u[:3])), Value.of(u[3]), Value.of(u[4] ** 2), ior=Value.of(1 + u[5]), level=Value.of(u[6]), tint=Value.of(tuple(u[7:10])),
            transmission=Value.of(u[10]), alpha=Value.of(u[11]), distribution=Distribution.MULTI_GGX if i % 3 else Distribution.GGX,
            diffuse_roughness=Value.of(u[12]) if i % 2 else None, thin=i % 5 == 0,
            coat=_coat(u[13], u[14] ** 2, 1 + u[15], tuple(u[16:19])), sheen=_sheen(u[19], u[20], tuple(u[21:24])),
        )  # fmt: skip
        cosine = float(10 ** rng.uniform(-4, 0))
        measured, spread = albedo(bench, _seen(layers, cosine), cosine, 1, 8)
        sweep.add(max(measured - 1, 0.0) if measured == measured else measured, 0.0, 0.02 + spread, f"number {i}, cosine {cosine:.2g}")
    return sweep.outcome()
