"""The rows of the table: what each system proposes, where it is in the code, how it is asked for, and a verdict."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

from tables.lineage.figures import (
    hardware_beyond,
    hardware_in_memory,
    on_both,
    rival_beyond,
    rival_in_memory,
    schedule_beyond,
    schedule_in_memory,
    streaming,
    top_level_nodes,
    top_level_rates,
)

NOT_THERE = "–"  # in place of figures


@dataclass(frozen=True, kw_only=True)
class Row:
    """One system."""

    system: str  # with its source
    proposes: str
    code: str  # a file or folder of the project
    setting: str
    in_memory: Callable[[], str]
    beyond: Callable[[], str]
    verdict: str


def _none() -> str:
    return NOT_THERE


def _rival(name: str, system: str, proposes: str, code: str, verdict: str, beyond: bool = True) -> Row:
    return Row(
        system=system,
        proposes=proposes,
        code=f"scripts/benchmarking/tracers/rivals/{code}",
        setting=f"`--rival {name}`",
        in_memory=lambda: on_both(functools.partial(rival_in_memory, name)),
        beyond=(lambda: on_both(functools.partial(rival_beyond, name))) if beyond else _none,
        verdict=verdict,
    )


def _hardware(policy: str, system: str, proposes: str, code: str, verdict: str) -> Row:
    return Row(
        system=system,
        proposes=proposes,
        code=f"scripts/studies/hardware/{code}",
        setting=f"`study.py hardware`, *{policy}*",
        in_memory=lambda: hardware_in_memory(policy),
        beyond=lambda: hardware_beyond(policy),
        verdict=verdict,
    )


def _schedule(
    name: str, system: str, proposes: str, code: str, setting: str, verdict: str, beyond: str | None = None
) -> Row:
    """`name` in the study of schedulers, and `beyond` there beyond memory; None: it has no pages."""
    return Row(
        system=system,
        proposes=proposes,
        code=f"raybatch_addon/core/{code}",
        setting=setting,
        in_memory=lambda: on_both(functools.partial(schedule_in_memory, name)),
        beyond=(lambda: on_both(functools.partial(schedule_beyond, beyond))) if beyond else _none,
        verdict=verdict,
    )


def _top_level(way: str, proposes: str, code: str, verdict: str) -> Row:
    return Row(
        system=f"{way} (the thesis, 3.3.2 and 6.1)",
        proposes=proposes,
        code=f"raybatch_addon/core/native/traverse/quantised/{code}",
        setting=f"`top_level_traversal={way}`, on a GPU",
        in_memory=lambda: f"{top_level_nodes(way)}; {top_level_rates(way)}",
        beyond=_none,
        verdict=verdict,
    )


_BUCKETS = "wavefront/tracers/buckets"
THESIS = (
    Row(
        system="Memory-coherent ray tracing (Pharr, Kolb, Gershbein and Hanrahan 1997)",
        proposes="rays wait for geometry that is not in memory, and what most of them want is brought in",
        code="raybatch_addon/core/wavefront/tracers/pages/tracer.py",
        setting="`geometry_budget`; AUTO where a scene does not fit",
        in_memory=_none,
        beyond=lambda: on_both(functools.partial(schedule_beyond, "default")),
        verdict="what batching is for: AUTO's choice beyond memory",
    ),
    _schedule(
        "MOST_FULL",
        "Batching of divergent rays (the thesis), after RayCrawler",
        "queues at treelets on a GPU, the fullest bucket next",
        f"{_BUCKETS}/tracer.py",
        "`batching=ON`, `bucket_selection=MOST_FULL`; preset `thesis`",
        "slower than rays that do not wait, in memory, everywhere",
    ),
    _schedule(
        "ALL",
        "Sweeps (our own)",
        "every bucket is served in each step, in one sorted sweep",
        f"{_BUCKETS}/serve.py",
        "`bucket_selection=ALL`",
        "AUTO's where rays batch in memory: the best of the schedules on most scenes on a CPU; on a GPU a cache that "
        "holds the whole tree is ahead of it",
    ),
    _schedule(
        "LAZY",
        "Lazy scheduling (Aila and Karras 2010)",
        "a processor stays with a treelet until its queue is empty",
        f"{_BUCKETS}/assigned/lazy.py",
        "`bucket_selection=LAZY`, `bucket_processors`",
        "one processor of a CPU serves few rays a step: behind all",
    ),
    _schedule(
        "BALANCED",
        "Balanced scheduling (Aila and Karras 2010)",
        "queues longer than a target are served, so that all stay of one length",
        f"{_BUCKETS}/assigned/balanced.py",
        "`bucket_selection=BALANCED`",
        "ahead of the fullest first, behind sweeps",
    ),
    _schedule(
        "treelets of AUTO's size / 4",
        "Queue points by cache size (Navrátil et al. 2007)",
        "rays wait where a subtree fits in the cache",
        "bvh/treelets/cut.py",
        "`treelet_bytes` (here 256 KB; AUTO is as large as a core's cache)",
        "smaller is slower: outer caches hold the trees that were tried",
    ),
    _schedule(
        "cache of 32 treelets",
        "Immediate traversal of what is resident (Keely 2014)",
        "a ray goes on as long as the next treelet is in the cache",
        f"{_BUCKETS}/assigned/immediate.py",
        "`treelet_cache`",
        "the nearest to rays that do not wait, where the cache holds most of the tree",
    ),
    _schedule(
        "prefetch",
        "Prefetching of treelets (the thesis, 6.6; Lee et al. 2010)",
        "treelets that most rays wait for are asked for while others are visited",
        f"{_BUCKETS}/assigned/prefetch.py",
        "`treelet_prefetch=ON`",
        "the host's choice of each step costs more than it brings",
    ),
    _schedule(
        "4 queues a ray",
        "Multi-queueing (the thesis, 6.4)",
        "a ray waits in several queues at a time",
        f"{_BUCKETS}/several/serve.py",
        "`queues_per_ray`",
        "rays wait less often, and enter treelets that a nearer hit would have spared them",
    ),
    _schedule(
        "tiers, 8 times as large",
        "Multi-tier trees (the thesis, 6.3; Gasparian and Bikker 2017), two levels for a cache and memory",
        "treelets are in large ones, at which rays wait first",
        f"{_BUCKETS}/assigned/tiers.py",
        "`treelet_tier_bytes`; beyond memory pages are the large ones",
        "another wait, and steps of fewer rays",
        beyond="tiers",
    ),
    _top_level(
        "INTERLOCKED",
        "a warp takes new rays when all of its rays are through",
        "loop.h",
        "fewer nodes, and lanes that wait; on a GPU mostly as fast as NAIVE",
    ),
    _top_level(
        "SHORT_SEGMENT",
        "at a bucket all rays of the warp stop: those that want in before it, the others behind",
        "together/cut.h",
        "rays wait ten times as often; by far the slowest on a GPU",
    ),
    _top_level(
        "LONG_HAUL",
        "rays that stop are replaced at once; no branch is entered that none wants",
        "together/loop.h",
        "fewest nodes, and several times as many turns; on a GPU behind NAIVE",
    ),
    Row(
        system="A persistent schedule of many warps (the thesis, 3 and 6.1)",
        proposes="one kernel, whose warps choose from queues on the device, no host between",
        code="raybatch_addon/core/wavefront/streaming/kernel.py",
        setting="`schedule=STREAMING`",
        in_memory=lambda: on_both(streaming),
        beyond=_none,
        verdict="the same bits without deadlocks; on a GPU it batches sooner than the wavefront, and is behind it "
        "where rays do not wait",
    ),
)
RIVALS = (
    _rival(
        "packet",
        "Packets and frusta (Wald, Boulos and Shirley 2007)",
        "rays that begin alike go through the tree together, and leave it by one test of their bounds",
        "packets.py",
        "for camera rays over large triangles, there the best of all; nowhere else",
    ),
    _rival(
        "partition",
        "Large packets (Overbeck, Ramamoorthi and Mark 2008)",
        "a large packet keeps those rays in front that met a box",
        "packets.py",
        "as packets, with less loss where rays part",
    ),
    _rival(
        "breadth-first",
        "Sorting and breadth-first frusta (Garanzha and Loop 2010)",
        "rays are sorted by a hash, cut into packets, and their frusta go down level by level",
        "breadth/tracer.py",
        "dozens of launches, and no hit ends a packet early: loses by far on both devices",
        beyond=False,
    ),
    _rival(
        "drst",
        "Dynamic ray stream traversal (Barringer and Akenine-Möller 2014)",
        "a stream goes to all children that any of its rays meets, each in its own order",
        "ray_streams.py",
        "in memory only for camera rays; beyond it streams read a node once for many rays",
    ),
    _rival(
        "orst",
        "Ordered ray stream traversal (Fuetterling, Lojewski, Pfreundt and Ebert 2015)",
        "the same with children in an order by octant",
        "ray_streams.py",
        "as DRST, and better with shadow rays",
    ),
    _rival(
        "mbvh-rs",
        "Ray streams (Tsakok 2009)",
        "a stream is filtered into one list a child, in one order for all rays",
        "ray_streams.py",
        "the best stream: close to single rays in memory, and beyond it the only rival that comes near queues",
    ),
    _rival(
        "hit-point",
        "Cache-oblivious ray reordering (Moon et al. 2010)",
        "rays are sorted by where they hit a simplified scene",
        "reordering.py",
        "the traversal before costs more than its order brings in memory; beyond it the order is worth it",
    ),
    _rival(
        "sorted",
        "Ray reordering (Meister, Boksansky, Guthe and Bittner 2020)",
        "rays are sorted by a key of origin and direction",
        "reordering.py",
        "in memory sorting takes what it brings; beyond it the cheapest help",
    ),
    _rival(
        "raycrawler",
        "RayCrawler (Gasparian 2016; Gasparian and Bikker 2017)",
        "a tree of two tiers, rays wait at queue points, the fullest is next",
        "raycrawler.py",
        "what RayBatch's batching comes from; unbatched rays are faster while the tree is in memory",
        beyond=False,
    ),
)
HARDWARE = (
    _hardware(
        "packets of 4 (SaarCOR, RPU)",
        "SaarCOR (Schmittler, Wald and Slusallek 2002), RPU (Woop, Schmittler and Slusallek 2005)",
        "packets of four rays share each fetch",
        "packets.py",
        "saves what the first-level cache holds anyway",
    ),
    _hardware(
        "TRaX",
        "TRaX (Spjut et al. 2009)",
        "many simple threads, each with a ray, small shared caches",
        "plain.py",
        "more bytes than our plain machine: its caches are smaller for each ray",
    ),
    _hardware(
        "streams instead of the L2 (STRaTA)",
        "STRaTA (Kopta et al. 2013)",
        "the second-level cache is a buffer of rays that wait at treelets",
        "queues.py",
        "with a small tree a cache holds more than the buffer saves",
    ),
    _hardware(
        "RayCore",
        "RayCore (Nah et al. 2014)",
        "units of traversal with a cache each, rays rotate while they wait",
        "plain.py",
        "hides waiting, saves no bytes",
    ),
    _hardware(
        "accumulation (SGRT)",
        "SGRT (Lee et al. 2013), with the accumulation unit of T&I (Nah et al. 2011)",
        "rays that wait for one line of the cache are held in a row of a buffer",
        "accumulation.py",
        "the same bytes, less time while lines are on their way",
    ),
    _hardware(
        "queues, lazy (Aila, Karras)",
        "Treelet hardware (Aila and Karras 2010)",
        "queues of rays in memory at treelets, served by processors that are bound to them",
        "queues.py",
        "saves most bytes of the tree, and spends more on its queues",
    ),
    _hardware(
        "prefetching, always (Chou)",
        "Treelet prefetching (Chou, Nowicki and Aamodt 2023)",
        "the treelet below a node is asked for ahead of its rays",
        "prefetch.py",
        "for time, at more bytes",
    ),
    _hardware(
        "sorted, 2,048 rays on the chip",
        "Reorder buffers (since NVIDIA's Turing)",
        "rays are sorted on the chip before they go on",
        "reorder.py",
        "costs nothing, saves little: the buffer is short",
    ),
)
