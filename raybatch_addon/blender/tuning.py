"""A render that tries schedules instead of making a picture: asked for by the panel, and what came of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from ..core.film import Film
from ..core.observers import Progress
from ..core.scene.description import Scene
from ..core.settings.settings import RenderSettings
from ..core.tuning import Tuning, tune
from .devices import device_choices
from .sessions import session_for


@dataclass(frozen=True)
class Tuned:
    """The result of a tuning, and the scene that it was for."""

    scene: str
    tuning: Tuning


@dataclass
class _Request:
    """A request that the next render try schedules."""

    scene: str
    seconds: float  # for a candidate
    has_begun: bool = False  # Blender's render, of one view layer after another
    is_over: bool = False  # all was tried: other view layers have nothing to do


_request: _Request | None = None
_last: Tuned | None = None


def ask_for_tuning(scene: str, seconds: float) -> None:
    """The next render tries schedules on `scene`, each for some `seconds`."""
    global _request
    _request = _Request(scene, seconds)


def withdraw_tuning(*_: object) -> None:
    """The next render is a picture again."""
    global _request
    _request = None


def begin_tuning(*_: object) -> None:
    """A render begins: what another one was asked for is over, however that ended."""
    if _request is not None and _request.has_begun:
        withdraw_tuning()
    elif _request is not None:
        _request.has_begun = True


def is_tuning() -> bool:
    """Whether the render under way is one of these."""
    return _request is not None


def last_tuned() -> Tuned | None:
    """What was tried last, as far as that is."""
    return _last


def forget_tuned() -> None:
    """Forget it."""
    global _last
    _last = None
    withdraw_tuning()


def run_tuning(
    scene: Scene, settings: RenderSettings, cancelled: Callable[[], bool], show: Callable[[str], None]
) -> Film | None:
    """Try schedules on `scene`; returns the film of the given settings, None where it was stopped before there was one.
    Raises `RayBatchError`.
    """
    global _last
    request = _request
    if request is None or request.is_over:
        return None
    request.is_over = True
    tried = "the settings as they are"

    def render(candidate: RenderSettings, ends: Callable[[], bool], look: Callable[[Progress], None]) -> Film:
        def on_progress(progress: Progress) -> None:
            look(progress)
            show(f"Tune: {tried}: {progress.message or progress.stage}")

        with session_for(candidate, ends) as session:
            if session is None:
                return dataclasses.replace(Film.empty(scene.frame), complete=False)
            return session.render(scene, candidate, on_progress=on_progress, cancelled=ends)

    def on_trial(tuning: Tuning, following: str) -> None:
        global _last
        nonlocal tried
        _last, tried = Tuned(request.scene, tuning), following or tried

    devices = _other_devices(settings)
    tuning, film = tune(settings, devices, render, request.seconds, cancelled=cancelled, on_trial=on_trial)
    _last = Tuned(request.scene, tuning)
    return film


def _other_devices(settings: RenderSettings) -> list[str]:
    """Devices that would not render now: an empty list where they are not known yet."""
    known = [each.name for each in device_choices() or () if each.name != "AUTO"]
    cuda = [name for name in known if name != "cpu"]
    named = settings.device.lower().split(",")
    if named == ["all"]:
        return ["cpu"] if cuda else []
    now = {each.strip() for each in named} if named != ["auto"] else {(cuda or ["cpu"])[0]}
    return [name for name in known if name not in now]
