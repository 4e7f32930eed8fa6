"""How fast tracers find hits: the same rays of real paths for all of them, in one run, in turns."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import warp as wp
from lib.command import UsageError

from benchmarking.judge import Judge, Verdict
from benchmarking.orders import ordered
from benchmarking.progress import Steps
from benchmarking.rays import CapturedRays, RayType, capture_rays
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from benchmarking.timing import spread
from benchmarking.tracers.batching import Budget, WaitingTracer, ZeroCopyTracer
from benchmarking.tracers.embree import PACKAGE, EmbreeTracer, embree_version
from benchmarking.tracers.interface import MeasuredTracer, Timing, Tree
from benchmarking.tracers.rivals.parameters import RivalRequest
from benchmarking.tracers.rivals.registry import make_rivals
from benchmarking.tracers.stages import SceneTrees, StageTracer
from benchmarking.traces.file import check_scene, read_trace
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import device_description, find_device
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.settings.settings import RenderSettings

EMBREE = ("embree", "embree-robust")
WAITING = ("on", "auto", "zero-copy", "zero-copy-triangles", "ray-order")
TRACERS = ("off", "off-plain", "off-sorted", "reference", *EMBREE)  # what is measured unless said otherwise
RAY_COUNT = {"cpu": 1_000_000, "cuda": 4_000_000}  # where --ray-count is not given
WHOLE = ("raycrawler", "breadth-first")  # rivals with a tree of their own
WARM_UPS = 1  # runs before those that are timed


@dataclass(frozen=True, kw_only=True)
class TraversalRequest:
    """One call of `benchmark.py traversal`."""

    scene: SceneRequest
    device: str
    tracers: list[str]  # empty: all that can be measured here
    ray_types: list[RayType]
    orders: list[str]
    threads: list[int]  # CPU only
    runs: int
    rivals: list[RivalRequest] = field(default_factory=list)  # measured beside the tracers
    ray_count: int | None = None
    rays_file: Path | None = None  # a trace whose rays are taken; `ray_types` may then be empty: all that it has
    counters: bool = True  # report node steps and triangle tests where the tracer can
    nodes_resident: bool | None = None  # whether all nodes stay on the device; None: where they fit well
    budget: int = 0  # bytes of geometry on the device, for tracers that let rays wait; 0: all of it
    beyond: bool = False  # tracers that visit a tree in memory have no more than the budget there either
    settings: dict[str, Any] = field(
        default_factory=dict
    )  # of the render that the rays are taken from, and of the tree


def parse_threads(text: str) -> list[int]:
    """Counts of threads, such as `1,2`; raises `UsageError`."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= 1024 for part in parts):
        raise UsageError(f"--threads {text} is not valid: give counts of 1 to 1024, such as 1,2")
    return list(dict.fromkeys(map(int, parts)))


