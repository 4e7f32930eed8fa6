"""Schedulers: every way in which rays may wait, beside the default and beside rays that do not."""

from __future__ import annotations

from studies.schedulers.cases import cases, measure
from studies.schedulers.results import draw, fragment
from studies.study import Study

STUDY = Study(
    "schedulers",
    "every way in which rays may wait: buckets, several queues a ray, tiers, caches, pages, sizes of treelets",
    cases,
    measure,
    fragment,
    draw,
    turns=(1, 3),
)
