"""All studies by name."""

from __future__ import annotations

import difflib

from lib.command import UsageError

from studies import (
    adaptive,
    batching,
    budgets,
    cycles,
    hardware,
    light_sampling,
    many_lights,
    many_workers,
    schedulers,
    sequences,
    streaming,
    thesis,
    top_level,
)
from studies.images import environment, image_budgets, textures
from studies.motion import trees_over_time
from studies.study import Study

STUDIES: dict[str, Study] = {
    each.name: each
    for each in (
        thesis.STUDY,
        batching.STUDY,
        light_sampling.STUDY,
        many_lights.STUDY,
        many_workers.STUDY,
        environment.STUDY,
        sequences.STUDY,
        adaptive.STUDY,
        textures.STUDY,
        image_budgets.STUDY,
        budgets.STUDY,
        trees_over_time.STUDY,
        hardware.STUDY,
        top_level.STUDY,
        schedulers.STUDY,
        streaming.STUDY,
        cycles.STUDY,
    )
}


def study_named(name: str) -> Study:
    """The study; raises `UsageError` with the closest name."""
    if name in STUDIES:
        return STUDIES[name]
    close = difflib.get_close_matches(name, STUDIES)
    hint = f"did you mean {close[0]}? " if close else ""
    raise UsageError(f"there is no study {name!r}; {hint}the studies are {', '.join(STUDIES)}")