def chosen_tracers(
    names: list[str],
    device: wp.Device,
    settings: RenderSettings,
    counts: bool,
    budget: Budget,
    rivals: list[RivalRequest],
    trees: SceneTrees | None = None,
) -> list[MeasuredTracer]:
    """The tracers called `names`, or all that can be measured on `device`, and `rivals`, which visit `trees`; raises
    `UsageError`.
    """
    trees = trees or SceneTrees(device, settings)
    for name in names:
        if name not in TRACERS + WAITING:
            raise UsageError(f"--tracers {name!r} is not known: choose of {', '.join(TRACERS + WAITING)}")
        if name.startswith("zero-copy") and not device.is_cuda:
            raise UsageError(
                f"{name} reads the host's memory through the bus of a CUDA device: leave it out of --tracers, or "
                "measure with --device cuda"
            )
        if name == "ray-order" and (device.is_cuda or not budget.bytes):
            raise UsageError(
                "ray-order pages geometry on the CPU: measure with --device cpu, and give --budget BYTES below what "
                "the tree needs"
            )
        if name in EMBREE and device.is_cuda:
            raise UsageError(f"{name} runs on the CPU alone: leave it out of --tracers, or measure with --device cpu")
        if name in EMBREE and embree_version() is None:
            raise UsageError(
                f"{name} needs the Python package {PACKAGE}, which is not installed: pip install 'raybatch[benchmark]'"
            )
    if not names:
        names = [name for name in TRACERS if name not in EMBREE or (embree_version() and not device.is_cuda)]
        names = [name for name in names if not (trees.beyond and name in ("reference", *EMBREE))]
    if trees.beyond:
        check_beyond(names, rivals)
    makers = {
        "off": lambda: StageTracer("off", trees, device, "OFF", counts=counts),
        "off-plain": lambda: StageTracer("off-plain", trees, device, "OFF", plain=True, counts=counts),
        "off-sorted": lambda: StageTracer("off-sorted", trees, device, "OFF", sorts=True, counts=counts),
        "on": lambda: WaitingTracer("on", trees, device, settings, budget),
        "auto": lambda: WaitingTracer("auto", trees, device, settings, budget),
        "ray-order": lambda: WaitingTracer("ray-order", trees, device, settings, budget, in_ray_order=True),
        "zero-copy": lambda: ZeroCopyTracer("zero-copy", trees, device, triangles_only=False),
        "zero-copy-triangles": lambda: ZeroCopyTracer("zero-copy-triangles", trees, device, triangles_only=True),
        "reference": lambda: StageTracer("reference", trees, device, "REFERENCE"),
        "embree": lambda: EmbreeTracer(robust=False),
        "embree-robust": lambda: EmbreeTracer(robust=True),
    }
    if "zero-copy" in names:  # whole, and with the triangles alone there
        names = [*names, "zero-copy-triangles"]
    return [makers[name]() for name in dict.fromkeys(names)] + make_rivals(rivals, trees, device, settings)


def check_beyond(names: list[str], rivals: list[RivalRequest]) -> None:
    """Raise `UsageError` where a tracer cannot be measured beyond memory."""
    whole = {"reference", *EMBREE} & set(names) | {asked.name for asked in rivals if asked.name in WHOLE}
    if whole:
        raise UsageError(f"--beyond: {', '.join(sorted(whole))} has its tree in memory only: leave it out")


def page_folder() -> Path:
    """Where files of pages are kept."""
    return Path(kernel_cache_folder() or wp.config.kernel_cache_dir).parent / "pages"


