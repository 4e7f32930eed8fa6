"""The results of the runs: slopes, time to an error, efficiency; in numbers, in words, and as JSON."""

from __future__ import annotations

import dataclasses
import math
import statistics
from dataclasses import KW_ONLY, dataclass
from typing import Any

from benchmarking.tables import table

from converging.equal_time import EqualTime, equal_times
from converging.request import CLAMPS, CYCLES, RAYBATCH, Variant
from converging.study import Run, Study
from raybatch_addon.core.convergence.points import ErrorPoint, Slope, efficiency, fit_slope, time_to

# Share of the last squared error above which a reference's noise is reported
FLOOR_TOLD = 0.1


def short(value: float | None) -> float | None:
    """`value` with six digits, which is more than any of these has; None for what is not finite."""
    return float(f"{value:.6g}") if value is not None and math.isfinite(value) else None


def shortened(values: dict[str, Any]) -> dict[str, Any]:
    """`values` with six digits of each float."""
    return {name: short(value) if isinstance(value, float) else value for name, value in values.items()}


@dataclass(frozen=True)
class Ranged:
    """A median of several runs, with the least and the most of them."""

    median: float
    least: float
    most: float

    @staticmethod
    def of(values: list[float]) -> Ranged | None:
        """None where there are none."""
        return Ranged(statistics.median(values), min(values), max(values)) if values else None

    def json(self) -> dict[str, float]:
        """The values with six digits each, as JSON holds them."""
        return shortened(dataclasses.asdict(self))


@dataclass(frozen=True)
class VariantOutcome:
    """The results of the runs of one variant."""

    variant: Variant
    runs: list[Run]
    slope: Slope | None  # of RMSE against samples, over all runs
    slope_seconds: Slope | None  # against seconds
    _: KW_ONLY
    efficiency: Ranged | None  # 1 / (relMSE x seconds), no pixel counting for more than `RELMSE_MOST`
    efficiency_relative: Ranged | None  # to the first variant's
    efficiency_relmse: float | None  # 1 / (relMSE x seconds), as it is
    target_seconds: Ranged | None
    target_extrapolated: bool  # of most runs
    speed_up: float | None  # how many times sooner than the first variant it reaches the target

    @property
    def last(self) -> list[ErrorPoint]:
        """The last points of its runs."""
        return [run.points[-1] for run in self.runs if run.points]

    @property
    def end(self) -> dict[str, float | None]:
        """Medians of the last points."""
        names = ("samples", "seconds", "seconds_total", "rmse", "relmse", "flip")
        return {name: _median([getattr(point, name) for point in self.last]) for name in names}


@dataclass(frozen=True)
class Summary:
    """The results of a study."""

    study: Study
    target: float | None  # relMSE
    target_given: bool
    outcomes: list[VariantOutcome]
    notes: list[str]  # what a reader must know

    @property
    def equal_times(self) -> list[EqualTime]:
        """The errors of all other variants over the first's, at equal time."""
        return equal_times({each.variant.label: {run.seed: run.points for run in each.runs} for each in self.outcomes})


def summarised(study: Study, target: float | None) -> Summary:
    """Slopes and times of all variants; without a `target` it is the error that the first variant has at its end."""
    given = target is not None
    if target is None:
        ends = [run.points[-1].relmse for run in study.runs_of(study.variants[0]) if run.points]
        target = statistics.median(ends) if ends and statistics.median(ends) > 0 else None
    outcomes: list[VariantOutcome] = []
    for variant in study.variants:
        outcomes.append(_outcome(study, variant, target, outcomes[0] if outcomes else None))
    return Summary(study, target, given, outcomes, _notes(study, outcomes))


