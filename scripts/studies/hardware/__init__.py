"""Hardware: what the policies of ray tracing hardware would save in memory traffic, simulated on our rays and tree."""

from __future__ import annotations

from studies.hardware.cases import cases, measure
from studies.hardware.results import draw, fragment
from studies.study import Study

STUDY = Study(
    "hardware",
    "policies of ray tracing hardware, simulated on our rays and tree: bytes from memory and the L2",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 1),
)