def measure_traversal(request: TraversalRequest) -> dict[str, Any]:
    """The report of `benchmark.py traversal`; raises `RayBatchError`."""
    device = find_device(request.device)
    if device.is_cuda and request.threads != [1]:
        raise UsageError("--threads is for the CPU: one thread drives a CUDA device")
    if request.beyond and not request.budget:
        raise UsageError("--beyond needs to know how much of the tree is there: give --budget BYTES")
    settings = RenderSettings().replace(**request.settings)
    scene_trees = SceneTrees(device, settings, request.budget if request.beyond else 0)
    tracers = chosen_tracers(
        request.tracers,
        device,
        settings,
        request.counters,
        Budget(request.budget, page_folder(), request.nodes_resident),
        request.rivals,
        scene_trees,
    )
    ray_count = request.ray_count or RAY_COUNT["cuda" if device.is_cuda else "cpu"]
    trace = read_trace(request.rays_file) if request.rays_file else None
    types = request.ray_types or (trace.types() if trace else [])
    scene = load_benchmark_scene(request.scene, ray_count)
    steps = Steps(1 + len(tracers) + len(types) * (1 + len(request.orders) * len(request.threads)))
    try:
        steps.begin(f"taking rays from {trace.name if trace else f'a render of {scene.name}'}")
        if trace:
            check_scene(trace, scene)
            captured = trace.captured(types, request.ray_count)
        else:
            settings = scene.settings.replace(**request.settings)
            captured = capture_rays(scene, settings, types, ray_count, device.alias)
        steps.end()
        trees: dict[str, Tree] = {}
        for tracer in tracers:
            steps.begin(f"building the tree of {tracer.name}")
            trees[tracer.name] = tracer.build(scene)
            steps.end()
        judge = Judge(scene.flat, scene.scene.instances.visibility, device)
        results = []
        for rays in captured:
            steps.begin(f"checking the hits of {rays.type.name}")
            verdicts = check_hits(tracers, rays, judge)
            steps.end()
            for order in request.orders:
                in_order = ordered(rays, order)
                for threads in request.threads:
                    steps.begin(f"timing {rays.type.name}, {order}")
                    timings = timed_in_turns(tracers, in_order, threads, request.runs)
                    for tracer in tracers:
                        case = {
                            "tracer": tracer.name,
                            "rays": rays.type.name,
                            "order": order,
                            "threads": None if device.is_cuda else threads,
                        }
                        results.append(
                            case
                            | figures(timings[tracer.name], len(rays))
                            | tracer.work()
                            | described(verdicts[tracer.name])
                        )
                    steps.end()
    finally:
        steps.close()
        scene_trees.close()
    own = next((trees[name] for name in trees if name.startswith("off")), None) or trees[tracers[0].name]
    return {
        "device": device_description(device),
        "versions": versions() | ({"embree": embree_version()} if set(EMBREE) & set(trees) else {}),
        "scene": scene.name,
        **({"rays_file": trace.name} if trace else {}),
        "triangles": scene.triangle_count,
        "build_s": round(own.build_seconds, 4),
        "bvh_bytes": own.bytes,
        "budget": request.budget or None,
        "beyond": request.beyond,
        "trees": {
            name: {"build_s": round(tree.build_seconds, 4), "bvh_bytes": tree.bytes} for name, tree in trees.items()
        },
        "results": results,
    }


def check_hits(tracers: list[MeasuredTracer], rays: CapturedRays, judge: Judge) -> dict[str, Verdict]:
    """Trace `rays` with each tracer; where one disagrees with the first of them, both answers are judged."""
    found = {}
    for tracer in tracers:
        tracer.load(rays, 1)
        tracer.trace()
        found[tracer.name] = tracer.hits()
    first = tracers[0].name
    verdicts = {tracer.name: judge.compare(rays, found[tracer.name], found[first]) for tracer in tracers}
    for tracer in tracers[1:]:
        # the report of the first states where any other differs from it
        against = judge.compare(rays, found[first], found[tracer.name])
        verdicts[first] = max(verdicts[first], against, key=lambda verdict: (verdict.faults, verdict.disagreements))
    return verdicts


def timed_in_turns(
    tracers: list[MeasuredTracer], rays: CapturedRays, threads: int, runs: int
) -> dict[str, list[Timing]]:
    """`runs` timings of each tracer; they take turns, so that what disturbs the machine meets all of them."""
    timings: dict[str, list[Timing]] = {tracer.name: [] for tracer in tracers}
    for tracer in tracers:
        tracer.load(rays, threads)
    for run in range(WARM_UPS + runs):
        for tracer in tracers:
            timing = tracer.trace()
            if run >= WARM_UPS:
                timings[tracer.name].append(timing)
    return timings


def figures(timings: list[Timing], ray_count: int) -> dict[str, Any]:
    """What is reported for several runs over the same rays."""
    seconds = [timing.seconds for timing in timings]
    traced = [timing.seconds - timing.sort_seconds for timing in timings]
    return {
        "ray_count": ray_count,
        "mrays_per_s": round(ray_count / statistics.median(seconds) / 1e6, 6),
        "spread": round(spread(seconds), 3),
        "runs": len(timings),
        "mrays_per_s_without_sort": round(ray_count / statistics.median(traced) / 1e6, 6),
        "sort_s": round(statistics.median(timing.sort_seconds for timing in timings), 6),
    }


def described(verdict: Verdict) -> dict[str, int]:
    """A verdict as it stands in the report."""
    return {"disagreements": verdict.disagreements, "judged": verdict.judged, "faults": verdict.faults}
