"""Runs as data for JSON, with the keys of `scripts/convergence.py --json`."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

from ..core.convergence.points import slope_data
from .records import Run
from .run_texts import names_of


def runs_as_data(runs: Sequence[Run], target: float) -> dict[str, Any]:
    """For JSON, newest run first: keys as those of `scripts/convergence.py --json`, and rays a second."""
    names = names_of(runs)
    newest = runs[0] if runs else None
    return {
        "scene": newest.scene if newest else None,
        "device": newest.device if newest else None,
        "reference": {"kind": "halves", "name": "two halves of each render"},
        "target": {"relmse": target},
        "runs": [_run_as_data(run, names[run.number]) for run in runs],
        "summary": [_summary_as_data(run, names[run.number], target) for run in runs],
        "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def _run_as_data(run: Run, label: str) -> dict[str, Any]:
    slope = slope_data(run.slope)
    return {
        "settings": run.settings,
        "seed": run.settings["seed"],
        "points": [point.data() for point in run.points],
        "slope": slope["slope"],
        "slope_spread": slope["slope_spread"],
        "run": run.number,
        "label": label,
        "scene": run.scene,
        "layer": run.layer,
        "view": run.view,
        "frame": run.frame,
        "device": run.device,
        "state": run.state,
        "stopped_by": run.stopped_by,
        "samples": run.samples,
        "seconds": run.seconds,
        "error": run.error,
        "rates": [dataclasses.asdict(rate) for rate in run.rates],
    }


def _summary_as_data(run: Run, label: str, target: float) -> dict[str, Any]:
    found = run.time_to(target)
    return {
        "label": label,
        "run": run.number,
        "runs": 1,
        **slope_data(run.slope),
        "seconds_to_target": {**dict.fromkeys(("median", "least", "most"), found[0]), "extrapolated": found[1]}
        if found
        else None,
    }
