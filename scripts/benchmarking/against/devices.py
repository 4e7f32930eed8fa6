"""Whole renders by several devices, beside the same render by fewer of them."""

from __future__ import annotations

import contextlib
import dataclasses
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp
from lib.command import UsageError

from benchmarking.against.films import FilmsCompared
from benchmarking.against.runs import TimedRuns, times_as_fast, without_cost
from benchmarking.progress import Steps
from benchmarking.whole_render import OpenedScene, RenderRequest, scene_report, timed_render
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import find_devices, is_alike
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings


def device_counts(there: int) -> list[int]:
    """How many of `there` devices render: one, two, four, and so on, and all."""
    return [*(1 << i for i in range(there.bit_length()) if 1 << i < there), there]


@dataclass
class _DeviceGroup(TimedRuns):
    """Devices that render together."""

    aliases: Sequence[str] = ()
    session: Session | None = None

    @property
    def name(self) -> str:
        """Of its renders."""
        return f"{len(self.aliases)} devices" if len(self.aliases) > 1 else "one device"

    def render(self, scene: Scene, settings: RenderSettings, films: FilmsCompared) -> Film:
        """A whole render, timed but for the first; what it leaves on the devices is given back, which the next group
        needs.
        """
        assert self.session is not None
        timed = timed_render(self.session, scene, settings)
        self.session.close()
        if self.first:
            self.take(timed)
        else:
            self.first = timed.film.statistics
        films.take(self.name, timed.film)
        return timed.film

    def report(self, one: _DeviceGroup) -> dict[str, Any]:
        """Times, beside those of `one` device in the same turns."""
        last = self.runs[-1]
        return {
            "devices": [each["alias"] for each in last["devices"]],
            **self.times(),
            "speedup": times_as_fast(self.stage_seconds("render"), one.stage_seconds("render")),
            "speedup_whole": times_as_fast(self.seconds, one.seconds),
            "idle": round(statistics.median(map(idle, self.runs)), 4),
            "paths": [each["paths"] for each in last["devices"]],
            "tree": last["tree"],
            "batching": last["batching"],
            "auto": last["auto"],
            "warnings": last["warnings"],
        }


def idle(reported: dict[str, Any]) -> float:
    """The share of the time of rendering, of all devices together, in which their workers were not at a tile: none was
    left, or threads began, or pictures were handed out. `reported` are statistics.
    """
    seconds, devices = reported["seconds"]["render"], reported["devices"]
    worked = sum(each["seconds_working"] for each in devices)
    return max(0.0, 1 - worked / (len(devices) * seconds)) if seconds else 0.0


def compared_devices(names: str) -> list[wp.Device]:
    """Two devices or more of one model; raises `UsageError`."""
    devices = find_devices(names)
    if len(devices) < 2:
        raise UsageError(
            f"--against devices compares several devices with fewer of them, and --device {names} names "
            f"{devices[0].alias} alone: name more, such as cuda:0,cuda:1, or ALL"
        )
    if unlike := [each for each in devices if not is_alike(each, devices[0])]:
        raise UsageError(
            f"{unlike[0].alias} is no device of the model of {devices[0].alias}, and unlike devices do not render the "
            "same bits, which --against devices compares: leave it out"
        )
    return devices


def measure_against_devices(
    opened: OpenedScene, settings: RenderSettings, request: RenderRequest
) -> tuple[dict[str, Any], Film]:
    """The report of `benchmark.py render --against devices`, and the film of one device; raises `RayBatchError`.

    Films that differ are in the report, under `films`. Every render builds its trees anew. The groups take turns, in
    every other turn from the largest down.
    """
    aliases = [each.alias for each in compared_devices(request.device)]
    settings = settings.replace(time_limit=0)  # by which more devices would render more samples
    scene, films, film = without_cost(opened.scene), FilmsCompared(), None
    counts = device_counts(len(aliases))
    steps = Steps(len(counts) + request.runs)
    with contextlib.ExitStack() as stack:
        stack.callback(steps.close)
        groups = []
        for some in (aliases[:count] for count in counts):
            session = Session(",".join(some), settings, kernel_cache_folder())
            stack.callback(session.close)
            groups.append(_DeviceGroup(aliases=some, session=session))
        for group in groups:
            steps.begin(f"{group.name}: first render")
            rendered = group.render(scene, settings, films)
            film = film or rendered
            del rendered
            steps.end()
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            for group in groups[:: -1 if run % 2 else 1]:
                group.render(scene, settings, films)
            steps.end()
    assert film is not None
    one = groups[0]
    return {
        **scene_report(dataclasses.replace(opened, scene=scene), one.runs[-1]),
        "several": [group.report(one) for group in groups],
        "films": films.report(),
    }, film
