"""What is simulated: policies, scenes, kinds of rays, and two sizes of the second-level cache."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from benchmarking.rays import CapturedRays, capture_rays, parse_ray_types
from benchmarking.scenes import BenchmarkScene, with_paths

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.hardware.accumulation import Accumulation
from studies.hardware.machine import BALANCED, LAZY, Cache, Machine
from studies.hardware.packets import Packets
from studies.hardware.plain import RAYCORE, TRAX, Plain, Policy, Subject, subject_of
from studies.hardware.prefetch import TreeletPrefetch
from studies.hardware.queues import TreeletQueues
from studies.hardware.record import launched, quantised_tree, record
from studies.hardware.reorder import ReorderBuffer
from studies.hardware.simulate import simulate
from studies.hardware.traces import NODE_WORDS, TRIANGLE_WORDS, Traces
from studies.hardware.treelets import tree_shape
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

KINDS = ("primary", "bounce1", "bounce4", "shadow1")
SCENES = {"sponza": 1, "san_miguel": 1, "bunny": 4}  # and copies along each of two axes
RAYS = (4_000, 60_000)  # of each kind: quick, full
CHECK_RAYS = (4_000, 500_000)
CHECK_SCENE, CHECK_KIND = "bunny", "bounce1"
RAY_BYTES = 64  # of a ray in a buffer: origin, direction, length, where it came from, and what it is for
STATE_BYTES = 128  # of a ray on its way: that, the hit so far and a stack
CHIP_BYTES = 48  # of a ray in a stream on the chip
MACHINE = Machine()
L2_SIZES = {"small": 1 << 20, "large": 256 << 20}
# Single rays on a GPU: caches of the H100's sizes, the rays in flight of a kernel of 64 registers
GPU = Machine(
    processors=132,
    slots=480,
    l1=Cache(192 << 10, 4),
    l2=Cache(50 << 20, 16),
    l2_rate=4096,
    memory_rate=2048,
    memory_latency=600,
)

# Queues in memory as Aila and Karras have them
_QUEUES = functools.partial(TreeletQueues, rule="area", alive=32_768, ray_bytes=STATE_BYTES, in_memory=True)

POLICIES: tuple[Policy, ...] = (
    Plain(),
    Plain("plain, rays shuffled", order="shuffled"),
    Plain("plain, tree by treelets of 16 KB", treelet=16 << 10),
    TRAX,
    RAYCORE,
    Packets("packets of 4 (SaarCOR, RPU)", 4),
    Packets("packets of 16", 16),
    Accumulation("accumulation (SGRT)", 64, 64),
    Accumulation("accumulation, 256 rays a processor", 256, 256, slots=256),
    Accumulation("accumulation, the same, two registers", 256, 2, slots=256),
    _QUEUES(name="queues, lazy (Aila, Karras)", selection=LAZY),
    _QUEUES(name="queues, balanced (Aila, Karras)", selection=BALANCED),
    _QUEUES(name="queues, lazy, rays end with treelets", selection=LAZY, grouped=True),
    TreeletQueues(
        name="streams instead of the L2 (STRaTA)",
        rule="breadth",
        alive=16_384,
        ray_bytes=CHIP_BYTES,
        in_memory=False,
        grouped=True,
        second_level=False,
    ),
    TreeletQueues(
        name="streams beside the L2", rule="breadth", alive=16_384, ray_bytes=CHIP_BYTES, in_memory=False, grouped=True
    ),
    TreeletQueues(
        name="streams beside the L2, treelets by area",
        rule="area",
        alive=16_384,
        ray_bytes=CHIP_BYTES,
        in_memory=False,
        grouped=True,
    ),
    TreeletPrefetch(name="treelets of 512 B, no prefetching", vote_cycles=0),
    TreeletPrefetch(name="prefetching, always (Chou)"),
    TreeletPrefetch(name="prefetching, by a quarter of the rays", threshold=0.25),
    ReorderBuffer("sorted, 2,048 rays on the chip", 2048),
    ReorderBuffer("sorted, 16,384 rays in memory", 16_384, sorted_bytes=RAY_BYTES),
    ReorderBuffer("sorted, all rays in memory", 1 << 30, sorted_bytes=RAY_BYTES),
    ReorderBuffer("sorted by origin, all rays in memory", 1 << 30, by_origin=True, sorted_bytes=RAY_BYTES),
)
CHECKED = {name: Plain(f"plain, {name}", order=name) for name in ("natural", "shuffled", "sorted")}


def cases(options: Options) -> list[Case]:
    """All policies for each scene, kind of rays and cache; and what a profiler could confirm, which on a GPU is all
    there is.
    """
    found = []
    for scene in () if options.is_cuda else SCENES:
        for kind in KINDS:
            for cache in L2_SIZES:
                for policy in POLICIES:
                    what = {"scene": scene, "kind": kind, "cache": cache, "policy": policy.name}
                    found.append(Case(f"{scene} {kind} {cache} {policy.name}", scene, what))
    for order, policy in CHECKED.items():
        what = {"scene": CHECK_SCENE, "kind": CHECK_KIND, "cache": "gpu", "policy": policy.name, "order": order}
        found.append(Case(f"check {CHECK_SCENE} {CHECK_KIND} {order}", "check", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Simulate a case; one for a GPU is also launched there, for a profiler to watch."""
    what, options = case.what, bench.options
    if what["cache"] != "gpu":
        found = prepared(what["scene"], options, KINDS, options.pick(*RAYS))
        policy = next(each for each in POLICIES if each.name == what["policy"])
        return simulated(policy, found.subject, found.traces[what["kind"]], what["cache"])
    found = prepared(what["scene"], options, (what["kind"],), options.pick(*CHECK_RAYS))
    traces = found.traces[what["kind"]]
    if options.is_cuda:
        launched(found.built, found.rays[what["kind"]], traces.order(what["order"]), wp.get_device(options.device))
    return simulated(CHECKED[what["order"]], found.subject, traces, "gpu")


