"""The results of the runs, as JSON has them."""

from __future__ import annotations

import dataclasses
from typing import Any

from converging.reference import UsedReference
from converging.study import Run, Study
from converging.summary import Summary, VariantOutcome, short, shortened
from raybatch_addon.core.convergence.points import PICTURE_SETTINGS, fit_slope, slope_data


def json_report(summary: Summary, request: dict[str, Any]) -> dict[str, Any]:
    """The report as JSON has it; `request` is what was asked for."""
    study = summary.study
    frame = study.opened.scene.frame
    return {
        "scene": study.opened.name,
        "device": study.device["name"],
        "reference": _reference(study.used[0]),
        "target": {"relmse": short(summary.target), "given": summary.target_given},
        "notes": summary.notes,
        "runs": [_run(run) for run in study.runs],
        "summary": [_summary(each, study) for each in summary.outcomes],
        "at_equal_time": [each.data() for each in summary.equal_times],
        "references": [_reference(each) for each in study.used],
        "references_apart": shortened(study.apart) if study.apart else None,
        "request": request,
        "settings": dataclasses.asdict(study.variants[0].settings),
        "frame": {"width": frame.width, "height": frame.height},
        "machine": study.device | ({"cycles_device": study.cycles_device} if study.cycles_device else {}),
        "versions": study.versions,
        "warnings": study.warnings,
        "seconds": round(study.seconds, 3),
    }


def _reference(used: UsedReference) -> dict[str, Any]:
    reference, settings = used.reference, used.settings
    return {
        "kind": used.kind,
        "name": reference.name if reference else "two halves of each render",
        "samples": reference.samples if reference else None,
        "size": list(reference.size) if reference else None,
        "noise_floor": shortened(dict(zip(("rmse", "relmse"), used.floor, strict=True))),
        "settings": {name: getattr(settings, name) for name in PICTURE_SETTINGS} if settings else {},
        "file": str(used.path) if used.path else None,
        "from_cache": used.from_cache,
        "seconds": None if used.seconds is None else round(used.seconds, 3),
    }


def _run(run: Run) -> dict[str, Any]:
    slope = slope_data(fit_slope(run.points))
    return {
        "engine": run.variant.engine,
        "label": run.variant.label,
        "settings": run.variant.values,
        "seed": run.seed,
        "points": [shortened(point.data()) for point in run.points],
        **shortened({name: slope[name] for name in ("slope", "slope_spread")}),
    }


def _summary(each: VariantOutcome, study: Study) -> dict[str, Any]:
    return {
        "engine": each.variant.engine,
        "label": each.variant.label,
        "settings": each.variant.values,
        "runs": len(each.runs),
        **shortened(slope_data(each.slope)),
        "slope_seconds": short(each.slope_seconds.slope) if each.slope_seconds else None,
        "seconds_to_target": {**each.target_seconds.json(), "extrapolated": each.target_extrapolated}
        if each.target_seconds
        else None,
        "speed_up_to_target": short(each.speed_up),
        "efficiency": each.efficiency.json() if each.efficiency else None,
        "efficiency_relative": each.efficiency_relative.json() if each.efficiency_relative else None,
        "efficiency_relmse": short(each.efficiency_relmse),
        "end": shortened(each.end),
        "invalid_samples": max((point.invalid_samples for point in each.last), default=0),
        "first_seconds": short(study.first_seconds.get(each.variant.label)),
    }
