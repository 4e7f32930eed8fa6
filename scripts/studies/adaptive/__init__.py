"""Adaptive sampling: cost to the same error with pixels that end by their noise, and how dark rules to end them are."""

from __future__ import annotations

from studies.adaptive.thresholds import cases, draw, fragment, measure
from studies.study import Study

STUDY = Study(
    "adaptive",
    "adaptive sampling: samples and time to the same error, and how dark it makes pictures",
    cases,
    measure,
    fragment,
    draw,
    turns=(2, 2),
)
