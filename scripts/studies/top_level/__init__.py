"""The top level: what it saves in nodes that warps read, and what it costs, if the rays of a warp go together."""

from __future__ import annotations

from studies.study import Study
from studies.top_level.cases import cases, measure
from studies.top_level.results import draw, fragment

STUDY = Study(
    "top-level",
    "how the rays of a warp go through the top level: nodes that warps read, turns, and waits, on emulated warps",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 1),
)
