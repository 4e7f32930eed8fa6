"""Many workers: parts of a render on a cluster, measured, and what a simulation makes of them for hundreds of GPUs."""

from __future__ import annotations

from studies.many_workers.parts import cases, measure
from studies.many_workers.results import draw, fragment
from studies.study import Study

STUDY = Study(
    "many-workers",
    "8, 64 and 512 GPUs of a cluster, simulated from measured parts: efficiency, and what limits it",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 3),
)
