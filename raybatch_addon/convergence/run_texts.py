"""Runs in words: what sets them apart, how far they came, and when they reach an error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from ..core.settings.settings import SETTINGS
from .plotting.axes import number_text, seconds_text
from .records import FINISHED, RUNNING, Run

# Settings that say when a render ends and what is reported of it, and words for what ended one
_END_SETTINGS = {"sample_count", "time_limit", "error_estimate", "error_target"}
_ENDINGS = {
    "error": "stopped at its error",
    "time": "stopped by its time limit",
    "noise": "stopped by its noise threshold",
}


def names_of(runs: Sequence[Run]) -> dict[int, str]:
    """Names by number that tell `runs` apart: scene, view layer, frame and settings in which they differ.

    What more than half of them have is not said, and when they end only where they differ in nothing else.
    """
    about = {
        run.number: {"scene": run.scene, "layer": run.layer, "view": run.view, "frame": f"frame {run.frame}"}
        | _setting_texts(run)
        for run in runs
    }
    values = {key: Counter(each.get(key) for each in about.values()) for key in next(iter(about.values()), {})}
    differing = [key for key, counts in values.items() if len(counts) > 1]
    differing = [key for key in differing if key not in _END_SETTINGS] or differing
    names = {}
    for number, each in about.items():
        own = [each[key] for key in differing if key in each and 2 * values[key][each[key]] <= len(about)]
        names[number] = ", ".join([f"#{number}", *own])
    return names


def _setting_texts(run: Run) -> dict[str, str]:
    return {
        name: f"{SETTINGS[name].label if name in SETTINGS else name} {_value_text(name, value)}"
        for name, value in run.settings.items()
    }


def _value_text(name: str, value: Any) -> str:
    """The value of a setting as the panel names it."""
    return SETTINGS[name].name_of(value) if name in SETTINGS else str(value)


def error_line(statistics: dict[str, Any]) -> str:
    """How far a render came, and why it ended: samples, error, `stopped_by`. For its statistics."""
    samples = statistics.get("samples_per_pixel")
    if samples is None:
        return ""
    parts = [f"{samples:,} sample{'' if samples == 1 else 's'} per pixel"]
    if not statistics.get("stopped_by") and (mean := _samples_mean(statistics)) is not None:
        parts = [f"{mean:,.1f} samples per pixel"]  # also those of a round that did not come to its end
    if adaptive := statistics.get("adaptive"):
        parts = [
            f"{adaptive['samples_mean']:,.0f} samples per pixel, {samples:,} at most",
            f"{100 * adaptive['converged']:.0f} % of the pixels below the noise threshold",
        ]
    error = statistics.get("error")
    if error and error.get("relmse") is not None:
        parts.append(
            f"error {error['relmse']:.3g} (relMSE)"
            + (f" at {error['samples']:,}" if error["samples"] != samples else "")
        )
    if statistics.get("stopped_by") in _ENDINGS:
        parts.append(_ENDINGS[statistics["stopped_by"]])
    elif error and error.get("target") and not error.get("reached") and statistics.get("stopped_by"):
        parts.append(f"the error of {error['target']:g} was not reached")
    elif not statistics.get("stopped_by"):
        parts.append("cancelled")
    return ", ".join(parts)


def _samples_mean(statistics: dict[str, Any]) -> float | None:
    """Samples of a pixel in the mean, of all that reached the film; None where that is not known."""
    if "samples" not in statistics or "frame" not in statistics:
        return None
    x0, y0, x1, y1 = statistics["frame"]["region"]
    return statistics["samples"] / ((x1 - x0) * (y1 - y0))


def run_lines(run: Run, target: float) -> list[str]:
    """Where a run stands, its slope, and when it reaches the relMSE `target`."""
    state = _ENDINGS.get(run.stopped_by or "", run.state) if run.state == FINISHED else run.state
    samples = run.samples or (run.points[-1].samples if run.points else 0)
    count = f"{samples:,.0f} samples in " if samples else ""
    head = [f"{state.capitalize()}: {count}{seconds_text(run.seconds)}" if run.seconds else state.capitalize()]
    if run.rates:
        head.append(f"{number_text(run.rates[-1].rays_per_second)} rays/s")
    lines = [", ".join(head)]
    if run.problem:
        lines.append(run.problem)
    if not run.estimates_error:
        return [*lines, "The error is not known: turn on Error Estimate in Sampling"]
    if not run.points:
        return [*lines, "No error yet: it takes two samples"]
    lines.append(f"Error {run.points[-1].relmse:.3g} (relMSE) at {run.points[-1].samples:,.0f} samples")
    slope = run.slope
    if slope is not None:
        lines.append(f"RMSE against samples: {slope.says}")
    lines.append(target_line(run, target))
    return lines


def target_line(run: Run, target: float) -> str:
    """When `run` reaches the relMSE `target`."""
    found = run.time_to(target)
    if found is None:
        return f"relMSE {target:g}: never at this rate"
    seconds, extrapolated = found
    if not extrapolated:
        return f"relMSE {target:g} in {seconds_text(seconds)}"
    left = f", {seconds_text(max(seconds - run.seconds, 0))} left" if run.state == RUNNING else ""
    return f"relMSE {target:g} in about {seconds_text(seconds)}{left} (extrapolated)"
