"""Whole renders by several devices, beside the same render by fewer of them."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import warp as wp
from lib.command import UsageError

from benchmarking.against.films import FilmsCompared
from benchmarking.progress import Steps
from benchmarking.timing import summary
from benchmarking.whole_render import OpenedScene, RenderRequest, TimedRender, scene_report, timed_render
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import find_devices
from raybatch_addon.core.film import Film
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings


def device_counts(there: int) -> list[int]:
    """How many of `there` devices render: one, two, four, and so on, and all."""
    return [*(1 << i for i in range(there.bit_length()) if 1 << i < there), there]


@dataclass
class _Few:
    """Some of the devices, and what their renders reported."""

    devices: Sequence[wp.Device]
    session: Session
    cold: dict[str, Any] = field(default_factory=dict)  # statistics of the first render
    runs: list[dict[str, Any]] = field(default_factory=list)  # of the timed ones
    seconds: list[float] = field(default_factory=list)  # of those, as a whole

    @property
    def name(self) -> str:
        """Of the render."""
        return f"{len(self.devices)} devices" if len(self.devices) > 1 else "one device"

    def render(self, opened: OpenedScene, settings: RenderSettings) -> TimedRender:
        """A whole render; what it leaves on the devices is given back, which the next needs."""
        try:
            return timed_render(self.session, opened.scene, settings)
        finally:
            self.session.close()

    def report(self, one: _Few) -> dict[str, Any]:
        """Times, beside those of `one` device in the same turns."""
        parts = {stage: [run["seconds"][stage] for run in self.runs] for stage in ("build", "render")}
        last = self.runs[-1]
        return {
            "devices": [each["alias"] for each in last["devices"]],
            "cold": {"seconds": round(self.cold["seconds"]["total"], 3), "stages": self.cold["seconds"]},
            "whole": summary(self.seconds),
            **{stage: summary(seconds) for stage, seconds in parts.items()},
            "speedup_whole": _speedup(one.seconds, self.seconds),
            "speedup": _speedup([run["seconds"]["render"] for run in one.runs], parts["render"]),
            "waiting": round(statistics.median(map(waiting, self.runs)), 4),
            "paths": [each["paths"] for each in last["devices"]],
            "tree": last["tree"],
            "batching": last["batching"],
            "auto": last["auto"],
            "warnings": last["warnings"],
        }


def waiting(reported: dict[str, Any]) -> float:
    """The share of all devices' time in which their workers waited while others rendered; `reported` are statistics."""
    seconds, devices = reported["seconds"]["render"], reported["devices"]
    worked = sum(each["seconds_working"] for each in devices)
    return max(0.0, 1 - worked / (len(devices) * seconds)) if seconds else 0.0


def _speedup(one: Sequence[float], several: Sequence[float]) -> float:
    return round(statistics.median(a / b for a, b in zip(one, several, strict=True) if b), 4)


def measure_against_devices(
    opened: OpenedScene, settings: RenderSettings, request: RenderRequest
) -> tuple[dict[str, Any], Film]:
    """The report of `benchmark.py render --against devices`, and the film of one device; raises `RayBatchError`.

    Films that differ are in the report, under `films`. Every render builds its trees anew.
    """
    devices = find_devices(request.device)
    if len(devices) < 2:
        raise UsageError(
            f"--against devices compares several devices with fewer of them, and --device {request.device} names "
            f"{devices[0].alias} alone: name more, such as cuda:0,cuda:1, or ALL"
        )
    films, film = FilmsCompared(), None
    compared = [
        _Few(some, Session(",".join(each.alias for each in some), settings, kernel_cache_folder()))
        for some in (devices[:count] for count in device_counts(len(devices)))
    ]
    steps = Steps(len(compared) + request.runs)
    try:
        for few in compared:
            steps.begin(f"{few.name}: first render, with compilation")
            first = few.render(opened, settings).film
            few.cold = first.statistics
            films.take(few.name, first)
            film = film or first
            steps.end()
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            for few in compared:
                timed = few.render(opened, settings)
                few.seconds.append(timed.seconds)
                few.runs.append(timed.film.statistics)
                films.take(few.name, timed.film)
                del timed
            steps.end()
    finally:
        steps.close()
        for few in compared:
            few.session.close()
    assert film is not None
    one = compared[0]
    return {
        **scene_report(opened, one.runs[-1]),
        "several": [few.report(one) for few in compared],
        "films": films.report(),
    }, film
