"""The checks of everything.py: how each is run, and how its report is counted."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Counts = dict[str, Any]  # passed, failed, skipped, and the names of failures


@dataclass(frozen=True)
class Check:
    """One script; `work` is the folder for its files."""

    about: str
    arguments: Callable[[Path], list[str]]
    counts: Callable[[Path], Counts]
    prepare: Callable[[Path], None] = lambda work: None


def _counts(passed: int, failures: list[str], skipped: int = 0) -> Counts:
    return {"passed": passed, "failed": len(failures), "skipped": skipped, "failures": failures}


def suite_counts(work: Path) -> Counts:
    """Counts of pytest's JUnit file."""
    passed, skipped, failures = 0, 0, []
    for each in ElementTree.parse(work / "suite.xml").iter("testcase"):
        children = {child.tag for child in each}
        if children & {"failure", "error"}:
            failures.append(f"{each.get('classname')}::{each.get('name')}")
        elif "skipped" in children:
            skipped += 1
        else:
            passed += 1
    return _counts(passed, failures, skipped)


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def stability_counts(work: Path) -> Counts:
    """Counts of runs: a case with one tracer."""
    report = _read(work / "stability.json")
    failures = [f"{each['name']} ({each['tracer']})" for each in report["cases"] if not each["passed"]]
    return _counts(report["passed"], failures, len(report["skipped"]))


def parity_counts(work: Path) -> Counts:
    """Counts of features; those out of bounds, or not supported, failed."""
    report = _read(work / "parity.json")
    failures = [f"{each['name']}: {each['status']}" for each in report["features"] if each["status"] != "ok"]
    return _counts(report["counts"]["all"]["ok"], failures)


def tracing_counts(work: Path) -> Counts:
    """Counts of the report's checks, each over all rays."""
    report = _read(work / "tracing.json")
    failures = [name for name, each in report["checks"].items() if each["failures"]]
    if report["leaks"] and report["leaks"]["escapes"]:
        failures.append("leaks")
    checks = len(report["checks"]) + bool(report["leaks"])
    return _counts(checks - len(failures), failures)


def schedules_counts(work: Path) -> Counts:
    """Counts of films."""
    report = _read(work / "schedules.json")
    return _counts(report["compared"] - report["faults"], ["a film differs"] * report["faults"])


def site_counts(work: Path) -> Counts:
    """Counts of the site's pages; whether all of their links lead somewhere is in the exit code."""
    return _counts(len(list((work / "site").rglob("*.html"))), [])


def _save_mesh(work: Path) -> None:
    import numpy as np

    from tests.support import scenes

    ball = scenes.sphere(segments=96, rings=48)
    np.savez(work / "ball.npz", v=ball.positions, f=ball.triangles)


def _save_scenes(work: Path) -> None:
    from raybatch_addon.core.scene.archive import save_scene
    from raybatch_addon.core.settings.settings import RenderSettings
    from tests.support.schedule_scenes import SCENES

    for name, make in SCENES.items():
        save_scene(work / f"{name}.scene.npz", make(), RenderSettings(bounce_max=5))


def _saved_scenes(work: Path) -> list[str]:
    from tests.support.schedule_scenes import SCENES

    return [str(work / f"{name}.scene.npz") for name in SCENES]


CHECKS = {
    "suite": Check(
        "all tests, thorough ones too",
        lambda work: [
            *("-m", "pytest", "-n", "auto", "--maxprocesses", "4", "--dist", "loadfile", "--no-loadscope-reorder"),
            "--thorough",
            f"--junitxml={work / 'suite.xml'}",
        ],
        suite_counts,
    ),
    "stability": Check(
        "all cases of stability, with each tracer",
        lambda work: ["scripts/stability.py", "--device", "cpu", "--json", str(work / "stability.json")],
        stability_counts,
    ),
    "parity": Check(
        "all features of parity",
        lambda work: [*("scripts/parity.py", "--strict", "--json", str(work / "parity.json")), *("--out", str(work))],
        parity_counts,
    ),
    "tracing": Check(
        "check_tracing, 200,000 rays and 100,000 from inside",
        lambda work: [
            *("scripts/check_tracing.py", "--scene", str(work / "ball.npz"), "--device", "cpu"),
            *("--rays", "2e5", "--leak-rays", "1e5", "--json", str(work / "tracing.json")),
        ],
        tracing_counts,
        _save_mesh,
    ),
    "schedules": Check(
        "check_schedules, 40 schedules a scene",
        lambda work: [
            *("scripts/check_schedules.py", "--scene", *_saved_scenes(work), "--device", "cpu"),
            *("--count", "40", "--json", str(work / "schedules.json")),
        ],
        schedules_counts,
        _save_scenes,
    ),
    "site": Check(
        "the site of the documents, its links and pictures",
        lambda work: ["scripts/docs_site/build.py", str(work / "site")],
        site_counts,
    ),
}
