"""What is measured: schedules, scenes in memory and beyond it, and kinds of rays. All schedules of a scene trace the
same rays in turns, and meet the same.
"""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types
from benchmarking.scenes import BenchmarkScene, with_paths
from benchmarking.tracers.batching import Budget, WaitingTracer, ZeroCopyTracer
from benchmarking.tracers.interface import Hits, MeasuredTracer
from benchmarking.tracers.stages import SceneTrees, StageTracer
from made_scenes.forest import forest
from made_scenes.island import island

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import TREELET_BYTES
from studies import scenes
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

KINDS = ("primary", "bounce1", "bounce4")
UNBATCHED, DEFAULT = "unbatched", "default"
BUDGET_SHARE = 4  # beyond memory, a quarter of the tree is on the device
RAYS = {False: (2_000, 60_000), True: (20_000, 4_000_000)}  # of each kind, by whether on a GPU: quick, full


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


@dataclass(frozen=True)
class Made:
    """A scene of the study in a square frame."""

    make: Callable[[Options, int], Scene]
    up: str


def _forest(sizes: tuple[int, int], edge: int) -> Scene:
    return forest(*sizes, detail=2, seed=1, width=edge, height=edge)


def _island(sizes: tuple[int, int], edge: int) -> Scene:
    return island(*sizes, detail=2, seed=1, width=edge, height=edge)


# A mesh of small triangles, architecture of large ones, many instances, and open ground
SCENES = {
    "bunny": Made(lambda options, edge: scenes.grid("bunny", options, 8 if options.is_cuda else 4, edge), "y"),
    "sponza": Made(lambda options, edge: scenes.under_the_sky("sponza", options, edge), "y"),
    "san_miguel": Made(lambda options, edge: scenes.under_the_sky("san_miguel", options, edge), "z"),
    "forest": Made(lambda options, edge: _forest(options.pick((2_000, 65), (200_000, 1025)), edge), "z"),
    "island": Made(lambda options, edge: _island(options.pick((500, 129), (20_000, 1025)), edge), "z"),
}
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


def different(mine: Hits, expected: Hits) -> int:
    """Rays that met something else, bit for bit."""
    wrong = mine.hit != expected.hit
    for name in ("t", "instance", "primitive", "uv"):
        a, b = (getattr(each, name) for each in (mine, expected))
        if a is not None and b is not None:
            unequal = a.view(np.int32) != b.view(np.int32)
            wrong |= expected.hit & (unequal.any(1) if unequal.ndim > 1 else unequal)
    return int(np.count_nonzero(wrong))


@dataclass
class KeptTrees:
    """Trees of a scene, and its pages in a folder."""

    device: wp.Device
    folder: tempfile.TemporaryDirectory
    _made: dict[tuple[int, ...], SceneTrees] = field(default_factory=dict)

    def of(self, rule: tuple[int, ...]) -> SceneTrees:
        """Those whose pages are cut by `rule`."""
        return self._made.setdefault(rule, SceneTrees(self.device, RenderSettings()))


@functools.lru_cache(maxsize=len(ON_CUDA))
def kept_trees(name: str, options: Options) -> KeptTrees:
    """Nothing is built yet."""
    folder = tempfile.TemporaryDirectory(prefix="raybatch-pages-", ignore_cleanup_errors=True)
    return KeptTrees(wp.get_device(options.device), folder)


@functools.lru_cache(maxsize=len(ON_CUDA))
def captured(name: str, options: Options) -> tuple[BenchmarkScene, dict[str, CapturedRays]]:
    """A scene, and its rays by kind."""
    count = options.pick(*RAYS[options.is_cuda])
    made, settings = SCENES[name], RenderSettings()
    scene = made.make(options, math.isqrt(count - 1) + 1)
    for mesh in scene.meshes:  # as an export's are
        freeze(mesh.positions)
        freeze(mesh.triangles)
    scene = checked_scene(with_paths(scene, settings, made.up))
    whole = BenchmarkScene(name, scene, settings, flatten(scene), derive_features(scene, settings).instancing)
    found = capture_rays(whole, settings, parse_ray_types(",".join(KINDS)), count, options.device)
    return whole, {each.type.name: each for each in found}
