"""The streaming schedule: whole renders, beside the wavefront's, with rays that wait and rays that do not."""

from __future__ import annotations

from studies.streaming.cases import cases, measure
from studies.streaming.results import draw, fragment
from studies.study import Study

STUDY = Study(
    "streaming",
    "the streaming schedule beside the wavefront, in whole renders, batched and not",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 3),
)
