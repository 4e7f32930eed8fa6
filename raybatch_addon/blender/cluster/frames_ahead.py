"""The next frame of an animation, read and begun while the last one is rendered, so that no worker of a cluster waits.

Blender asks for frames one after the other, and evaluates the next one when the last one is in its result. But it lets
an engine step to other times, for motion blur; so the next frame is read from there, and Blender gets its own back. It
is evaluated more often for that, and rendered ahead where that takes less than it saves.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import bpy

from ...core.film import Film
from ...core.measure.parts import Parts
from ...core.scene.description import Scene
from ...core.settings.settings import RenderSettings

if TYPE_CHECKING:
    from ...core.cluster.session import ClusterSession, PendingFilm


@dataclass
class ReadFrame:
    """A frame that was read, and how long that took."""

    scene: Scene
    settings: RenderSettings
    parts: Parts
    pending: PendingFilm | None = None  # where it was begun
    export_seconds: float = field(init=False)

    def __post_init__(self) -> None:
        self.export_seconds = self.parts.elapsed


# By job and view layer: the number of the frame, and that
_ahead: dict[tuple[int, str], tuple[int, ReadFrame]] = {}
_job = 0  # of which is known:
_evaluating, _rendering = 0.0, float("inf")  # what a step to the next frame and back took, and a frame the workers [s]


def take(job: int, layer: str, number: int) -> ReadFrame | None:
    """Frame `number` of a view layer in Blender's render `job`, if it was begun ahead."""
    global _job, _evaluating, _rendering
    for key in [key for key in _ahead if key[0] != job]:
        _drop(key)
    if job != _job:  # nothing is known of another animation
        _job, _evaluating, _rendering = job, 0.0, float("inf")
    at, frame = _ahead.pop((job, layer), (number, None))
    if frame is not None and at != number:
        cancel(frame)
        return None
    return frame


def cancel(frame: ReadFrame) -> None:
    """Nobody wants its film, if it is not there yet."""
    if frame.pending is not None:
        frame.pending.cancel()


def drop_all() -> None:
    """Nothing that was begun ahead is wanted."""
    for key in [*_ahead]:
        _drop(key)


def begin_next(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    session: ClusterSession,
    job: int,
    begin: Callable[[], ReadFrame | None],
) -> None:
    """Have `begin` called at the next frame of the animation, if there is one and it is worth it. What is wrong with it
    is said when it is its turn.
    """
    global _evaluating
    scene, layer = depsgraph.scene, depsgraph.view_layer.name
    number = scene.frame_current
    following = number + scene.frame_step
    if not engine.is_animation or following > scene.frame_end or not session.has_room or not is_worth_it():
        return
    begun, reading = time.perf_counter(), 0.0
    try:
        engine.frame_set(following, 0.0)
        at = time.perf_counter()
        frame = begin()
        reading = time.perf_counter() - at
        if frame is not None:
            _ahead[job, layer] = following, frame
    except Exception:  # also where the cluster was lost
        pass
    finally:
        engine.frame_set(number, 0.0)
        _evaluating = time.perf_counter() - begun - reading


def is_worth_it() -> bool:
    """Whether a frame takes the workers longer than stepping to the next one and back takes here."""
    return _rendering > _evaluating


def note_film(film: Film) -> None:
    """What the last frame took its workers."""
    global _rendering
    shares: list[dict[str, Any]] = film.statistics.get("cluster", {}).get("shares", [])
    if shares:
        _rendering = sum(each["seconds"] for each in shares) / len({each["worker"] for each in shares})


def _drop(key: tuple[int, str]) -> None:
    cancel(_ahead.pop(key)[1])
