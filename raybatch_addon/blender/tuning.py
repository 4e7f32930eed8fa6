"""A render that tries schedules instead of making a picture: asked for by the panel, and what came of it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """What came of the last one."""

    scene: str
    tuning: Tuning


_lock = threading.Lock()
_asked: tuple[str, float] | None = None  # the scene's name, and seconds for a candidate
_last: Tuned | None = None


def ask_for_tuning(scene: str, seconds: float) -> None:
    """The next render tries schedules on `scene`, each for some `seconds`."""
    global _asked
    with _lock:
        _asked = (scene, seconds)


def withdraw_tuning() -> None:
    """The next render is a picture again."""
    global _asked
    with _lock:
        _asked = None


def is_tuning() -> bool:
    """Whether the render under way is one of these."""
    return _asked is not None


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
    with _taken() as (name, seconds):
        tried = "the settings as they are"

        def render(candidate, ends, look) -> Film:
            def on_progress(progress: Progress) -> None:
                look(progress)
                show(f"Tune: {tried}: {progress.message or progress.stage}")

            with session_for(candidate, ends) as session:
                if session is None:
                    return Film.empty(scene.frame)
                return session.render(scene, candidate, on_progress=on_progress, cancelled=ends)

        def on_trial(tuning: Tuning, following: str) -> None:
            global _last
            nonlocal tried
            _last, tried = Tuned(name, tuning), following or tried

        tuning, film = tune(settings, _other_devices(settings), render, seconds, cancelled=cancelled, on_trial=on_trial)
        _last = Tuned(name, tuning)
        return film


@contextmanager
def _taken() -> Iterator[tuple[str, float]]:
    """What was asked for; the next render is a picture again."""
    try:
        yield _asked
    finally:
        withdraw_tuning()


def _other_devices(settings: RenderSettings) -> list[str]:
    """Those that would not render now: an empty list where they are not known yet."""
    known = [each.name for each in device_choices() or () if each.name != "AUTO"]
    cuda = [name for name in known if name != "cpu"]
    now = settings.device.lower() if settings.device.upper() != "AUTO" else (cuda or ["cpu"])[0]
    return [name for name in known if name != now]
