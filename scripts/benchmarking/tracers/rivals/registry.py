"""The rivals by name, with their parameters and how each is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp
from lib.command import UsageError

from benchmarking.tracers.interface import MeasuredTracer
from benchmarking.tracers.rivals.breadth.tracer import BreadthFirstTracer
from benchmarking.tracers.rivals.packets import PartitionTracer, RangedTracer
from benchmarking.tracers.rivals.parameters import Parameter, RivalRequest, parse_rival
from benchmarking.tracers.rivals.ray_streams import DynamicStreamTracer, FilterTracer, OrderedStreamTracer
from benchmarking.tracers.rivals.raycrawler import RayCrawlerTracer
from benchmarking.tracers.rivals.reordering import KEYS, HitPointTracer, KeyTracer
from benchmarking.tracers.stages import SceneTrees
from raybatch_addon.core.settings.settings import RenderSettings

RAYS_MAX = 16_384  # of a packet or stream
_ALONE = Parameter(2, "so many rays or fewer of a stream go on one by one", 0, RAYS_MAX)
_TRAVERSAL = Parameter("interleaved", "how rays are traced behind", choices=("interleaved", "plain"))


@dataclass(frozen=True)
class Rival:
    """One rival."""

    summary: str
    parameters: dict[str, Parameter]
    make: Callable[[RivalRequest, SceneTrees, wp.Device, RenderSettings], MeasuredTracer]
    cpu_only: bool = True


RIVALS = {
    "packet": Rival(
        "packets, ranged traversal and frusta (Wald et al. 2007)",
        {"rays": Parameter(64, "rays of a packet", 1, RAYS_MAX)},
        lambda asked, trees, device, settings: RangedTracer(asked.label, trees, device, size=asked.values["rays"]),
    ),
    "partition": Rival(
        "large packets, partition traversal (Overbeck et al. 2008)",
        {"rays": Parameter(256, "rays of a packet", 1, RAYS_MAX)},
        lambda asked, trees, device, settings: PartitionTracer(asked.label, trees, device, size=asked.values["rays"]),
    ),
    "drst": Rival(
        "dynamic ray streams (Barringer and Akenine-Moeller 2014)",
        {"rays": Parameter(512, "rays of a stream", 1, RAYS_MAX), "alone": _ALONE},
        lambda asked, trees, device, settings: DynamicStreamTracer(
            asked.label, trees, device, size=asked.values["rays"], alone=asked.values["alone"]
        ),
    ),
    "orst": Rival(
        "ordered ray streams (Fuetterling et al. 2015)",
        {"rays": Parameter(512, "rays of a stream", 1, RAYS_MAX), "alone": _ALONE},
        lambda asked, trees, device, settings: OrderedStreamTracer(
            asked.label, trees, device, size=asked.values["rays"], alone=asked.values["alone"]
        ),
    ),
    "mbvh-rs": Rival(
        "multi-BVH ray streams (Tsakok 2009)",
        {"rays": Parameter(512, "rays of a stream", 1, RAYS_MAX)},
        lambda asked, trees, device, settings: FilterTracer(asked.label, trees, device, size=asked.values["rays"]),
    ),
    "hit-point": Rival(
        "rays in the order of their hits in a simplified scene (Moon et al. 2010)",
        {"cells": Parameter(64, "cells along a mesh's longest side", 2, 4096), "traversal": _TRAVERSAL},
        lambda asked, trees, device, settings: HitPointTracer(asked.label, trees, device, settings, **asked.values),
        cpu_only=False,
    ),
    "sorted": Rival(
        "rays in the order of a key (Meister et al. 2020)",
        {
            "key": Parameter("two-point", "what rays are sorted by", choices=tuple(KEYS)),
            "reach": Parameter(25, "where two-point guesses the end, percents of the scene's diagonal", 1, 1000),
            "traversal": _TRAVERSAL,
        },
        lambda asked, trees, device, settings: KeyTracer(asked.label, trees, device, **asked.values),
        cpu_only=False,
    ),
    "breadth-first": Rival(
        "sorted packets, frusta level by level (Garanzha and Loop 2010)",
        {
            "rays": Parameter(256, "rays of a packet at most", 1, RAYS_MAX),
            "origin": Parameter(5, "bits of a coordinate of the origin in the hash", 0, 7),
            "direction": Parameter(3, "bits of a coordinate of the direction in the hash", 0, 5),
        },
        lambda asked, trees, device, settings: BreadthFirstTracer(asked.label, trees, device, **asked.values),
        cpu_only=False,
    ),
    "raycrawler": Rival(
        "queues at treelets (Gasparian and Bikker 2016), as the thesis tells it",
        {
            "treelet": Parameter(800, "nodes of a treelet", 1, 2**24),
            "queue": Parameter(64, "rays of a queue", 1, 2**20),
            "rays": Parameter(10_240, "rays alive", 1, 2**28),
            "storage": Parameter("direct", "how queues hold rays", choices=("direct", "indirect")),
        },
        lambda asked, trees, device, settings: RayCrawlerTracer(asked.label, trees, device, settings, asked.values),
    ),
}


def parse_rivals(texts: list[str]) -> list[RivalRequest]:
    """What the options `--rival` ask for, each once; raises `UsageError`."""
    known = {name: rival.parameters for name, rival in RIVALS.items()}
    return list({asked.label: asked for asked in (parse_rival(text, known) for text in texts)}.values())


def make_rivals(
    requests: list[RivalRequest], trees: SceneTrees, device: wp.Device, settings: RenderSettings
) -> list[MeasuredTracer]:
    """The rivals that are asked for; raises `UsageError` for one that `device` cannot run."""
    for asked in requests:
        if device.is_cuda and RIVALS[asked.name].cpu_only:
            raise UsageError(f"--rival {asked.name} runs on the CPU alone: measure with --device cpu, or leave it out")
    return [RIVALS[asked.name].make(asked, trees, device, settings) for asked in requests]
