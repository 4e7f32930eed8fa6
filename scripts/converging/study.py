"""The runs of convergence.py: variants take turns, with seed after seed."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from importlib import metadata
from typing import Any

import numpy as np
from benchmarking.progress import Steps
from benchmarking.whole_render import OpenedScene, RenderRequest, open_scene
from lib.command import UsageError
from lib.output import print_warnings

from converging.flip import MISSING, flip_function
from converging.reference import TAKEN_SEEDS, References, UsedReference, picture_alone
from converging.request import (
    CYCLES,
    PRESET,
    ConvergenceRequest,
    Variant,
    parse_comparison,
    run_seeds,
    run_settings,
    variants,
)
from raybatch_addon.blender.denoise_library import library_for
from raybatch_addon.blender.denoising import with_guides
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.convergence.points import ConvergenceRecorder, ErrorPoint, error_point
from raybatch_addon.core.denoise.library import DenoiseLibrary
from raybatch_addon.core.denoise.picture import COMBINED, denoised
from raybatch_addon.core.device.devices import device_description, find_device
from raybatch_addon.core.measure.snapshot import Snapshot
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings

WARM_UP_SAMPLES = 4  # of a first render, unless time ends the runs
WARM_UP_SHARE, WARM_UP_SECONDS = 0.25, 2.0  # then it takes this share of a run's time, and no longer than this


@dataclass(frozen=True)
class Run:
    """One render, or for Cycles one at each sample count, with one seed."""

    variant: Variant
    seed: int
    points: list[ErrorPoint]
    # at the end, linear RGB, float32, shape [height, width, 3], bottom row first; None: nobody looks at it
    picture: np.ndarray | None


@dataclass
class Study:
    """All that was measured."""

    opened: OpenedScene
    variants: list[Variant]
    device: dict[str, Any]
    runs: list[Run] = field(default_factory=list)
    references: dict[str, UsedReference] = field(default_factory=dict)  # by the variant's label
    used: list[UsedReference] = field(default_factory=list)  # each once
    _: KW_ONLY
    apart: dict[str, float | None] | None = None  # limits of two engines
    cycles_device: str | None = None  # as Cycles calls it, where it competes
    first_seconds: dict[str, float] = field(
        default_factory=dict
    )  # of a first render with few samples, with compilation, by label
    versions: dict[str, str] = field(default_factory=dict)
    flip_computed: bool = False  # whether FLIP was computed
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0  # that all took

    def runs_of(self, variant: Variant) -> list[Run]:
        """Runs of one variant, in the order of seeds."""
        return [run for run in self.runs if run.variant is variant]


def opened_scene(request: ConvergenceRequest) -> OpenedScene:
    """The scene of `request`, with the picture as its only pass; raises `RayBatchError`."""
    return picture_alone(open_scene(RenderRequest(request.scene, size=request.size)))


def measured(request: ConvergenceRequest) -> Study:
    """Everything that was asked for; raises `RayBatchError`."""
    start = time.perf_counter()
    comparison = parse_comparison(
        request.compare, request.settings | ({PRESET: request.preset} if request.preset else {})
    )
    opened = opened_scene(request)
    settings = run_settings(request, opened.settings)
    competing = variants(comparison, settings, request.settings)
    if request.cycles:
        competing.append(Variant(CYCLES, {"engine": CYCLES}, settings, CYCLES))
    for variant in competing:
        if library_for(variant.settings) and request.reference_from == "halves":
            raise UsageError("--reference halves does not see what denoising does wrong: choose another reference")
    device = find_device(request.device)
    study = Study(opened, competing, device_description(device))
    flip = flip_function() if request.flip and request.reference_from != "halves" else None
    if request.flip and flip is None and request.reference_from != "halves":
        print(f"convergence.py: {MISSING}", file=sys.stderr)
    study.flip_computed = flip is not None
    session = Session(device.alias, settings, kernel_cache_folder())
    steps = Steps(2 * len(competing) + request.runs * len(competing))
    try:
        _Runner(request, study, session, steps, flip).run()
    finally:
        steps.close()
        session.close()
    study.versions = versions() | ({"flip-evaluator": metadata.version("flip-evaluator")} if flip else {})
    study.seconds = time.perf_counter() - start
    return study


class _Runner:
    def __init__(
        self, request: ConvergenceRequest, study: Study, session: Session, steps: Steps, flip: Callable | None
    ):
        self._request, self._study, self._session, self._steps, self._flip = request, study, session, steps, flip

    def run(self) -> None:
        """Warm up, get references, then let variants take turns."""
        request, study = self._request, self._study
        references = References(request, study.opened, self._session, self._report)
        references.require_one(study.variants)
        if not request.makes_reference:  # nothing is rendered if it cannot be used
            for variant in study.variants:
                references.of(variant, 1)
        samples = 1
        for variant in study.variants:
            self._steps.begin(f"first render of {variant.label}, with compilation")
            rate = self._warm_up(variant)
            most = variant.settings.sample_count
            samples = max(
                samples, most if request.seconds is None else min(most, int(request.seconds / max(rate, 1e-9)))
            )
            self._steps.end()
        for variant in study.variants:
            self._steps.begin(f"reference for {variant.label}")
            study.references[variant.label] = references.of(variant, samples)
            self._steps.end()
        study.used, study.apart = references.used, references.apart()
        for turn, seed in enumerate(run_seeds(study.variants[0].settings.seed, request.runs, TAKEN_SEEDS)):
            # each begins as often as any other: what drifts, as a machine's speed does, comes to all alike
            first = turn % len(study.variants)
            for variant in study.variants[first:] + study.variants[:first]:
                self._steps.begin(f"{variant.label}, seed {seed} ({turn + 1} of {request.runs})")
                study.runs.append(self._run(variant, seed, keep=turn == 0))
                self._steps.end()

    def _report(self, text: str) -> None:
        print(f"convergence.py: {text}", file=sys.stderr, flush=True)

    def _warm_up(self, variant: Variant) -> float:
        """Do once what is done once; returns seconds that a sample of every pixel takes, roughly."""
        if variant.engine == CYCLES:
            from converging.cycles import open_peer, require_size

            peer = open_peer(self._study.opened, self._session.device, variant.settings)
            seconds, picture = peer.timed_picture(0, 1)
            x0, y0, x1, y1 = self._study.opened.scene.frame.region
            require_size(picture, (x1 - x0, y1 - y0))
            self._study.first_seconds[variant.label], self._study.cycles_device = seconds, peer.device
            return seconds
        recorder = ConvergenceRecorder()
        settings = variant.settings
        if self._request.seconds is None:
            settings = settings.replace(sample_count=min(WARM_UP_SAMPLES, settings.sample_count))
        else:  # long enough to show how many samples a run will have
            settings = settings.replace(time_limit=min(WARM_UP_SHARE * self._request.seconds, WARM_UP_SECONDS))
        start = time.perf_counter()
        film = self._session.render(with_guides(self._study.opened.scene, settings), settings, observers=[recorder])
        self._study.first_seconds[variant.label] = time.perf_counter() - start
        warnings = [text for text in film.statistics["warnings"] if text not in self._study.warnings]
        print_warnings(warnings, "convergence.py")
        self._study.warnings += warnings
        return recorder.snapshots[-1].seconds / recorder.snapshots[-1].samples

    def _run(self, variant: Variant, seed: int, keep: bool) -> Run:
        snapshots = self._snapshots(variant, seed)
        picture = snapshots[-1].picture if keep else None
        reference = self._study.references[variant.label].reference
        if reference is None:  # halves that have no sample yet show nothing
            snapshots = [each for each in snapshots if each.halves is not None and each.samples >= 2]
        points = [error_point(each, reference, self._flip_or_nan if self._flip else None) for each in snapshots]
        return Run(variant, seed, points, picture)

    def _flip_or_nan(self, picture: np.ndarray, reference: np.ndarray) -> float:
        assert self._flip is not None
        value = self._flip(picture, reference)
        return float("nan") if value is None else value

    def _snapshots(self, variant: Variant, seed: int) -> list[Snapshot]:
        if variant.engine == CYCLES:
            from converging.cycles import cycles_snapshots, open_peer

            # again: a reference with other bounces or another filter may have been made of the same scene meanwhile
            peer = open_peer(self._study.opened, self._session.device, variant.settings)
            return cycles_snapshots(peer, seed, variant.settings.sample_count, self._request.seconds)
        recorder = ConvergenceRecorder()
        scene = with_guides(self._study.opened.scene, variant.settings)
        self._session.render(scene, variant.settings.replace(seed=seed), observers=[recorder])
        denoiser = library_for(variant.settings)
        if denoiser is None:
            return recorder.snapshots
        return [_denoised(each, variant.settings, denoiser) for each in recorder.snapshots]


def _denoised(snapshot: Snapshot, settings: RenderSettings, library: DenoiseLibrary) -> Snapshot:
    """`snapshot` with its picture denoised, and the time that this takes in its seconds."""
    start = time.perf_counter()
    picture = denoised({COMBINED: snapshot.picture} | snapshot.guides, settings, library)
    took = time.perf_counter() - start
    return dataclasses.replace(
        snapshot, picture=picture, seconds=snapshot.seconds + took, seconds_total=snapshot.seconds_total + took
    )
