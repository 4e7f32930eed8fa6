"""A device of a session: what it keeps from render to render, and how it gets ready for one."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path

import warp as wp

from .ahead.aside import WaitedParts, begin_aside, end_of, is_awaited, once_free
from .ahead.change import TierChanges
from .ahead.prepare import Preparation
from .bvh.build.in_common import TreesInCommon
from .bvh.build.scene_tree import layout_for
from .bvh.memory import GeometrySize
from .bvh.pages.peers.access import let_read, why_apart
from .bvh.pages.peers.shared import PeerPages, SharedPages
from .device.compiler import CompileStoppedError
from .device.devices import free_memory
from .device.failures import named_failures
from .displacement.displaced import is_displaced
from .film.tile import add_integers_kernel
from .job import Job, progress_of
from .measure.parts import Parts
from .observers import Progress
from .scene.description import Scene
from .scene.features import SceneFeatures
from .settings.settings import RenderSettings
from .wavefront.estimates.displacement import mover
from .wavefront.integrator import TileIntegrator
from .wavefront.plan.plan import Memory, Method, TracingPlan, plan_tracing
from .wavefront.render.resume import ResumeState
from .wavefront.render.workers import WorkersFor
from .wavefront.scene.device_scene import DeviceScene
from .wavefront.scene.geometry_request import GeometryInCommon, GeometryRequest
from .wavefront.scene.kept_scene import KeptScene, asked_of
from .wavefront.scene.scene_cache import SceneCache


class SessionDevice:
    """A device of a session, with its caches."""

    def __init__(self, device: wp.Device, compile_between_renders: bool = False):
        """`compile_between_renders`: see `Session`."""
        self.device = device
        self.layout = layout_for(device)  # of trees
        self.kept = KeptScene()
        self.tier_changes = TierChanges(device, compile_between_renders)
        self.cache = SceneCache(lambda: self.kept.device_bytes)
        self._building: Future | None = None  # the end of the last build

    def close(self) -> None:
        """Give back what is cached, and end what still compiles."""
        self.tier_changes.close()
        if self._building:
            wait([self._building])  # what a cancelled render left behind reads and fills the caches
        self.kept.clear()
        self.cache.clear()

    def plan(
        self,
        scene: Scene,
        settings: RenderSettings,
        size: GeometrySize,
        features: SceneFeatures,
        sharing: Sequence[wp.Device] = (),
    ) -> TracingPlan:
        """How rays of `scene`, whose geometry is of this `size`, are traced here, while `sharing` render it."""
        free = self.cache.free_for_geometry(scene.images, self.device, settings.texture_budget)
        apart = why_apart(sharing)
        memory = Memory(
            size.needed(self.layout, self.device),
            free,
            free_memory(wp.get_device("cpu")),
            beside=size.beside_budget(self.device),
            peers=1 if apart else len(sharing),
            apart=apart,
        )
        samples = settings.sample_count * scene.frame.pixel_count
        return plan_tracing(settings, size, self.layout, self.device.is_cuda, memory, samples, features.moving)

    def image_budget(self, settings: RenderSettings) -> int | None:
        """What images may take of the device's memory [bytes]; None: they lie where they are."""
        return settings.texture_budget or self.cache.image_budget(self.device)

    def displaced(
        self,
        scene: Scene,
        settings: RenderSettings,
        parts: Parts,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Scene | None:
        """`scene` with its vertices where its materials move them; None when cancelled meanwhile."""
        mover_of = mover(settings.kernel_tier)
        move = functools.partial(self.cache.displaced, scene, self.device, mover_of, settings.texture_budget)
        if not is_displaced(scene):
            return move()
        before, closed, waited = self._building, self.tier_changes.is_closed, WaitedParts(parts)

        def displace() -> Scene:
            waited.enter("displacement")
            return move()

        done = begin_aside(lambda: once_free(before, displace, closed, waited))
        self._building = end_of(done)
        try:
            ended = is_awaited(
                done, cancelled, lambda: on_progress(progress_of(parts, settings, [self.device], "build"))
            )
            return done.result() if ended else None
        except CompileStoppedError:  # the session was closed
            return None
        finally:
            waited.give_up()
            if done.done():
                self._building = None

    def prepare(self, job: Job, page_folder: Path, common: GeometryInCommon) -> tuple[DeviceScene | None, list[str]]:
        """The scene on the device, and the names of the modules of kernels; nothing when cancelled meanwhile."""
        kernels = job.request.kernels(self.device) + [add_integers_kernel] * (job.settings.half_count - 1)
        preparation = Preparation(kernels, self.device, self._building, self.tier_changes.is_closed, job.parts)
        request = GeometryRequest(
            settings=job.settings,
            plan=job.plan,
            layout=self.layout,
            instancing=job.features.instancing,
            page_folder=page_folder,
            common=common,
            cancelled=preparation.is_given_up,
        )
        asked = asked_of(job.settings, job.features, job.tier.shading, request)
        build = functools.partial(
            DeviceScene.build,
            job.scene,
            job.features,
            request,
            self.device,
            self.cache,
            job.tier.shading,
            preparation.enter,
        )

        def on_progress(stage: str, fraction: float, message: str) -> None:
            reported = progress_of(job.parts, job.settings, [self.device], stage, fraction=fraction, message=message)
            job.on_progress(reported)

        try:
            return preparation.run(build, job.cancelled, on_progress, self.kept, asked)
        finally:
            job.warnings += preparation.warnings
            self._building = preparation.build


def least_image_budget(devices: Sequence[SessionDevice], settings: RenderSettings) -> int | None:
    """What images may take of the memory of each of `devices` [bytes]; None: there is no limit."""
    budgets = [each.image_budget(settings) for each in devices]
    return min((each for each in budgets if each is not None), default=None)


def geometry_in_common(
    jobs: Sequence[Job], devices: Sequence[wp.Device], shared: SharedPages
) -> list[GeometryInCommon]:
    """What each of `devices` has of trees that one of them builds, and of pages that they hold for each other. The jobs
    are changed as for `_pages_in_common`.
    """
    trees = TreesInCommon(devices) if len(devices) > 1 else None
    return [GeometryInCommon(trees, pages) for pages in _pages_in_common(jobs, devices, shared)]


def _pages_in_common(jobs: Sequence[Job], devices: Sequence[wp.Device], shared: SharedPages) -> list[PeerPages | None]:
    """The part of each of `devices` where they hold pages for each other, as the first one's job has it: then all have
    the same plan, with the least budget. The jobs are changed; None for each device where pages lie elsewhere.
    """
    first = jobs[0].plan
    refusal = let_read(devices) if first.geometry_store == "PEERS" else ""
    if first.geometry_store == "PEERS" and not refusal:
        budget = min(each.plan.geometry_budget for each in jobs if each.plan.method is Method.PAGED)
        choices = dict(first.choices)
        if "geometry_budget" in choices:
            choices["geometry_budget"] = replace(choices["geometry_budget"], value=budget)
        for job in jobs:
            job.plan = replace(first, geometry_budget=budget, choices=choices)
        return list(PeerPages.of(shared, devices))
    if refusal:
        jobs[0].warnings.append(f"geometry_store is HOST, not PEERS: {refusal}")
    for job in jobs:
        if job.plan.geometry_store == "PEERS":
            job.plan = replace(job.plan, geometry_store="HOST")
    return [None] * len(jobs)


def make_workers_of(places: Sequence[Place], state: ResumeState) -> None:
    """Workers of all places for the tiles of `state`, side by side; where rays wait, one place after the other, since
    what is captured is given up on the thread that made it. Failures name the device.
    """

    def make(place: Place) -> None:
        with named_failures(place.at.device):
            place.make_workers(state)

    if len(places) == 1 or any(place.scene.tracing.waits for place in places):
        for place in places:
            make(place)
        return
    with ThreadPoolExecutor(len(places), thread_name_prefix="RayBatch device") as pool:
        list(pool.map(make, places))


@dataclass
class Place:
    """A device in a render."""

    at: SessionDevice
    job: Job  # as it is there
    scene: DeviceScene
    modules: list[str]  # names of those of its kernels
    workers: WorkersFor | None = None

    @property
    def integrators(self) -> list[TileIntegrator]:
        """The workers there."""
        return self.workers.integrators if self.workers else []

    def make_workers(self, state: ResumeState) -> None:
        """Make them for the tiles of `state`."""
        job, self.workers = self.job, WorkersFor(self.at.kept, self.scene, self.job.scene.frame, self.job.settings)
        last = state.end == state.policy.sample_count
        areas = [halves[0].tile.pixel_count for halves in (state.open_tiles if last else state.tiles)]
        # samples of a pixel in one half: halves are rendered one after the other
        samples = -(-state.policy.sample_count // job.settings.half_count)
        made = self.workers.get(areas, samples)
        job.warnings += made.warnings
        job.chosen.update(made.chosen)
        job.path_bytes = made.path_bytes

    def keep_workers(self) -> None:
        """All that was asked of them is done."""
        if self.workers:
            self.workers.keep()
