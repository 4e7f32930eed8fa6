"""The door to the core: `Session.render` turns a `Scene` into a `Film`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp

from .ahead.aside import is_awaited
from .ahead.change import TierChange
from .ahead.request import CompileRequest, kernels_ahead
from .bvh.memory import GeometrySize
from .bvh.node import Layout
from .bvh.pages.peers.shared import SharedPages
from .checkpoint.checkpoint import Checkpoint
from .device.devices import find_devices, is_alike, load_kernels, start_warp, warp_cache_folder
from .device.failures import named_failures, names_failures
from .film import Film
from .film.tile import FinishedTile
from .job import Job, progress_of
from .measure.hardware import hardware_counters
from .measure.parts import Parts
from .observers import Cancel, Progress, RenderObserver, Tile, call_all
from .programs.requests import prepared_scene
from .scene.description import Scene
from .scene.features import SceneFeatures, derive_features
from .scene.validate import checked_scene
from .session_device import Place, SessionDevice, geometry_in_common, least_image_budget, make_workers_of
from .settings.settings import RenderSettings
from .wavefront.adaptive.active_pixels import ActivePixels
from .wavefront.adaptive.ranges import check_after, chosen_looks, pixels_can_end
from .wavefront.plan.plan import Choice
from .wavefront.plan.schedule import with_schedule
from .wavefront.render.events import RenderEvents, snapshot_watchers
from .wavefront.render.rendering import Rendering
from .wavefront.render.resume import ResumeState, check_samples, film_to_fill
from .wavefront.scene.geometry_request import GeometryInCommon
from .wavefront.scene.kept_scene import scene_key
from .wavefront.tier import choose_tier

# Fewer paths are not shared: one device has rendered them before the others are ready [paths]
SHARED_PATHS_LEAST = 1 << 24


class Session:
    """A device with its caches, or several that share each render. One render at a time; make one session a device and
    keep it.
    """

    def __init__(
        self,
        device: str | None = None,
        settings: RenderSettings | None = None,
        cache_folder: str | Path | None = None,
        page_folder: str | Path | None = None,
        compile_between_renders: bool = False,
    ):
        """Open `device` (AUTO, cpu, cuda:N, several of these with commas between, or ALL; default: that of `settings`);
        raises `DeviceError`.

        Compiled kernels are cached in `cache_folder` (default: Warp's own folder in the user's cache), and geometry
        beyond memory in `page_folder` (default: a folder beside them), where the setting `geometry_store` is DISK.
        With `compile_between_renders`, for sessions whose process stays, kernels specialised on a scene that general
        ones rendered are compiled once the render is over, in a process of low priority.
        """
        self.settings = settings or RenderSettings()
        start_warp(cache_folder)
        self._page_folder = Path(page_folder) if page_folder else warp_cache_folder() / "pages"
        self._shared_pages = SharedPages()
        self._at = [
            SessionDevice(each, compile_between_renders) for each in find_devices(device or self.settings.device)
        ]

    @property
    def devices(self) -> list[wp.Device]:
        """Those that render, as they were named."""
        return [each.device for each in self._at]

    @property
    def device(self) -> wp.Device:
        """The first of them, which does what is not shared."""
        return self._at[0].device

    @property
    def layout(self) -> Layout:
        """The layout of its trees."""
        return self._at[0].layout

    def close(self) -> None:
        """Give back what is cached, and end what still compiles; a session that renders again begins anew."""
        for each in self._at:
            each.close()

    def prewarm(
        self, features: Sequence[SceneFeatures] | None = None, on_progress: Callable[[int, int], None] | None = None
    ) -> list[str]:
        """Compile ahead for `features`; returns the modules' names.

        Default: what any scene can begin with: the general kernels, trees, and tracing, as `GeneralRequest` has it.
        """
        names: set[str] = set()
        for device in self.devices:
            kernels = kernels_ahead(features, self.settings, device)
            names.update(load_kernels(kernels, device, on_progress or (lambda *_: None)))
        return sorted(names)

    @names_failures
    def render(
        self,
        scene: Scene,
        settings: RenderSettings | None = None,
        *,
        on_tile: Callable[[Tile], None] | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        cancelled: Callable[[], bool | Cancel] | None = None,
        observers: Sequence[RenderObserver] = (),
        sample_first: int = 0,
        resume: Film | None = None,
        after: Film | ActivePixels | None = None,
        parts: Parts | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> Film:
        """Render `scene` and return its film.

        Args:
            scene: what to render.
            settings: default: the session's.
            on_tile, on_progress: called on this thread with each finished `Tile`, and now and then with `Progress`.
            cancelled: asked many times a second, on this thread; True ends the render soon, with what is done, and
                `Cancel.AT_ONCE` sooner: paths under way are missing from the film, and no render goes on from it.
            observers: receive tiles and progress too, and a `Snapshot` at each sample count that they ask for and the
                render comes by, and at its end.
            sample_first: index of the first sample of every pixel; films of adjoining ranges merge to one
                (`Film.merge`).
            resume: the film of a cancelled render of the same scene and settings: goes on from there.
            after: with adaptive sampling and a `sample_first` above 0, the finished film of all samples up to the last
                look at the noise before it: by that some pixels have ended their sampling. Or which ones did.
            parts: the clock of a render that began before this call, and may go on after it; default: one of this call.
            checkpoint: goes on from what is in its file, unless there is `resume`; shows it, and keeps it there.

        Raises:
            RayBatchError: what the user can mend; the message says how.
        """
        check_after(settings or self.settings, sample_first, resume, after)
        key = scene_key(scene)
        for each in self._at:
            each.tier_changes.open()
            each.kept.begin(key)
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
        sharing = self._sharing(job.path_total)
        devices = [each.device for each in sharing]
        state = job.begin(film, after, devices)
        if job.settings.kernel_tier == "AUTO":
            job.chosen["kernel_tier"] = Choice("GENERAL" if job.tier.general else "SPECIALISED", job.tier.why)
        places = self._prepare(job, sharing, devices)
        if places:
            self._render(job, places, state, film)
        if checkpoint:
            job.parts.enter("checkpoint")
            checkpoint.end(state)
            job.warnings += checkpoint.warnings
        job.parts.enter("report")
        state.release()
        film.complete = state.policy.stopped_by is not None
        if not film.complete and state.drained:
            film.resume_state = state
        modules = [module for place in places for module in place.modules]
        integrators = [each for place in places for each in place.integrators]
        there = places[0].scene if places else None
        film.statistics = job.statistics(film, state, integrators, modules, there, devices)
        job.rendering = None  # it leads back to the job: the film would stay until somebody looks for cycles
        return film

    def _sharing(self, path_total: int) -> list[SessionDevice]:
        """The devices that share a render of so many paths."""
        return self._at if path_total >= SHARED_PATHS_LEAST else self._at[:1]

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
        cancelled: Callable[[], bool | Cancel],
        observers: Sequence[RenderObserver],
    ) -> Job:
        parts.enter("check")
        first = self._at[0]
        whole = scene if first.kept.is_sound else checked_scene(scene)
        first.kept.is_sound = first.kept.is_known and whole is scene
        displaced = first.displaced(whole, settings, parts, on_progress, lambda: bool(cancelled()))
        parts.enter("check")
        check_samples(settings, sample_first)
        derived = first.kept.derived if displaced is not None else lambda _name, _settings, make: make()
        sharing = self._sharing(settings.sample_count * whole.frame.pixel_count)
        budget = derived("budget", settings, lambda: least_image_budget(sharing, settings))
        placed = whole if displaced is None else first.cache.boundaries.moved(displaced)
        checked = prepared_scene(placed, settings, budget)
        size = derived("size", settings, lambda: GeometrySize.of(checked))
        features = derived("features", settings, lambda: derive_features(checked, settings))
        features = replace(features, adaptive=pixels_can_end(settings, sample_first))
        plan = first.plan(checked, settings, size, features, [each.device for each in sharing])
        settings, why = with_schedule(settings, features, plan.method)
        warnings = [*checked.warnings, *plan.complaints, *why, *self._unlike()]
        tier = choose_tier(features, settings.kernel_tier, self.device)
        if tier.complaint:
            warnings.append(f"kernels are specialised on the scene, not general: {tier.complaint}")
        return Job(
            scene=checked,
            settings=settings,
            features=features,
            size=size,
            tier=tier,
            plan=plan,
            sample_first=sample_first,
            on_tile=on_tile,
            on_progress=on_progress,
            cancelled=lambda: displaced is None or cancelled(),
            watchers=snapshot_watchers(observers, settings.sample_count),
            parts=parts,
            warnings=warnings,
            chosen=chosen_looks(settings),
        )

    def _unlike(self) -> list[str]:
        """A warning where the devices are not of one model."""
        return [
            f"{self.device.alias} ({self.device.name}) and {other.alias} ({other.name}) are of unlike models: each "
            "renders what it comes to, so that the last bits of another render of this picture may differ"
            for other in [each for each in self.devices if not is_alike(each, self.device)][:1]
        ]

    def _prepare(self, job: Job, sharing: Sequence[SessionDevice], devices: Sequence[wp.Device]) -> list[Place]:
        """The scene on the devices that share the render, side by side; nothing when cancelled meanwhile."""
        stop, is_cancelled = threading.Event(), job.cancelled

        def cancelled() -> bool:
            if not stop.is_set() and is_cancelled():
                stop.set()
            return stop.is_set()

        def show() -> None:
            job.on_progress(progress_of(job.parts, job.settings, self.devices, "build"))

        def prepare(at: SessionDevice, its: Job, common: GeometryInCommon) -> Place | None:
            with named_failures(at.device):
                scene, modules = at.prepare(its, self._page_folder, common)
            return None if scene is None else Place(at, its, scene, modules)

        job.cancelled = cancelled
        first, *others = sharing
        jobs = [job, *(self._beside(job, each, devices, stop.is_set) for each in others)]
        common = geometry_in_common(jobs, devices, self._shared_pages)
        if not others:
            made = [prepare(first, job, common[0])]
        else:
            with ThreadPoolExecutor(max_workers=len(others), thread_name_prefix="RayBatch device") as pool:
                try:
                    waited = [pool.submit(prepare, *each) for each in zip(others, jobs[1:], common[1:], strict=True)]
                    made = [prepare(first, job, common[0])]
                    for each in waited:
                        is_awaited(each, cancelled, show)
                    made += [each.result() for each in waited]
                except BaseException:
                    stop.set()  # the pool waits for the others
                    raise
        job.cancelled = is_cancelled
        return [each for each in made if each] if all(made) else []

    def _beside(self, job: Job, at: SessionDevice, devices: Sequence[wp.Device], cancelled: Callable[[], bool]) -> Job:
        """What `job` is on another device than the first: with its own plan, and without a word to anybody."""
        return replace(
            job,
            tier=choose_tier(job.features, job.settings.kernel_tier, at.device),
            plan=at.plan(job.scene, job.settings, job.size, job.features, devices),
            on_tile=lambda tile: None,
            on_progress=lambda progress: None,
            cancelled=cancelled,
            watchers=[],
            parts=Parts("check"),
            warnings=[],
            checkpoint=None,
            chosen={},
        )

    # --- the render itself

    def _render(self, job: Job, places: list[Place], state: ResumeState, film: Film) -> None:
        """Let the workers of all places render what is left of `state`."""
        job.parts.enter("paths")
        make_workers_of(places, state)
        for place in places:
            found = place.scene.warnings + (place.job.warnings if place.job is not job else [])
            job.warnings += [each for each in found if each not in job.warnings]
        integrators = [each for place in places for each in place.integrators]
        if counting := places[0].scene.tracing.counters(job.settings, job.features.passes):
            job.warnings += counting.warnings()
        if any(each.is_counting for each in integrators):
            with hardware_counters(self.device.is_cuda) as counters:
                self._run(job, places, state, film)
            job.hardware = counters.report()
        else:
            self._run(job, places, state, film)
        if state.policy.stopped_by is not None and state.drained:
            for place in places:
                place.keep_workers()

    def _run(self, job: Job, places: list[Place], state: ResumeState, film: Film) -> None:
        """The same; callbacks are called on this thread."""
        integrators = [each for place in places for each in place.integrators]
        seconds_left: float | None = None

        def on_tile(tile: FinishedTile, passes: dict[str, np.ndarray]) -> None:
            job.on_tile(Tile(tile.x, tile.y, tile.width, tile.height, passes))

        def on_progress(fraction: float, samples: float, seconds: float) -> None:
            nonlocal seconds_left
            for change in changes:
                change.go_on()
            seconds_left = seconds / fraction - seconds if fraction > 0.001 else None
            rays = sum(i.rays.total for i in integrators)
            progress = progress_of(
                job.parts,
                job.settings,
                self.devices,
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
        parts = job.tile_parts([each.at.device for each in places])
        job.rendering = Rendering(integrators, state, film, events, job.parts.started, job.steps, parts=parts)
        changes = self._changes(job, places, lambda: seconds_left)
        try:
            job.rendering.run()
        finally:
            for change in changes:
                change.close()
            if job.checkpoint:
                job.checkpoint.wait()
        if changes:
            job.chosen["kernel_tier"] = Choice("GENERAL", job.kernels["why"])
        for change in changes:
            if complaint := change.complaint:
                job.warnings.append(f"specialised kernels could not be compiled, general ones rendered: {complaint}")

    def _changes(self, job: Job, places: list[Place], left: Callable[[], float | None]) -> list[TierChange]:
        """Who may hand specialised kernels to workers that begin with general ones: one for each model of device."""
        changes = []
        for i, place in enumerate(places):
            tier, device = place.job.tier, place.at.device
            is_first = not any(is_alike(device, before.at.device) for before in places[:i])
            if is_first and tier.general and tier.asked == "AUTO":
                alike = [each for its in places if is_alike(device, its.at.device) for each in its.integrators]
                request = CompileRequest(job.features, job.settings, place.job.plan)
                changes.append(TierChange(place.at.tier_changes, request, alike, left, device))
        job.change = changes[0] if changes else None
        return changes
