"""What is measured: schedules, scenes in memory and beyond it, and kinds of rays. All schedules of a scene trace the
same rays in turns, and meet the same.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import warp as wp
from benchmarking.tracers.batching import Budget, WaitingTracer, ZeroCopyTracer
from benchmarking.tracers.interface import MeasuredTracer
from benchmarking.tracers.stages import StageTracer

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import TREELET_BYTES
from studies.rays.captured import KINDS, SCENES, captured, different, kept_trees
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

UNBATCHED, DEFAULT = "unbatched", "default"
BUDGET_SHARE = 4  # beyond memory, a quarter of the tree is on the device

SELECTIONS = ("ALL", "MOST_FULL", "NEXT", "RANDOM", "LAZY", "BALANCED")


@dataclass(frozen=True)
class Schedule:
    """One way to trace. `settings` by name; sizes of treelets are given as parts or multiples of AUTO's."""

    name: str
    settings: dict[str, Any] = field(default_factory=dict)
    treelet: float = 0.0  # as a share of AUTO's; 0: left to AUTO
    tier: float = 0.0  # size of large treelets, as a multiple of those

    def made(self, treelet_bytes: int) -> RenderSettings:
        """The settings, where AUTO makes treelets of `treelet_bytes`."""
        size = int(treelet_bytes * (self.treelet or 1))
        sized: dict[str, Any] = {"treelet_bytes": size} if self.treelet else {}
        if self.tier:
            sized["treelet_tier_bytes"] = int(size * self.tier)
        return RenderSettings(**self.settings, **sized)


SCHEDULERS = (
    Schedule(DEFAULT),
    *(
        Schedule(name, {"bucket_selection": name})
        for name in ("ALL", "MOST_FULL", "NEXT", "RANDOM", "LAZY", "BALANCED")
    ),
    *(Schedule(f"{count} queues a ray", {"queues_per_ray": count}) for count in (2, 4, 8)),
    Schedule("4 queues a ray, ALL", {"queues_per_ray": 4, "bucket_selection": "ALL"}),
    Schedule("tiers, 8 times as large", tier=8),
    Schedule("tiers, 64 times as large", tier=64),
    Schedule("tiers, 1/16 in AUTO's", treelet=1 / 16, tier=16),
    Schedule("tiers, 8 times, ALL", {"bucket_selection": "ALL"}, tier=8),
    Schedule("cache of 4 treelets", {"treelet_cache": 4}),
    Schedule("cache of 32 treelets", {"treelet_cache": 32}),
    Schedule("prefetch", {"treelet_prefetch": "ON"}),
)
SIZES = tuple(
    Schedule(f"treelets of AUTO's size {text}", treelet=factor)
    for text, factor in (("/ 64", 1 / 64), ("/ 16", 1 / 16), ("/ 4", 1 / 4), ("x 4", 4.0), ("x 16", 16.0))
)
PAGED = (Schedule(DEFAULT), Schedule("treelets of AUTO's size", treelet=1), Schedule("tiers", tier=1))
PLACES = {"memory": (*SCHEDULERS, *SIZES), "beyond": PAGED}


ON_CUDA = ("bunny", "forest", "island")  # of which a machine without the others has all
KINDS_ON_CUDA = ("bounce1", "bounce4", "primary")


def cases(options: Options) -> list[Case]:
    """All schedules for each scene, place and kind of rays; those of one scene, place and kind take turns. On a GPU,
    where time may be short, one kind of rays after another.
    """
    if options.is_cuda:
        groups = [(scene, place, kind) for kind in KINDS_ON_CUDA for scene in ON_CUDA for place in PLACES]
    else:
        groups = [(scene, place, kind) for scene in SCENES for place in PLACES for kind in KINDS]
    found = []
    for scene, place, kind in groups:
        group = f"{scene} {place} {kind}"
        for name in (UNBATCHED, *(each.name for each in PLACES[place])):
            what = {"scene": scene, "place": place, "kind": kind, "schedule": name}
            found.append(Case(f"{group} {name}", group, what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Trace the rays once; what was met is compared with the unbatched tracer's before."""
    what = case.what
    found = prepared(what["scene"], what["place"], what["kind"], bench.options)
    name = what["schedule"]
    error = found.refused.get(name)
    if error is not None:
        raise error
    tracer = found.tracers[name]
    seconds = tracer.trace().seconds
    work = found.work[name]
    return {"seconds": seconds, "rays": found.ray_count, "wrong": found.wrong[name], "tree_bytes": found.bytes, **work}


@dataclass
class Prepared:
    """Tracers by schedule that have taken the same rays in."""

    tracers: dict[str, MeasuredTracer]
    refused: dict[str, RayBatchError]
    wrong: dict[str, int]  # rays that met something else than unbatched
    work: dict[str, dict[str, Any]]  # of a ray, of those that wait
    ray_count: int
    bytes: int


@functools.lru_cache(maxsize=1)
def prepared(name: str, place: str, kind: str, options: Options) -> Prepared:
    """All tracers of a scene and kind of rays, each of which has traced them once."""
    scene, rays = captured(name, options)
    device = wp.get_device(options.device)
    settings, kept = RenderSettings(), kept_trees(name, options)
    trees = kept.of(())
    control: MeasuredTracer = StageTracer(UNBATCHED, trees, device, "OFF")
    size = control.build(scene).bytes or 0
    whole = control
    budget = Budget(size // BUDGET_SHARE if place == "beyond" else 0, Path(kept.folder.name))
    if budget.bytes:
        # without batching rays read pinned memory, or page in their own order
        control = (
            ZeroCopyTracer(UNBATCHED, trees, device, False)
            if device.is_cuda
            else WaitingTracer(UNBATCHED, trees, device, settings, budget, in_ray_order=True)
        )
    tracers: dict[str, MeasuredTracer] = {UNBATCHED: control}
    treelet_bytes = TREELET_BYTES[layout_for(device)]
    for each in PLACES[place]:
        made = each.made(treelet_bytes)
        if made.treelet_cache:
            made = made.replace(treelet_cache=made.treelet_cache * treelet_bytes)
        # pages are cut by the rule of their schedule
        rule = (made.treelet_bytes, made.treelet_tier_bytes) if budget.bytes else ()
        own = kept.of(rule if any(rule) else ())
        tracers[each.name] = WaitingTracer(each.name, own, device, made, budget)
    taken = rays[kind]
    found = Prepared(tracers, {}, {}, {}, len(taken), size)
    found.work[UNBATCHED] = {}
    whole.load(taken, 1)
    whole.trace()
    expected = whole.hits()
    for key, tracer in tracers.items():
        try:
            if tracer is not whole:
                tracer.build(scene)
                tracer.load(taken, 1)
                tracer.trace()
        except RayBatchError as error:
            found.refused[key] = error
            continue
        found.wrong[key] = different(tracer.hits(), expected)
        if isinstance(tracer, WaitingTracer):
            found.work[key] = tracer.done()
    return found