def _outcome(study: Study, variant: Variant, target: float | None, first: VariantOutcome | None) -> VariantOutcome:
    runs = study.runs_of(variant)
    points = [point for run in runs for point in run.points]
    slope = fit_slope(points)
    reached = [found for run in runs if target and (found := time_to(run.points, target, slope)) is not None]
    # a time that not every run has would be that of the lucky ones
    seconds = Ranged.of([each for each, _ in reached]) if len(reached) == len(runs) else None
    own = _efficiencies(runs)
    others = _efficiencies(first.runs) if first else own
    ratios = [value / others[seed] for seed, value in own.items() if seed in others]
    relative = None
    if ratios and others:
        middle = statistics.median(own.values()) / statistics.median(others.values())
        relative = Ranged(middle, min(*ratios, middle), max(*ratios, middle))
    of_relmse = [value for run in runs if (value := efficiency(run.points, "relmse")) is not None]
    theirs = first.target_seconds if first else seconds
    sooner = theirs.median / seconds.median if theirs and seconds and seconds.median else None
    return VariantOutcome(
        variant,
        runs,
        slope,
        fit_slope(points, "seconds"),
        efficiency=Ranged.of(list(own.values())),
        efficiency_relative=relative,
        efficiency_relmse=statistics.median(of_relmse) if of_relmse else None,
        target_seconds=seconds,
        target_extrapolated=2 * sum(beyond for _, beyond in reached) > len(reached),
        speed_up=sooner,
    )


def _efficiencies(runs: list[Run]) -> dict[int, float]:
    """By seed, of errors that no firefly rules."""
    return {run.seed: value for run in runs if (value := efficiency(run.points, "relmse_most")) is not None}


def _notes(study: Study, outcomes: list[VariantOutcome]) -> list[str]:
    notes = []
    for each in outcomes:
        clamps = [
            f"{name}={value:g}"
            for name in CLAMPS
            if (value := getattr(each.variant.settings, name)) and each.variant.engine == RAYBATCH
        ]
        if clamps:
            notes.append(
                f"{each.variant.label}: {', '.join(clamps)} takes light away, which is a bias (0: no clamping)"
            )
        if each.variant.settings.denoise == "ON" and each.variant.engine == RAYBATCH:
            notes.append(
                f"{each.variant.label}: pictures are denoised, which is a bias that more samples make smaller; their "
                "seconds include that of denoising them"
            )
        if each.variant.engine == CYCLES and any(point.seconds == point.seconds_total for point in each.last):
            notes.append(
                f"{each.variant.label}: its renders are too short to tell what of them is set-up: that is in their "
                "seconds"
            )
        if invalid := max((point.invalid_samples for point in each.last), default=0):
            notes.append(f"{each.variant.label}: {invalid:,} samples of a run were not finite")
        shares = [
            point.floor_relmse / point.relmse
            for point in each.last
            if point.floor_relmse and point.relmse and not point.from_halves
        ]
        if shares and statistics.median(shares) > FLOOR_TOLD:
            share = f"{100 * min(1.0, statistics.median(shares)):.0f} %"
            notes.append(
                f"{each.variant.label}: {share} of its last relMSE is noise of the reference; --reference-samples "
                "makes a better one"
            )
    for used in study.used:
        if used.kind == "halves":
            notes.append("errors are estimated from two halves of each render: a bias is not in them")
        elif used.reference is not None and used.floor[0] is None:
            notes.append(
                f"how far {used.reference.name} is off itself is not known: a curve that flattens may have come to its "
                "noise"
            )
    if study.apart:
        apart = study.apart
        brightness = (
            "" if apart["mean_ratio"] is None else f"; RayBatch has {apart['mean_ratio']:.4f} of Cycles' brightness"
        )
        notes.append(
            f"each engine is measured against its own reference; these two are apart by RMSE {apart['rmse']:.3g} "
            f"(their noise makes {apart['noise_rmse']:.3g}) and relMSE {apart['relmse']:.3g} "
            f"({apart['noise_relmse']:.3g}){brightness}"
        )
    return notes


