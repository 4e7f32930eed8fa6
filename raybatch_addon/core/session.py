"""The door to the core: `Session.render` turns a `Scene` into a `Film`."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp

from .ahead.aside import WaitedParts, begin_aside, end_of, is_awaited, once_free
from .ahead.change import TierChange, TierChanges
from .ahead.prepare import Preparation
from .ahead.request import CompileRequest, kernels_ahead
from .bvh.build.scene_tree import layout_for
from .bvh.memory import GeometrySize
from .checkpoint.checkpoint import Checkpoint
from .device.compiler import CompileStoppedError
from .device.devices import find_device, free_memory, load_kernels, start_warp, warp_cache_folder
from .device.failures import names_failures
from .displacement.displaced import is_displaced
from .film import Film
from .film.tile import FinishedTile, add_integers_kernel
from .job import Job, progress_of
from .measure.hardware import hardware_counters
from .measure.parts import Parts
from .observers import Progress, RenderObserver, Tile, call_all
from .programs.requests import prepared_scene
from .scene.description import Scene
from .scene.features import SceneFeatures, derive_features
from .scene.validate import checked_scene
from .settings.settings import RenderSettings
from .wavefront.adaptive.ranges import check_after, chosen_looks, pixels_can_end
from .wavefront.estimates.displacement import mover
from .wavefront.integrator import TileIntegrator
from .wavefront.plan.plan import Choice, Memory, plan_tracing
from .wavefront.render.rendering import RenderEvents, Rendering, snapshot_watchers
from .wavefront.render.resume import ResumeState, check_samples, film_to_fill
from .wavefront.render.workers import WorkersFor
from .wavefront.scene.device_scene import DeviceScene
from .wavefront.scene.geometry_request import GeometryRequest
from .wavefront.scene.kept_scene import KeptScene, asked_of
from .wavefront.scene.scene_cache import SceneCache
from .wavefront.tier import choose_tier


class Session:
    """A device with its caches. One render at a time; make one session a device and keep it."""

    def __init__(
        self,
        device: str | None = None,
        settings: RenderSettings | None = None,
        cache_folder: str | Path | None = None,
        page_folder: str | Path | None = None,
        compile_between_renders: bool = False,
    ):
        """Open `device` (AUTO, cpu or cuda:N; default: that of `settings`); raises `DeviceError`.

        Compiled kernels are cached in `cache_folder` (default: Warp's own folder in the user's cache), and geometry
        beyond memory in `page_folder` (default: a folder beside them), where the setting `geometry_store` is DISK.
        With `compile_between_renders`, for sessions whose process stays, kernels specialised on a scene that general
        ones rendered are compiled once the render is over, in a process of low priority.
        """
        self.settings = settings or RenderSettings()
        start_warp(cache_folder)
        self._page_folder = Path(page_folder) if page_folder else warp_cache_folder() / "pages"
        self.device = find_device(device or self.settings.device)
        self.layout = layout_for(self.device)  # of trees
        self._kept = KeptScene()
        self._cache = SceneCache(lambda: self._kept.device_bytes)
        self._tier_changes = TierChanges(self.device, compile_between_renders)
        self._building: Future | None = None  # the end of the last build

    def close(self) -> None:
        """Give back what is cached, and end what still compiles; a session that renders again begins anew."""
        self._tier_changes.close()
        if self._building:
            wait([self._building])  # what a cancelled render left behind reads and fills the caches
        self._kept.clear()
        self._cache.clear()

    def prewarm(
        self, features: Sequence[SceneFeatures] | None = None, on_progress: Callable[[int, int], None] | None = None
    ) -> list[str]:
        """Compile ahead for `features`; returns the modules' names.

        Default: what any scene can begin with: the general kernels, trees, and tracing, as `GeneralRequest` has it.
        """
        kernels = kernels_ahead(features, self.settings, self.device)
        return load_kernels(kernels, self.device, on_progress or (lambda *_: None))

    @names_failures
    def render(
        self,
        scene: Scene,
        settings: RenderSettings | None = None,
        *,
        on_tile: Callable[[Tile], None] | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
        observers: Sequence[RenderObserver] = (),
        sample_first: int = 0,
        resume: Film | None = None,
        after: Film | None = None,
        parts: Parts | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> Film:
        """Render `scene` and return its film.

        Args:
            scene: what to render.
            settings: default: the session's.
            on_tile, on_progress: called on this thread with each finished `Tile`, and several times a second with
                `Progress`.
            cancelled: asked several times a second, on this thread; True ends the render soon, with what is done.
            observers: receive tiles and progress too, and a `Snapshot` at each sample count that they ask for and the
                render comes by, and at its end.
            sample_first: index of the first sample of every pixel; films of adjoining ranges merge to one
                (`Film.merge`).
            resume: the film of a cancelled render of the same scene and settings: goes on from there.
            after: with adaptive sampling and a `sample_first` above 0, the finished film of all samples up to the last
                look at the noise before it: by that some pixels have ended their sampling.
            parts: the clock of a render that began before this call, and may go on after it; default: one of this call.
            checkpoint: goes on from what is in its file, unless there is `resume`; shows it, and keeps it there.

        Raises:
            RayBatchError: what the user can mend; the message says how.
        """
        check_after(settings or self.settings, sample_first, resume, after)
        self._tier_changes.open()
        self._kept.begin(scene)
        job = self._job(
            scene,
            settings or self.settings,
            parts or Parts("check"),
            sample_first,
            on_tile=call_all(on_tile, [observer.on_tile for observer in observers]),
            on_progress=call_all(on_progress, [observer.on_progress for observer in observers]),
            cancelled=cancelled or (lambda: False),
            observers=observers,
        )
        job.checkpoint = checkpoint
        if checkpoint:
            job.parts.enter("checkpoint")
            found = checkpoint.begin(scene, job.settings, self.device, sample_first)
            resume = resume or found
        film = film_to_fill(job.scene.frame, job.settings, job.sample_first, resume, self.device)
        if checkpoint:
            job.show(film)
        state = job.begin(film, after, self.device)
        if job.settings.kernel_tier == "AUTO":
            job.chosen["kernel_tier"] = Choice("GENERAL" if job.tier.general else "SPECIALISED", job.tier.why)
        device_scene, modules = self._prepare(job)
        integrators: list[TileIntegrator] = []
        if device_scene is not None:
            job.warnings += device_scene.images.warnings
            job.warnings += device_scene.volumes.warnings if device_scene.volumes else []
            if device_scene.paged and "page_file_warning" in device_scene.paged.statistics:
                job.warnings.append(device_scene.paged.statistics["page_file_warning"])
            job.parts.enter("paths")
            workers = WorkersFor(self._kept, device_scene, job.scene.frame, job.settings)
            integrators = self._workers(job, workers, state)
            counting = device_scene.tracing.counters(job.settings, job.features.passes)
            if counting:
                job.warnings += counting.warnings()
            if any(each.is_counting for each in integrators):
                with hardware_counters(self.device.is_cuda) as counters:
                    self._run(job, integrators, state, film)
                job.hardware = counters.report()
            else:
                self._run(job, integrators, state, film)
            if state.policy.stopped_by is not None and state.drained:
                workers.keep()
        if checkpoint:
            job.parts.enter("checkpoint")
            checkpoint.end(state)
            job.warnings += checkpoint.warnings
        job.parts.enter("report")
        state.release()
        film.complete = state.policy.stopped_by is not None
        if not film.complete and state.drained:
            film.resume_state = state
        film.statistics = job.statistics(film, state, integrators, modules, device_scene, self.device)
        job.rendering = None  # it leads back to the job: the film would stay until somebody looks for cycles
        return film

    # --- before

    def _job(
        self,
        scene: Scene,
        settings: RenderSettings,
        parts: Parts,
        sample_first: int,
        *,
        on_tile: Callable[[Tile], None],
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
        observers: Sequence[RenderObserver],
    ) -> Job:
        parts.enter("check")
        whole = scene if self._kept.is_sound else checked_scene(scene)
        self._kept.is_sound = self._kept.is_known and whole is scene
        displaced = self._displaced(whole, settings, parts, on_progress, cancelled)
        parts.enter("check")
        was_cancelled = displaced is None
        checked = prepared_scene(whole if displaced is None else displaced, settings)
        check_samples(settings, sample_first)
        derived = self._kept.derived if not was_cancelled else lambda _name, _settings, make: make()
        size = derived("size", settings, lambda: GeometrySize.of(checked))
        free = self._cache.free_for_geometry(checked.images, self.device)
        memory = Memory(size.needed(self.layout, self.device), free, free_memory(wp.get_device("cpu")))
        samples = settings.sample_count * checked.frame.pixel_count
        features = derived("features", settings, lambda: derive_features(checked, settings))
        features = replace(features, adaptive=pixels_can_end(settings, sample_first))
        plan = plan_tracing(settings, size, self.layout, self.device.is_cuda, memory, samples, features.moving)
        warnings = [*checked.warnings, *plan.complaints]
        tier = choose_tier(features, settings.kernel_tier, self.device)
        if tier.complaint:
            warnings.append(f"kernels are specialised on the scene, not GENERAL: {tier.complaint}")
        return Job(
            scene=checked,
            settings=settings,
            features=features,
            tier=tier,
            plan=plan,
            sample_first=sample_first,
            on_tile=on_tile,
            on_progress=on_progress,
            cancelled=lambda: was_cancelled or cancelled(),
            watchers=snapshot_watchers(observers, settings.sample_count),
            parts=parts,
            warnings=warnings,
            chosen=chosen_looks(settings),
        )

    def _displaced(
        self,
        scene: Scene,
        settings: RenderSettings,
        parts: Parts,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Scene | None:
        """`scene` with its vertices where its materials move them; None when cancelled meanwhile."""
        move = functools.partial(self._cache.displaced, scene, self.device, mover(settings.kernel_tier))
        if not is_displaced(scene):
            return move()
        before, closed, waited = self._building, self._tier_changes.is_closed, WaitedParts(parts)

        def displace() -> Scene:
            waited.enter("displacement")
            return move()

        done = begin_aside(lambda: once_free(before, displace, closed, waited))
        self._building = end_of(done)
        try:
            ended = is_awaited(done, cancelled, lambda: on_progress(progress_of(parts, settings, self.device, "build")))
            return done.result() if ended else None
        except CompileStoppedError:  # the session was closed
            return None
        finally:
            waited.give_up()
            if done.done():
                self._building = None

    def _prepare(self, job: Job) -> tuple[DeviceScene | None, list[str]]:
        """The scene on the device, and the names of the modules of kernels; nothing when cancelled meanwhile."""
        kernels = job.request.kernels(self.device) + [add_integers_kernel] * (job.settings.half_count - 1)
        preparation = Preparation(kernels, self.device, self._building, self._tier_changes.is_closed, job.parts)
        request = GeometryRequest(
            settings=job.settings,
            plan=job.plan,
            layout=self.layout,
            instancing=job.features.instancing,
            page_folder=self._page_folder,
            cancelled=preparation.is_given_up,
        )

        asked = asked_of(job.settings, job.features, job.tier.shading, request)

        def build() -> DeviceScene:
            return DeviceScene.build(
                job.scene, job.features, request, self.device, self._cache, job.tier.shading, preparation.enter
            )

        def on_progress(stage: str, fraction: float, message: str) -> None:
            reported = progress_of(job.parts, job.settings, self.device, stage, fraction=fraction, message=message)
            job.on_progress(reported)

        try:
            return preparation.run(build, job.cancelled, on_progress, self._kept, asked)
        finally:
            job.warnings += preparation.warnings
            self._building = preparation.build

    def _workers(self, job: Job, workers: WorkersFor, state: ResumeState) -> list[TileIntegrator]:
        last = state.end == state.policy.sample_count
        areas = [halves[0].tile.pixel_count for halves in (state.open_tiles if last else state.tiles)]
        # samples of a pixel in one half: halves are rendered one after the other
        samples = -(-state.policy.sample_count // job.settings.half_count)
        made = workers.get(areas, samples)
        job.warnings += made.warnings
        job.chosen.update(made.chosen)
        job.path_bytes = made.path_bytes
        return made.integrators

    # --- the render itself

    def _run(self, job: Job, integrators: list[TileIntegrator], state: ResumeState, film: Film) -> None:
        """Let the integrators render what is left of `state`; callbacks are called on this thread."""
        seconds_left: float | None = None

        def on_tile(tile: FinishedTile, passes: dict[str, np.ndarray]) -> None:
            job.on_tile(Tile(tile.x, tile.y, tile.width, tile.height, passes))

        def on_progress(fraction: float, samples: float, seconds: float) -> None:
            nonlocal seconds_left
            if job.change:
                job.change.go_on()
            seconds_left = seconds / fraction - seconds if fraction > 0.001 else None
            rays = sum(i.rays.total for i in integrators)
            progress = progress_of(
                job.parts,
                job.settings,
                self.device,
                "render",
                fraction=fraction,
                kernels=job.kernels_now,
                compiles=job.change is not None and job.change.is_compiling,
                samples_done=samples,
                rays_per_second=rays / seconds if seconds else 0.0,
                seconds_left=seconds_left,
                seconds_rendering=seconds,
            )
            job.on_progress(progress)

        job.parts.enter("render")
        events = RenderEvents(
            on_tile=on_tile,
            on_progress=on_progress,
            cancelled=job.cancelled,
            watchers=job.watchers,
            keeper=job.checkpoint,
        )
        job.rendering = Rendering(integrators, state, film, events, job.parts.started, job.steps)
        change = None
        if job.tier.general and job.tier.asked == "AUTO":
            request = CompileRequest(job.features, job.settings, job.plan)
            change = job.change = TierChange(
                self._tier_changes, request, integrators, lambda: seconds_left, self.device
            )
        try:
            job.rendering.run()
        finally:
            if change:
                change.close()
            if job.checkpoint:
                job.checkpoint.wait()
        if change:
            job.chosen["kernel_tier"] = Choice("GENERAL", job.kernels["why"])
        if change and (complaint := self._tier_changes.complaint(change.request)):
            job.warnings.append(f"specialised kernels could not be compiled, general ones rendered: {complaint}")
