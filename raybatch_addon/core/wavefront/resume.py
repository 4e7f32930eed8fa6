"""What goes on when a stopped render is resumed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ..errors import RayBatchError
from ..film import Film
from ..scene.description import Frame
from ..settings import SETTINGS, RenderSettings
from .integrator import TileState


@dataclass
class ResumeState:
    """What goes on when a stopped render is resumed."""

    tiles: list[TileState]
    sample_first: int
    sample_count: int
    sample_order: str
    estimator: dict[str, Any]  # the settings that the film depends on


def film_to_fill(frame: Frame, settings: RenderSettings, sample_first: int, resume: Film | None) -> Film:
    """An empty film, or a copy of the one to go on with; raises `RayBatchError` for a film that cannot be gone on with."""
    empty = Film.empty(frame)
    if resume is None:
        return empty
    if resume.complete:
        raise RayBatchError("this film is complete: there is nothing to resume; to add samples, render a range with sample_first and merge")
    if resume.resume_state is None:
        raise RayBatchError("this film cannot be resumed: rays were given up when it was cancelled; render it again")
    state = resume.resume_state
    if state.sample_first != sample_first or state.estimator != estimator_settings(settings):
        raise RayBatchError("this film was begun with other settings or another range of samples; resume it with the same ones")
    film = resume.merge(empty)
    film.resume_state = dataclasses.replace(state, tiles=[dataclasses.replace(tile) for tile in state.tiles])
    return film


def estimator_settings(settings: RenderSettings) -> dict[str, Any]:
    """The settings that change the film."""
    return {name: getattr(settings, name) for name, info in SETTINGS.items() if info.effect == "estimator"}
