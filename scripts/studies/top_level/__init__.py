"""The top level: what it saves in nodes that warps read, and what it costs, if the rays of a warp go together."""

from __future__ import annotations

from studies.study import Study
from studies.top_level.cases import cases, measure
from studies.top_level.results import draw, fragment

STUDY = Study(
    "top-level",
    "how the rays of a warp go through the top level: nodes that emulated warps read, turns, waits; on a GPU rates",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 1),
)
