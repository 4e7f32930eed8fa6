"""Seconds of the thesis's figures and of ours, by what was rendered."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from studies.bench import whole_seconds
from studies.study import Report, Row

FIGURES = Path(__file__).resolve().parents[3] / "docs/studies/data/thesis-figures.json"


def figures() -> dict[str, Any]:
    """The thesis's own, by table."""
    return json.loads(FIGURES.read_text(encoding="utf-8"))["tables"]


def key_of(row: Row, names: Sequence[str]) -> tuple:
    """Values of a row in the columns `names`: no other row of its table has the same."""
    return tuple(row[name] for name in names)


COLUMNS = {
    "initial": ("scene", "sample_order", "ray_storage", "treelet_size", "ray_count"),
    "ray_count": ("scene", "ray_count"),
    "queue_size": ("scene", "ray_storage", "queue_size"),
}


def seconds_by_key(report: Report, name: str) -> dict[tuple, tuple[float | None, bool]]:
    """Median seconds of a whole render, and whether it is an estimate, by the key of a row of the thesis (`key_of`)."""
    found: dict[tuple, list[tuple[float, bool]]] = {}
    for row in report["rows"]:
        if row["table"] == name:
            seconds = whole_seconds(row)
            key = found.setdefault(key_of(row, COLUMNS[name]), [])
            if seconds is not None:
                key.append((seconds, not row["complete"]))
    return {
        key: (statistics.median(s for s, _ in rows), any(e for _, e in rows)) if rows else (None, True)
        for key, rows in found.items()
    }


def control_seconds(report: Report, scene: str) -> float | None:
    """Median of the control over all groups."""
    found = [
        row["seconds"]
        for row in report["rows"]
        if row["table"] == "control" and row["scene"] == scene and row["complete"]
    ]
    return statistics.median(found) if found else None


def most_alive(report: Report) -> int | None:
    """How many rays were alive at most, where some cases asked for more than there are in the tiles at work."""
    reported = [
        (row["ray_count"], row["rays_alive"])
        for row in report["rows"]
        if row["table"] == "ray_count" and row.get("rays_alive")
    ]
    return max(alive for _, alive in reported) if any(alive < asked for asked, alive in reported) else None
