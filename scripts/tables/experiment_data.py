"""Data of docs/experiments, and the names that its plots and tables give to tracers and rays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "docs/experiments"
NAMES = {
    "off": "RayBatch",
    "off-plain": "RayBatch, plain",
    "off-sorted": "RayBatch, sorted",
    "reference": "Warp's tree",
    "embree": "Embree",
    "embree-robust": "Embree, robust",
}
RAYS = {"primary": "camera", "bounce1": "bounce 1", "bounce4": "bounce 4", "shadow1": "shadow 1"}
PLAIN, REFILL = "plain, all triangles a turn", "refill 4"


def load(pattern: str) -> dict[str, dict[str, Any]]:
    """Data by the file's name without its ending, in the order of names."""
    found = {}
    for path in sorted((FOLDER / "data").glob(pattern)):
        reported = json.loads(path.read_text(encoding="utf-8"))
        found[path.stem] = reported[0] if isinstance(reported, list) else reported
        if "-unsplit-" in path.stem:
            found[path.stem]["scene"] += ", no splits"
    return found


def title(report: dict[str, Any]) -> str:
    """A scene's name, as it stands over plots and in tables."""
    name = report["scene"].replace(".scene.npz", "").replace(".npz", "")
    return name[0].upper() + name[1:]


def cases(report: dict[str, Any]) -> dict[tuple[str, str, int | None], dict[str, dict[str, Any]]]:
    """Results by (rays, order, threads) and tracer."""
    found: dict[tuple[str, str, int | None], dict[str, dict[str, Any]]] = {}
    for result in report["results"]:
        found.setdefault((result["rays"], result["order"], result["threads"]), {})[result["tracer"]] = result
    return found


def rate_text(rate: float | None) -> str:
    """Mrays/s, with three digits or more; with two where it is small."""
    return (
        ""
        if rate is None
        else f"{rate:.0f}"
        if rate >= 100
        else f"{rate:.1f}"
        if rate >= 10
        else f"{rate:.2f}"
        if rate >= 0.1
        else f"{rate:.2g}"
    )
