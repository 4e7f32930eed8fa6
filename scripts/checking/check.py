"""All checks of one scene, chunk by chunk."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from benchmarking.judge import faults
from benchmarking.progress import Steps
from benchmarking.scenes import BenchmarkScene, SceneRequest, load_benchmark_scene

from checking.comparing import (
    disagree_kernel,
    hits_beside,
    limits_kernel,
    ray_record,
    unequal_any_kernel,
    unequal_kernel,
    where_found,
)
from checking.judging import BlockJudge, false_hits_kernel
from checking.leaks import check_leaks
from checking.placing import with_instances
from checking.rays import KINDS, PATTERN, kinds_of, make_rays_kernel, make_source
from checking.trees import (
    TREES_DEFAULT,
    TreeTracer,
    build_tracer,
    parse_trees,
    reference_tracer,
    slot_lists,
    thread_count_of,
    whole_tracer,
)
from raybatch_addon.core.device.devices import device_description, find_device
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import allocate_rays

CHUNK = {"cpu": 1 << 20, "cuda": 1 << 22}  # rays at a time
WHOLE_TESTS = {"cpu": 10**10, "cuda": 4 * 10**11}  # triangles that are tested for rays that leave out none
AUDITED = 1 << 11  # rays of a chunk that are judged although tracers agree
EXAMPLES = 4  # rays that are reported for each check that fails


@dataclass(frozen=True)
class CheckRequest:
    """One call of check_tracing.py."""

    scene: Path
    device: str = "AUTO"
    ray_count: int = 10_000_000
    leak_rays: int = 100_000_000
    seed: int = 1
    trees: str | None = None
    instances: int = 0


@dataclass
class Check:
    """One thing that must hold for every ray."""

    rays: int = 0
    failures: int = 0
    examples: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class KindFigures:
    """Findings for one kind of rays."""

    rays: int = 0
    hits: int = 0
    disagreements: int = 0
    own_faults: int = 0
    reference_faults: int = 0


class SceneCheck:
    """Traces rays with every tree, and keeps count of what is wrong."""

    def __init__(self, scene: BenchmarkScene, device: wp.Device, names: list[str], seed: int, steps: Steps):
        self.device, self.steps = device, steps
        self.threads = thread_count_of(device)
        self.generator = np.random.default_rng(seed)
        self.checks: dict[str, Check] = {}
        self.kinds = {name: KindFigures() for name in KINDS}
        self.judge = BlockJudge(scene, device)
        self.source = make_source(self.judge.positions, self.judge.triangles, seed, device)
        self.pattern = wp.array(PATTERN, dtype=int, device=device)
        self.geometry = upload_geometry(scene.flat, scene.scene, device)
        self.trees: list[TreeTracer] = []
        for name in names:
            steps.begin(f"building the tree {name}")
            self.trees.append(build_tracer(name, scene, self.geometry, device, seed))
            steps.end()
        self.main = self.trees[0]
        self.whole = whole_tracer(self.main, scene, device)
        self.reference = reference_tracer(scene, device)
        for tracer in (*self.trees, self.whole, self.reference):
            tracer.load(device, self.threads + 1)

    def check_chunk(self, first: int, count: int, whole: int) -> None:
        """Rays `first` to `first + count` of the run; the first `whole` of them also with every triangle."""
        rays = allocate_rays(count, self.device)
        wp.launch(make_rays_kernel, count, [self.source, self.pattern, first, rays], device=self.device)
        lists = slot_lists(count, self.threads, self.device)
        self.main.trace(rays, lists)
        other = hits_beside(rays)

        def compare(name: str, tracer: TreeTracer, lists: list, any_hit: bool = False, part: int = count) -> None:
            tracer.trace(other, lists, any_hit)
            kernel = unequal_any_kernel if any_hit else unequal_kernel
            self.count(name, where_found(kernel, [rays, other], part, self.device), rays, first, part)

        mixed = slot_lists(count, self.threads + 1, self.device, self.generator.permutation(count))
        compare("rays in another order", self.main, mixed)
        for tracer in self.trees:
            if tracer is not self.main:
                compare(f"tree {tracer.name}", tracer, lists)
            compare(f"any hit, tree {tracer.name}", tracer, lists, any_hit=True)
        if whole:
            compare("every triangle tested", self.whole, slot_lists(whole, self.threads, self.device), part=whole)
        self._check_limits(rays, lists, first)
        wrong = where_found(false_hits_kernel, [self.geometry, rays, self.judge.bound], count, self.device)
        self.count("hits lie on their triangles", wrong, rays, first, count)
        self._judge(rays, other, lists, first)

    def _check_limits(self, rays: Rays, lists: list, first: int) -> None:
        """A ray that ends at its hit meets nothing; one that ends right behind meets the same."""
        limited = hits_beside(rays)
        count = rays.t_max.shape[0]
        limited.t_max = wp.empty(count, dtype=float, device=self.device)
        wp.launch(limits_kernel, count, [rays, 1, limited.t_max], device=self.device)
        self.main.trace(limited, lists)
        self.count(
            "rays that end behind their hits",
            where_found(unequal_kernel, [rays, limited], count, self.device),
            rays,
            first,
            count,
        )
        wp.launch(limits_kernel, count, [rays, 0, limited.t_max], device=self.device)
        for name, any_hit in (("closest", False), ("any hit", True)):
            self.main.trace(limited, lists, any_hit)
            met = np.flatnonzero((limited.hit_instance.numpy() >= 0) & (rays.hit_instance.numpy() >= 0))
            self.count(f"rays that end at their hits, {name}", met, rays, first, count)

    def _judge(self, rays: Rays, other: Rays, lists: list, first: int) -> None:
        """Ask float64 where the reference disagrees, and for some rays where it does not."""
        count = rays.t_max.shape[0]
        self.reference.trace(other, lists)
        inputs = [rays, other, self.source.centre, self.source.extent]
        differ = where_found(disagree_kernel, inputs, count, self.device)
        audited = self.generator.choice(count, min(AUDITED, count), replace=False)
        slots = np.union1d(differ, audited)
        before, after = self.judge.certainties(rays, slots)

        def wrong(found: Rays) -> np.ndarray:
            return slots[
                faults(
                    found.hit_instance.numpy()[slots] >= 0, found.hit_t.numpy()[slots].astype(np.float64), before, after
                )
            ]

        own, theirs = wrong(rays), wrong(other)
        self.count("judged in float64", own, rays, first, len(slots))
        kinds, hit = kinds_of(first, count), rays.hit_instance.numpy() >= 0
        for number, figures in enumerate(self.kinds.values()):
            figures.rays += int((kinds == number).sum())
            figures.hits += int(hit[kinds == number].sum())
            for name, slots_found in (("disagreements", differ), ("own_faults", own), ("reference_faults", theirs)):
                setattr(figures, name, getattr(figures, name) + int((kinds[slots_found] == number).sum()))

    def count(self, name: str, failed: np.ndarray, rays: Rays, first: int, checked: int) -> None:
        """The slots `failed` of `checked` fail the check `name`."""
        check = self.checks.setdefault(name, Check())
        check.rays += checked
        check.failures += len(failed)
        for slot in failed[: max(0, EXAMPLES - len(check.examples))].tolist():
            check.examples.append(
                {"number": first + slot, "kind": KINDS[kinds_of(first + slot, 1)[0]], **ray_record(rays, slot)}
            )


def check_tracing(request: CheckRequest) -> dict[str, Any]:
    """The report of check_tracing.py; raises `RayBatchError`."""
    device = find_device(request.device)
    kind = "cuda" if device.is_cuda else "cpu"
    names = parse_trees(request.trees or TREES_DEFAULT[kind])
    scene = load_benchmark_scene(SceneRequest(request.scene), 1)
    if request.instances:
        scene = with_instances(scene, request.instances, request.seed)
    chunk = CHUNK[kind]
    starts = range(0, request.ray_count, chunk)
    began = time.perf_counter()
    steps = Steps(len(names) + len(starts) + (request.leak_rays > 0))
    try:
        check = SceneCheck(scene, device, names, request.seed, steps)
        whole = min(request.ray_count, WHOLE_TESTS[kind] // max(1, scene.triangle_count))
        for first in starts:
            steps.begin(f"rays {first:,} to {min(first + chunk, request.ray_count):,} of {request.ray_count:,}")
            check.check_chunk(first, min(chunk, request.ray_count - first), -(-whole // len(starts)))
            steps.end()
        leaks = None
        if request.leak_rays:
            steps.begin(f"{request.leak_rays:,} rays from inside a closed mesh")
            leaks = check_leaks(scene, check.trees, check.reference, request.leak_rays, chunk, request.seed, device)
            steps.end()
    finally:
        steps.close()
    failures = sum(each.failures for each in check.checks.values()) + (leaks["escapes"] if leaks else 0)
    return {
        "device": device_description(device),
        "versions": versions(),
        "scene": scene.name,
        "triangles": scene.triangle_count,
        "instances": len(scene.flat.shared),
        "seed": request.seed,
        "trees": names,
        "rays": request.ray_count,
        "seconds": round(time.perf_counter() - began, 3),
        "kinds": {name: dataclasses.asdict(figures) for name, figures in check.kinds.items()},
        "checks": {name: dataclasses.asdict(each) for name, each in check.checks.items()},
        "leaks": leaks,
        "reference_faults": sum(figures.reference_faults for figures in check.kinds.values()),
        "own_faults": failures,
    }
