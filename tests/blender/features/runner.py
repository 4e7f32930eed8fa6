"""Features rendered by both engines, and their results."""

from __future__ import annotations

import math
import re
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.blender.features.compare import (
    RenderFailed,
    cycles_picture,
    empty_scene,
    figures_of,
    raybatch_picture,
    set_alike,
)
from tests.blender.features.registry import SAMPLES, Feature
from tests.blender.features.sheet import CELLS_MOST, TOLERANCE, Cell, build_sheet, render_sheet

MEAN_TOLERANCE = 0.01
REL_MSE_TOLERANCE = 3e-3
# standard errors by which a figure must differ from its tolerance
MEAN_NOISE = 0.0025
REL_MSE_NOISE = 6e-4
SAMPLES_MOST = 4096

NOT_SUPPORTED = "not supported"  # part of warnings
OK, DIFFERENT, UNSUPPORTED, NOISY, FAILED = "ok", "differs", "not supported", "too noisy", "failed"


@dataclass
class Result:
    """Result of one feature."""

    feature: Feature
    status: str
    figures: dict[str, float] = field(default_factory=dict)
    note: str = ""
    ours: np.ndarray | None = None  # [height, width, 3], bottom row first: the worst plane, or the picture
    theirs: np.ndarray | None = None
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the feature is within bounds."""
        return self.status == OK

    def text(self) -> str:
        """The result in one line."""
        numbers = ", ".join(f"{name} {value:.3g}" for name, value in self.figures.items())
        return f"{self.status:13} {self.feature.name}: {numbers}{'; ' if self.note and numbers else ''}{self.note}"


def run(features: list[Feature], done: Callable[[Result], None] = lambda result: None) -> list[Result]:
    """Results of all features, nodes first; `done` is called with each."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for results_of_some in _runs(features, Path(folder)):
            for result in results_of_some:
                done(result)
                results.append(result)
    return results


def _runs(features: list[Feature], folder: Path) -> Iterator[list[Result]]:
    for sheet in sheets([each for each in features if each.kind == "node"]):
        yield run_sheet(sheet, folder)
    for each in features:
        if each.kind == "picture":
            yield [run_picture(each, folder)]


def sheets(features: list[Feature]) -> list[list[Feature]]:
    """Features of a family together, about as many as fit a sheet."""
    made: list[list[Feature]] = []
    size, last = 0, None
    for each in sorted(features, key=lambda each: each.family):
        if not made or last != each.family or size + len(each.variants) > CELLS_MOST:
            made.append([])
            size, last = 0, each.family
        made[-1].append(each)
        size += len(each.variants)
    return made


def run_sheet(features: list[Feature], folder: Path) -> list[Result]:
    """Results of the features of a sheet; if they cannot be rendered together, they are rendered one by one."""
    started = time.perf_counter()
    try:
        scene, cells = build_sheet(features)
        warnings = render_sheet(scene, cells, folder)
    except RenderFailed as error:
        if len(features) > 1:
            return [result for each in features for result in run_sheet([each], folder)]
        return [Result(features[0], FAILED, note=str(error), seconds=time.perf_counter() - started)]
    except Exception as error:  # one builder's error must not fail the others
        if len(features) > 1:
            return [result for each in features for result in run_sheet([each], folder)]
        traceback.print_exc()
        return [
            Result(
                features[0], FAILED, note=f"the scene cannot be built: {error}", seconds=time.perf_counter() - started
            )
        ]
    seconds = (time.perf_counter() - started) / len(features)
    return [
        _node_result(each, [cell for cell in cells if cell.feature is each], warnings, seconds) for each in features
    ]


def _reasons(warnings: list[str]) -> list[str]:
    """Texts of the warnings without the names that they are about, each once."""
    return list(
        dict.fromkeys(re.sub(r"^(material|world|light) “[^”]*”( of “[^”]*”.*?)?: ", "", text) for text in warnings)
    )


