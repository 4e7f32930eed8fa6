"""The sessions of this Blender, one for each choice of devices: they hold the caches that outlive an engine object."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import bpy

from ..core.device.devices import find_devices, start_warp
from ..core.live.picture import LiveRequest
from ..core.session import Session
from ..core.settings.settings import RenderSettings
from . import finals
from .kernel_cache import kernel_cache_folder

if TYPE_CHECKING:
    from ..core.cluster.session import ClusterSession

# How often who waits for a session asks whether it is still wanted [s]
_LOOK_SECONDS = 0.1
# Blender ends, or the add-on is switched off: a render that does not end by then keeps what it has [s]
_CLOSE_SECONDS = 60.0

# What final renders get instead of a session of this Blender, for scripts: that of a cluster
instead: Callable[[RenderSettings], ClusterSession] | None = None

_sessions: dict[str, Session] = {}
_changed = threading.Condition()
_is_lent = False  # a session renders one picture at a time, and so do all of them together
_views: deque[object] = deque()  # viewports that wait for their turn, the first one first


@contextmanager
def session_for(
    settings: RenderSettings, cancelled: Callable[[], bool] = lambda: False
) -> Iterator[Session | ClusterSession | None]:
    """The session of the settings' device, to oneself, for a final render: viewports stop for it. None once
    `cancelled()`, which is asked while it is not free. Raises `DeviceError` for a device that is not there.
    """
    with _lent_first(cancelled) as is_ours:
        yield (instead or _session_of)(settings) if is_ours else None


@contextmanager
def preview_session(settings: RenderSettings, cancelled: Callable[[], bool]) -> Iterator[Session | None]:
    """The session of previews, lent like that of `session_for`. It is a session of their own, so that what is kept of
    the user's scene stays where it is.
    """
    with _lent_first(cancelled) as is_ours:
        yield _session_of(settings, "preview ") if is_ours else None


@contextmanager
def _lent_first(cancelled: Callable[[], bool]) -> Iterator[bool]:
    """Sessions are lent to one render, before all viewports; False once `cancelled()`."""
    with finals.under_way():
        with _changed:
            while _is_lent and not cancelled():
                _changed.wait(_LOOK_SECONDS)
            is_ours = not _is_lent
            if is_ours:
                _lend()
        try:
            yield is_ours
        finally:
            if is_ours:
                _give_back()


class ViewSessions:
    """Lends sessions to viewports: final renders go first, and viewports take turns in the order in which they came."""

    @contextmanager
    def session(self, request: LiveRequest, given_up: Callable[[], bool]) -> Iterator[Session | None]:
        """See `SessionSource.session`."""
        is_ours, turn = False, object()
        with _changed:
            _views.append(turn)
            try:
                while not (is_ours := _is_turn_of(turn)) and not given_up():
                    _changed.wait(_LOOK_SECONDS)
                if is_ours:
                    _lend()
            finally:
                _views.remove(turn)
                _changed.notify_all()
        try:
            yield _session_of(request.settings) if is_ours else None
        finally:
            if is_ours:
                _give_back()

    def is_wanted(self, has_shown: bool) -> bool:
        """See `SessionSource.is_wanted`: by a final render at once, by another viewport once a picture came."""
        return finals.are_under_way() or (has_shown and len(_views) > 0)


def close_all(seconds: float = _CLOSE_SECONDS) -> bool:
    """Give back what all sessions hold; False where a render goes on for more than `seconds`, which keeps it."""
    with finals.under_way(), _changed:
        if not _changed.wait_for(lambda: not _is_lent, seconds):
            return False
        for session in _sessions.values():
            session.close()
        _sessions.clear()
    return True


def _is_turn_of(turn: object) -> bool:
    return not _is_lent and not finals.are_under_way() and _views[0] is turn


def _lend() -> None:
    global _is_lent
    _is_lent = True


def _give_back() -> None:
    global _is_lent
    with _changed:
        _is_lent = False
        _changed.notify_all()


def _session_of(settings: RenderSettings, use: str = "") -> Session:
    """The session of the devices for a `use` of its own, for who was lent it."""
    start_warp(kernel_cache_folder())
    names = ",".join(each.alias for each in find_devices(settings.device))
    name = use + names
    if name not in _sessions:
        # a window stays when a picture is there; without one, Blender ends or goes on to the next frame
        _sessions[name] = Session(names, settings, compile_between_renders=not bpy.app.background)
    return _sessions[name]
