"""The thesis's three tables on our tracer: its 96 combinations of parameters, its numbers of rays alive, its sizes of
queues.
"""

from __future__ import annotations

from studies.study import Study
from studies.thesis.cases import cases, measure
from studies.thesis.plots import draw
from studies.thesis.tables import fragment

STUDY = Study(
    "thesis",
    "the thesis's three tables (96 combinations, rays alive, sizes of queues) on our tracer, beside its figures",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 3),
)