def _node_result(feature: Feature, cells: list[Cell], warnings: list[str], seconds: float) -> Result:
    worst = max(cells, key=lambda cell: cell.worst)
    names = {f"“{cell.material}”" for cell in cells}
    reasons = _reasons([text for text in warnings if any(name in text for name in names)])
    figures = {"error": worst.worst}
    shown = worst if worst.worst > TOLERANCE else cells[-1]
    result = Result(feature, OK, figures, "; ".join(reasons), shown.ours, shown.theirs, seconds)
    if any(NOT_SUPPORTED in text for text in reasons):
        result.status = UNSUPPORTED
    if empty := [cell.label for cell in cells if cell.empty]:
        result.status, result.note = FAILED, f"Cycles' picture is the same everywhere: {', '.join(empty)}"
    elif worst.worst > TOLERANCE:
        bad = [cell for cell in cells if cell.worst > TOLERANCE]
        figures["points beyond the bound, %"] = 100 * float(np.mean([cell.errors > TOLERANCE for cell in bad]))
        result.status = UNSUPPORTED if reasons else DIFFERENT
        where = [f"{cell.label or 'it'} ({cell.worst:.2g})" for cell in bad]
        some = (
            f"{len(bad)} of {len(cells)} planes: {', '.join(where[:12])}{', ...' if len(where) > 12 else ''}"
            if len(cells) > 1
            else ""
        )
        result.note = "; ".join(filter(None, [some, *reasons]))
    return result


def run_picture(feature: Feature, folder: Path, samples: int | None = None) -> Result:
    """Result of a picture, with as many samples as a decision takes; at first `samples`, or the feature's own."""
    started = time.perf_counter()
    result = Result(feature, OK)
    try:
        _run_picture(feature, folder, result, samples or feature.samples or SAMPLES)
    except RenderFailed as error:
        result.status, result.note = FAILED, str(error)
    except Exception as error:
        traceback.print_exc()
        result.status, result.note = FAILED, f"the scene cannot be built: {error}"
    result.seconds = time.perf_counter() - started
    return result


def _run_picture(feature: Feature, folder: Path, result: Result, samples: int) -> None:
    scene = empty_scene()
    set_alike(scene, feature.resolution)
    feature.build(scene)
    for _ in range(2):
        ours = raybatch_picture(scene, samples, shows=feature.shows)
        theirs = cycles_picture(scene, samples, folder, shows=feature.shows)
        found = figures_of(ours, theirs)
        short = max((found.noise / MEAN_NOISE) ** 2, found.rel_mse_noise / REL_MSE_NOISE)
        if short <= 1 or samples >= SAMPLES_MOST:
            break
        clearly = (
            found.mean_error > MEAN_TOLERANCE + 5 * found.noise
            or found.rel_mse > REL_MSE_TOLERANCE + 5 * found.rel_mse_noise
        )
        if clearly:
            break
        samples = min(SAMPLES_MOST, math.ceil(1.3 * short * samples))
    result.ours, result.theirs = ours.mean, theirs.mean
    result.figures = {
        "mean": found.mean_error,
        "mean's noise": found.noise,
        "deviations": float(np.abs(found.deviations).max()),
        "relMSE": found.rel_mse,
        "relMSE's noise": found.rel_mse_noise,
        "samples": 2 * samples,
    }
    result.note = "; ".join(_reasons(ours.warnings))
    if found.theirs.max() < 1e-3:
        result.status, result.note = FAILED, "Cycles' picture is black"
    elif NOT_SUPPORTED in result.note:
        result.status = UNSUPPORTED  # even if this picture hardly shows it
    elif found.mean_error > MEAN_TOLERANCE or found.rel_mse > REL_MSE_TOLERANCE:
        result.status = UNSUPPORTED if ours.warnings else DIFFERENT
    elif found.noise > 2 * MEAN_NOISE or found.rel_mse_noise > 2 * REL_MSE_NOISE:
        result.status = NOISY
