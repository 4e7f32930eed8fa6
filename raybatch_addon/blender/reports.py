"""Reports of the last render, for the panel and for scripts."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import Any


@dataclass
class RenderReport:
    """One frame of one scene."""

    scene: str
    frame: int
    _: KW_ONLY
    job: int = 0  # number of Blender's render that it belongs to
    errors: list[str] = field(default_factory=list)  # the render failed
    interrupted: bool = False  # by Ctrl-C
    refused: bool = False  # it would have lacked what it may not lack
    warnings: list[str] = field(default_factory=list)  # it went on
    export_seconds: float = 0.0  # of the last view
    statistics: dict[str, dict[str, Any]] = field(default_factory=dict)  # by view layer, as documented for `--json`


_last: RenderReport | None = None


def begin(scene: str, frame: int, job: int = 0) -> RenderReport:
    """Start the report of a new frame; it is the last one from now on."""
    report = RenderReport(scene, frame, job=job)
    set_last(report)
    return report


def set_last(report: RenderReport) -> None:
    """It is the last one from now on."""
    global _last
    _last = report


def last() -> RenderReport | None:
    """The report of the newest render of this Blender, finished or not."""
    return _last


def clear() -> None:
    """Forget it."""
    global _last
    _last = None