def _median(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return statistics.median(known) if known else None


# --- words

HEADS = [
    "setting",
    "",
    "samples",
    "seconds",
    "RMSE",
    "relMSE",
    "FLIP",
    "slope",
    "to target",
    "sooner",
    "efficiency",
    "spread",
]


def rows(summary: Summary) -> list[list[str]]:
    """A row for each variant, under HEADS."""
    found = []
    for each in summary.outcomes:
        end, count = each.end, len(each.runs)
        found.append(
            [
                each.variant.label,
                f"{count} run{'s' * (count != 1)}",
                f"{end['samples'] or 0:,.0f}",
                _text(end["seconds"], "{:.3f}"),
                _text(end["rmse"], "{:.3g}"),
                _text(end["relmse"], "{:.3g}"),
                _text(end["flip"], "{:.3g}"),
                slope_text(each.slope),
                target_text(each),
                _text(each.speed_up, "x {:.2f}"),
                *relative_text(each.efficiency_relative, is_first=each is summary.outcomes[0]),
            ]
        )
    return found


def slopes_said(summary: Summary) -> list[tuple[str, str, bool]]:
    """Lines of the variants that have a slope: label, what the slope says, and whether the curve flattens."""
    return [(each.variant.label, each.slope.says, each.slope.flattens) for each in summary.outcomes if each.slope]


def slope_text(slope: Slope | None) -> str:
    """With its spread, and a mark where the curve flattens."""
    if slope is None:
        return "-"
    spread = f" ±{slope.spread:.2f}" if math.isfinite(slope.spread) else ""
    return f"{slope.slope:.2f}{spread}{' BIAS' if slope.flattens else ''}"


def target_text(each: VariantOutcome) -> str:
    """Seconds to the target; with ~ where they are extrapolated."""
    if each.target_seconds is None:
        return "never" if each.slope and each.slope.flattens else "-"
    return f"{'~' if each.target_extrapolated else ''}{each.target_seconds.median:.3g} s"


def relative_text(relative: Ranged | None, is_first: bool) -> tuple[str, str]:
    """Efficiency of the first's, and the least and the most of runs."""
    if relative is None:
        return "-", ""
    return f"{relative.median:.3g}", "" if is_first else f"{relative.least:.2g}..{relative.most:.2g}"


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def reference_text(summary: Summary) -> list[str]:
    """A line for each reference."""
    lines = []
    for used in summary.study.used:
        if used.reference is None:
            lines.append("error: estimated from two halves of each render, without a reference")
            continue
        reported = f"{used.reference.samples:,} samples, " if used.reference.samples else ""
        floor = (
            "of unknown noise"
            if used.floor[0] is None
            else f"whose own noise is RMSE {used.floor[0]:.3g}, relMSE {used.floor[1]:.3g}"
        )
        kept = (
            f" ({'kept from before' if used.from_cache else 'made now'})" if used.kind in ("raybatch", "cycles") else ""
        )
        lines.append(f"reference: {used.reference.name}, {reported}{floor}{kept}")
    return lines


def target_line(summary: Summary) -> str:
    """What the target is."""
    if summary.target is None:
        return "no target: the error that the first setting has at its end is 0, or not known"
    return f"target: relMSE {summary.target:.3g}" + (
        "" if summary.target_given else ", which the first setting has at its end"
    )


def text_report(summary: Summary) -> str:
    """The report as a person reads it."""
    study = summary.study
    frame = study.opened.scene.frame
    lines = [
        f"{study.opened.name}, {frame.width} x {frame.height} pixels, on {study.device['name']}",
        *reference_text(summary),
    ]
    lines += [target_line(summary), "", table(HEADS, rows(summary))]
    lines += [
        "medians of runs; seconds: of rendering alone; slope: of RMSE against samples; sooner: at the target, than the "
        "first setting;"
    ]
    lines += ["efficiency: 1 / (error x seconds), relative to the first; ~: extrapolated", ""]
    lines += [each.says for each in summary.equal_times]
    lines += [f"{label}: {'BIAS, ' * flattens}{says}" for label, says, flattens in slopes_said(summary)]
    lines += [f"note: {note}" for note in summary.notes]
    return "\n".join(lines)
