"""Renders of one kind among others that take turns with it, and what they reported."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarking.timing import summary
from benchmarking.whole_render import TimedRender
from raybatch_addon.core.film.layout import COST_PASSES
from raybatch_addon.core.scene.description import Scene


@dataclass
class TimedRuns:
    """The first render and those that are timed."""

    first: dict[str, Any] = field(default_factory=dict)  # statistics of the first one
    runs: list[dict[str, Any]] = field(default_factory=list)  # of the timed ones
    seconds: list[float] = field(default_factory=list)  # of those, as a whole

    def take(self, timed: TimedRender) -> None:
        """A timed render; its film is not kept."""
        self.seconds.append(timed.seconds)
        self.runs.append(timed.film.statistics)

    def stage_seconds(self, stage: str) -> list[float]:
        """Of the timed ones."""
        return [run["seconds"][stage] for run in self.runs]

    def times(self) -> dict[str, Any]:
        """Of the first render, of whole renders, of trees and of rendering."""
        return {
            "first": {"seconds": round(self.first["seconds"]["total"], 3), "stages": self.first["seconds"]},
            "whole": summary(self.seconds),
            **{stage: summary(self.stage_seconds(stage)) for stage in ("build", "render")},
        }


def times_as_fast(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """How many times as fast `ours` are, the median over turns; 0 where they took no time."""
    return round(statistics.median(b / a if a else 0.0 for a, b in zip(ours, theirs, strict=True)), 4)


def without_cost(scene: Scene) -> Scene:
    """`scene` without passes that show cost: they differ between schedules, and are counted."""
    frame = scene.frame
    passes = tuple(name for name in frame.passes if name not in COST_PASSES)
    return dataclasses.replace(scene, frame=dataclasses.replace(frame, passes=passes))