def simulated(policy: Policy, subject: Subject, traces: Traces, cache: str) -> Row:
    """A row of counts."""
    machine = GPU if cache == "gpu" else replace(MACHINE, l2=Cache(L2_SIZES[cache], MACHINE.l2.ways))
    plan = policy.plan(subject, traces, machine)
    in_memory = plan.in_memory or plan.sorted_bytes > 0
    return {**asdict(simulate(plan)), "queues_in_memory": in_memory, "tree_bytes": subject.addresses.byte_count}


@dataclass(frozen=True)
class Prepared:
    """A scene's tree, and its rays by kind."""

    built: BuiltTree
    subject: Subject
    rays: dict[str, CapturedRays]
    traces: dict[str, Traces]


@functools.lru_cache(maxsize=1)
def prepared(name: str, options: Options, kinds: tuple[str, ...], count: int) -> Prepared:
    """`count` rays of each kind."""
    scene = traced_scene(name, options, math.isqrt(count - 1) + 1)
    built = quantised_tree(scene)
    types = parse_ray_types(",".join(kinds))
    rays = {each.type.name: each for each in capture_rays(scene, scene.settings, types, count, "cpu")}
    words = built.tree.nodes.numpy().view(np.uint32).reshape(-1, 4 * NODE_WORDS)
    shape = tree_shape(words, built.tree.triangles.shape[0] // TRIANGLE_WORDS)
    return Prepared(built, subject_of(shape), rays, {kind: record(built, each) for kind, each in rays.items()})


def traced_scene(name: str, options: Options, edge: int) -> BenchmarkScene:
    """A scene of the study in a square frame."""
    if SCENES[name] > 1:
        scene = scenes.grid(name, options, SCENES[name], edge)
    else:
        scene = scenes.under_the_sky(name, options, edge)
    settings = RenderSettings()
    scene = checked_scene(with_paths(scene, settings, scenes.FILES[name][1]))
    return BenchmarkScene(name, scene, settings, flatten(scene), derive_features(scene, settings).instancing)
