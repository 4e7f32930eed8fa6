"""Many schedules on each of some scenes, and the report of what came of them."""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarking.tables import table
from lib.command import UsageError
from rendering.standalone import resized

from checking.films import FilmComparer
from checking.schedules import NOT_DRAWN, SeededDraws
from raybatch_addon.core.bvh.pages.file import delete_old_files
from raybatch_addon.core.device.devices import device_description
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings, parse_setting

PROGRESS_SECONDS = 5.0  # between lines where standard error is no terminal
PAGE_FILES_MOST = 1 << 30  # that are kept at a time [bytes]
FAULTS_MOST = 8  # of a scene, before the next one is begun


@dataclass(frozen=True, kw_only=True)
class ScheduleRequest:
    """One call of check_schedules.py."""

    scenes: tuple[Path, ...]
    device: str = "AUTO"
    count: int = 200
    first: int = 0
    seed: int = 1
    size: int = 64
    samples: int = 2
    bounces: int | None = None
    turns: int = 24
    fixed: tuple[str, ...] = ()  # NAME=VALUE
    kernel_cache: str | None = None


class ProgressLine:
    """Where things stand: one line that changes on a terminal, and one now and then elsewhere."""

    def __init__(self) -> None:
        self._terminal, self._shown, self._began = sys.stderr.isatty(), 0.0, time.perf_counter()

    def show(self, text: str, always: bool = False) -> None:
        """Show `text`, if it is time."""
        now = time.perf_counter()
        if always or self._terminal or now - self._shown >= PROGRESS_SECONDS:
            self._shown = now
            start, end = ("\r\033[K", "") if self._terminal and not always else ("", "\n")
            print(f"{start}[{now - self._began:.0f} s] {text}", end=end, file=sys.stderr, flush=True)


def check_schedules(request: ScheduleRequest) -> dict[str, Any]:
    """The report; raises `RayBatchError` for what the user can mend."""
    fixed = _fixed(request.fixed)
    scenes = [_scene(path, request) for path in request.scenes]
    line, began = ProgressLine(), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="raybatch-pages-") as pages:
        session = Session(request.device, cache_folder=request.kernel_cache, page_folder=pages)
        try:
            reports = [
                _check(session, Path(pages), path, *scene, fixed, request, line)
                for path, scene in zip(request.scenes, scenes)
            ]
        finally:
            session.close()
    return {
        "device": device_description(session.device),
        "versions": versions(),
        "seed": request.seed,
        "fixed": fixed,
        "scenes": reports,
        "compared": sum(each["compared"] for each in reports),
        "faults": sum(len(each["faults"]) for each in reports),
        "seconds": round(time.perf_counter() - began, 3),
    }


def _check(
    session: Session,
    pages: Path,
    path: Path,
    scene: Scene,
    estimator: RenderSettings,
    fixed: dict[str, Any],
    request: ScheduleRequest,
    line: ProgressLine,
) -> dict[str, Any]:
    start = time.perf_counter()
    line.show(f"{path.name}: the plain film", always=True)
    comparer = FilmComparer(session, scene, estimator, request.turns)
    methods: Counter[str] = Counter()
    faults: list[dict[str, Any]] = []
    compared = raised = rays = 0
    for number in range(request.first, request.first + request.count):
        line.show(f"{path.name}: schedule {number - request.first + 1} of {request.count}, {len(faults)} faults")
        found = comparer.compare_drawn(SeededDraws(request.seed, number), fixed, keep_errors=True)
        compared += 1
        raised += found.raised > 0
        methods[found.method] += 1
        rays += found.statistics.get("rays", {}).get("total", 0)
        if found.differs:
            fault = {
                "number": number,
                "differs": found.differs,
                "region": list(found.region),
                "rays_few": found.rays_few,
                "settings": found.settings,
            }
            if not faults:
                fault["simplest"] = comparer.simplest(found)
                line.show(
                    f"{path.name}: schedule {number}: {'; '.join(found.differs)}\n{json.dumps(fault, indent=2)}",
                    always=True,
                )
            faults.append(fault)
            if len(faults) == FAULTS_MOST:
                line.show(f"{path.name}: {FAULTS_MOST} faults, the other schedules are left out", always=True)
                break
        delete_old_files(pages, None, PAGE_FILES_MOST)
    return {
        "scene": path.name,
        "triangles": comparer.sizes.triangles,
        "frame": [scene.frame.width, scene.frame.height],
        "samples": estimator.sample_count,
        "bounce_max": estimator.bounce_max,
        "compared": compared,
        "methods": dict(methods),
        "budgets_raised": raised,
        "rays": rays,
        "faults": faults,
        "seconds": round(time.perf_counter() - start, 3),
    }


def _scene(path: Path, request: ScheduleRequest) -> tuple[Scene, RenderSettings]:
    """The scene, smaller, and its estimator settings alone."""
    if not path.name.endswith(".scene.npz"):
        raise UsageError(f"{path} cannot be checked: give a scene that render.py --save-scene wrote (.scene.npz)")
    scene, own = load_scene(path)
    estimator = {name: getattr(own, name) for name, info in SETTINGS.items() if info.effect == "estimator"}
    estimator["sample_count"] = request.samples
    if request.bounces is not None:
        estimator["bounce_max"] = parse_setting("bounce_max", str(request.bounces))
    width, height = scene.frame.width, scene.frame.height
    longer = max(width, height)
    scene = resized(scene, max(1, round(width * request.size / longer)), max(1, round(height * request.size / longer)))
    passes = dict.fromkeys((*scene.frame.passes, "Combined", "Depth", "Normal", "Position"))
    return dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=tuple(passes))), RenderSettings(
        **estimator
    )


def _fixed(texts: tuple[str, ...]) -> dict[str, Any]:
    fixed = {}
    for text in texts:
        name, _, value = text.partition("=")
        fixed[name] = parse_setting(name, value)
        if SETTINGS[name].effect != "schedule" or name in NOT_DRAWN:
            raise UsageError(f"--set {text}: {name} is not drawn; name a setting that changes time alone")
    return fixed


def _figures(scene: dict[str, Any]) -> list[int]:
    methods = [scene["methods"].get(method, 0) for method in ("unbatched", "batched", "paged")]
    return [
        scene["triangles"],
        scene["compared"],
        *methods,
        scene["budgets_raised"],
        scene["rays"],
        len(scene["faults"]),
    ]


def report_text(report: dict[str, Any]) -> str:
    """The report as a person reads it."""
    rows = [
        [each["scene"], "", *(f"{number:,}" for number in _figures(each)), f"{each['seconds']:.0f}"]
        for each in report["scenes"]
    ]
    head = [
        "scene",
        "",
        "triangles",
        "schedules",
        "unbatched",
        "batched",
        "paged",
        "budget raised",
        "rays",
        "faults",
        "seconds",
    ]
    return f"{report['device']['name']}: {report['compared']:,} schedules, {report['faults']:,} faults\n" + table(
        head, rows
    )
