"""Whole renders with a part of the geometry on the device, beside the same render with all of it there."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

from lib.command import UsageError

from benchmarking.against.films import FilmsCompared
from benchmarking.against.runs import TimedRuns, times_as_fast, without_cost
from benchmarking.progress import Steps
from benchmarking.whole_render import OpenedScene, RenderRequest, scene_report, timed_render
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings, parse_setting

MEMORY = "memory"  # the render with all geometry there, by name
# What a render in pages reports of itself
_PAGING = (
    "bytes_copied",
    "pages_loaded",
    "pages_evicted",
    "resident_peak",
    "rays_queued",
    "rays_queued_per_ray",
    "treelet_visits_per_ray",
    "steps",
)


@dataclass(frozen=True)
class GeometryBudget:
    """How much of the geometry may be on the device."""

    text: str  # as it was asked for
    bytes: int | None  # None: a share
    share: float | None = None  # of what tree and triangles take in memory

    def of(self, geometry_bytes: int) -> int:
        """The budget for geometry that takes `geometry_bytes` [bytes]."""
        return self.bytes if self.bytes is not None else max(1, int(self.share * geometry_bytes))


def parse_budgets(text: str) -> list[GeometryBudget]:
    """Budgets such as `1.5G,700M` (bytes) or `10%,5%` (of the geometry), each once; raises `UsageError`."""
    return list(dict.fromkeys(_parse_budget(part.strip()) for part in text.split(",")))


def _parse_budget(text: str) -> GeometryBudget:
    complaint = UsageError(
        f"--budgets {text!r} is not valid: give bytes above 0, such as 1.5G or 512Mi, or a share of the geometry, such "
        "as 10%"
    )
    try:
        if not text.endswith("%"):
            found = GeometryBudget(text, parse_setting("geometry_budget", text))
        else:
            found = GeometryBudget(text, None, float(text[:-1]) / 100)
    except (ValueError, SettingsError):
        raise complaint from None
    if not (found.bytes or 0 < (found.share or 0) < 1):
        raise complaint
    return found


@dataclass
class _Variant(TimedRuns):
    """One way to render."""

    name: str = ""
    settings: RenderSettings = field(default_factory=RenderSettings)
    stages: dict[str, float] | None = None  # by stage, of a render with counters [s]

    def report(self) -> dict[str, Any]:
        """Times, and what is reported for the last run."""
        reported, times = self.runs[-1], self.times()
        seconds = times["render"]["seconds"]
        return {
            **times,
            "rays_per_second": round(reported["rays"]["total"] / seconds) if seconds else 0,
            "schedule": reported["schedule"],
            "auto": reported["auto"],
            "tree": reported["tree"],
            "stages": self.stages,
            "warnings": reported["warnings"],
        }


def check_settings(changes: dict[str, Any], settings: RenderSettings) -> None:
    """Raise `UsageError` where `changes`, those of the command line, or the `settings` that came of them leave nothing
    to compare.
    """
    if changes.get("geometry_budget"):
        raise UsageError("geometry_budget is what --budgets is for: leave it out of --set")
    if changes.get("counters") == "ON":
        raise UsageError(
            "counters would make the timed runs slower, and are told from runs of their own: leave them out of --set"
        )
    if settings.batching in ("OFF", "REFERENCE"):
        raise UsageError(
            f"batching is {settings.batching}, and within --budgets rays must wait: --set batching=AUTO or ON (the "
            "render in memory is OFF anyway)"
        )


def measure_against_memory(
    session: Session,
    opened: OpenedScene,
    settings: RenderSettings,
    request: RenderRequest,
    budgets: list[GeometryBudget],
) -> tuple[dict[str, Any], Film]:
    """The report of `benchmark.py render --against memory`, and the film in memory; raises `RayBatchError`.

    Films that differ are in the report, under `films`. Every timed render builds its tree anew; one in pages opens
    the file of an earlier one where geometry lies on disk.
    """
    check_settings(request.settings, settings)
    scene = without_cost(opened.scene)
    films = FilmsCompared()
    plain = settings.replace(geometry_budget=0, counters="OFF")
    count = 1 + len(budgets)
    steps = Steps(count * (1 + request.counters) + request.runs)
    try:
        begun = functools.partial(_begun, session, scene, films=films, counters=request.counters, steps=steps)
        whole, film = begun(MEMORY, plain.replace(batching="OFF"))
        if not whole.first["tree"]:
            raise UsageError(f"{request.scene.path} has no triangles that could lie elsewhere")
        geometry_bytes = whole.first["tree"]["bytes"]
        variants = [whole]
        for budget in budgets:
            limited = plain.replace(geometry_budget=budget.of(geometry_bytes))
            variants.append(begun(budget.text, limited, geometry_bytes=geometry_bytes)[0])
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            for variant in variants:
                timed = timed_render(session, scene, variant.settings)
                variant.take(timed)
                films.take(variant.name, timed.film)
                del timed  # with what it holds on the device
            steps.end()
    finally:
        steps.close()
    return {
        **scene_report(opened, whole.runs[-1]),
        "geometry_bytes": geometry_bytes,
        MEMORY: whole.report(),
        "budgets": [_limited_report(variant, whole) for variant in variants[1:]],
        "films": films.report(),
    }, film


def _begun(
    session: Session,
    scene: Scene,
    name: str,
    settings: RenderSettings,
    *,
    films: FilmsCompared,
    counters: bool,
    steps: Steps,
    geometry_bytes: int = 0,
) -> tuple[_Variant, Film]:
    """A variant after its first render, with compilation, and one with counters, which takes over the tree; and the
    first's film.

    `geometry_bytes`: what a budget is a part of; 0: there is none. Raises `UsageError` for one that holds everything.
    """
    steps.begin(f"{name}: first render, with compilation")
    film = timed_render(session, scene, settings).film
    steps.end()
    variant = _Variant(film.statistics, name=name, settings=settings)
    films.take(name, film)
    if geometry_bytes and "pages" not in film.statistics["tree"]:
        raise UsageError(
            f"--budgets {name} holds all of the geometry ({geometry_bytes:,} bytes), so no ray would wait: give less"
        )
    if counters:
        steps.begin(f"{name}: counters")
        counted = session.render(scene, settings.replace(counters="ON"))
        variant.stages = counted.statistics["counters"]["seconds"]
        films.take(f"{name}, with counters", counted)
        steps.end()
    return variant, film


def _limited_report(variant: _Variant, whole: _Variant) -> dict[str, Any]:
    reported = variant.runs[-1]

    return {
        "budget": variant.name,
        "geometry_budget": variant.settings.geometry_budget,
        **variant.report(),
        # of the render in memory, without trees: 1 is as fast
        "speed": times_as_fast(variant.stage_seconds("render"), whole.stage_seconds("render")),
        "speed_whole": times_as_fast(variant.seconds, whole.seconds),
        **{name: reported["batching"][name] for name in _PAGING},
    }
