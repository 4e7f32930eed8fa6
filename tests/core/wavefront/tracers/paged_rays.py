"""Rays in a scene in pages, tracers that stream its pages, and the hits in the whole tree."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.rays import RayKind, RayList, Rays
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.pages.tracer import StreamingTracer
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays
from tests.support import paged_scenes
from tests.support.under_test import DEVICE

PATHS = 3000
LAYOUTS = list(Layout) if DEVICE == "cpu" else [Layout.QUANTISED]
ONE = LAYOUTS[0]
ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
CHECKED = RenderSettings(debug_checks="ON")
BUDGET = 250_000


# with hair, and with things that move too
LIVELY = {"hairy": paged_scenes.hairy, "living": paged_scenes.living}


@functools.cache
def scene(name: str = "everything"):
    made = LIVELY[name]() if name in LIVELY else paged_scenes.everything()
    return made, flatten(made)


def met(name: str) -> dict[str, bool]:
    """What tracers are to know of a scene."""
    return {"curves": name in LIVELY, "moving": name == "living"}


def device() -> wp.Device:
    return wp.get_device(DEVICE)


@functools.cache
def paged_of(
    layout: Layout,
    budget: int = BUDGET,
    nodes_resident: bool | None = False,
    many: bool = False,
    name: str = "everything",
    **more,
):
    """In memory; tests do not change it."""
    made, flat = scene(name)
    rule = CutRule(size=4, size_min=1) if many else CutRule()
    return build_paged_scene(
        flat, made.instances.visibility, layout, device(), budget, nodes_resident=nodes_resident, rule=rule, **more
    )


def new_rays(paths: int = PATHS, seed: int = 3, time: bool = False) -> Rays:
    """Extending rays, then as many shadow rays, which end somewhere; with `time` at times of their own."""
    rng = np.random.default_rng(seed)
    rays = allocate_rays(paths, device(), RayNeeds(shadow_rays=True, time=time))
    count = rays.origin.size
    origin = rng.normal(size=(count, 3)) * 4
    vertices = scene()[1].positions
    aim = np.where(
        np.arange(count)[:, None] % 2,
        vertices[rng.integers(0, len(vertices), count)],
        rng.normal(size=(count, 3)) * 1.5,
    )
    rays.origin.assign(origin.astype(np.float32))
    rays.direction.assign((aim - origin).astype(np.float32))
    shadow = np.arange(count) >= paths
    rays.t_max.assign(np.where(shadow, rng.uniform(0.3, 1.5, count), np.inf).astype(np.float32))
    rays.visibility.assign(rng.choice([1, 255], count).astype(np.int32))
    if time:
        rays.time.assign(rng.random(paths, np.float32))
    return rays


def list_of(slots) -> RayList:
    slots = np.asarray(slots, np.int32)
    return RayList(
        wp.array(slots, dtype=int, device=DEVICE), wp.array([len(slots)], dtype=int, device=DEVICE), len(slots)
    )


def hits_of(rays: Rays, paths: int, any_hit: bool) -> list[np.ndarray]:
    """What counts of them."""
    instance = rays.hit_instance.numpy().copy()
    hit = instance >= 0
    last = paths if any_hit else len(instance)
    if any_hit:
        instance[paths:] = hit[paths:]
    closest = hit[:last]
    return [
        instance,
        rays.hit_t.numpy()[:last][closest],
        rays.hit_primitive.numpy()[:last][closest],
        rays.hit_uv.numpy()[:last][closest],
    ]


@functools.cache
def expected(layout: Layout, any_hit: bool, seed: int = 3, name: str = "everything") -> list[np.ndarray]:
    """By the tree in memory, each ray at once."""
    made, flat = scene(name)
    geometry = upload_geometry(with_motion(flat), made, device())
    built = build_scene_tree(flat, geometry, made.instances.visibility, True, device(), layout)
    curves, moving = met(name).values()
    rays = new_rays(seed=seed, time=moving)
    for kind, slots in ((False, np.arange(PATHS)), (any_hit, np.arange(PATHS, 2 * PATHS))):
        options = TraceOptions(any_hit=kind, instancing=True, curves=curves, motion=moving)
        trace_stage(layout, options).launch(built.tree, rays, list_of(slots), None)
    return hits_of(rays, PATHS, any_hit)


def tracer_of(
    pool: Residency, rays: Rays, shadow=RayKind.OCCLUSION, settings=CHECKED, kind=StreamingTracer, counts=None, **more
):
    """A tracer of `rays` through a pool."""
    worker = WorkerRays(rays=rays, path_count=PATHS, shadow_kind=shadow, device=device(), counts=counts)
    return kind(pool.scene, pool, worker, settings, **more)


def streaming(open_pool, slots: int, layout: Layout = ONE, **more) -> tuple[Residency, Rays, StreamingTracer]:
    """A pool of so many pages, new rays, and their tracer."""
    pool, rays = open_pool(paged_of(layout), slots), new_rays()
    return pool, rays, tracer_of(pool, rays, **more)


def drain(tracer, finished: dict, most: int = 10_000) -> None:
    """Advance until no ray is under way; `finished` counts the times that each (kind, slot) came back."""
    for _ in range(most):
        tracer.advance()
        lists = tracer.take_finished()
        for kind, rays in lists:
            for slot in rays.slots.numpy()[: int(rays.count.numpy()[0])].tolist():
                finished[kind, slot] = finished.get((kind, slot), 0) + 1
            assert rays.bound >= int(rays.count.numpy()[0])
        if not lists:
            return
    raise AssertionError("rays stay under way")


def run(tracer, shadow: RayKind = RayKind.OCCLUSION, paths: int = PATHS) -> None:
    """All rays, submitted in two parts."""
    finished: dict = {}
    half = paths // 2
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(half)))
    tracer.submit(shadow, list_of(paths + np.arange(paths)))
    tracer.advance()
    for kind, rays in tracer.take_finished():
        for slot in rays.slots.numpy()[: int(rays.count.numpy()[0])].tolist():
            finished[kind, slot] = 1
    tracer.submit(RayKind.CLOSEST, list_of(half + np.arange(paths - half)))
    drain(tracer, finished)
    wanted = {(RayKind.CLOSEST, slot) for slot in range(paths)} | {(shadow, paths + slot) for slot in range(paths)}
    assert finished == dict.fromkeys(wanted, 1)


def require_right(
    rays: Rays, layout: Layout = ONE, any_hit: bool = True, seed: int = 3, name: str = "everything"
) -> None:
    """Hits are those of the tree in memory, bit for bit."""
    wanted = expected(layout, any_hit, seed, name)
    assert (wanted[0] >= 0).sum() > 500
    for a, b in zip(hits_of(rays, PATHS, any_hit), wanted):
        assert np.array_equal(a, b)
