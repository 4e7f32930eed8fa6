"""Where the devices of a session meet: pages that they hold for each other are built by the first that comes."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import warp as wp

from ....errors import check_cancelled
from .share import Hold, ShareTooLargeError
from .store import BuiltPages

# How often those who wait ask whether the render was cancelled [s]
_POLL = 0.05
# Pages of the last frame are waited for at most so long, until the last device gives them up [s]: some are still at the
# images of the frame, and one that failed holds its own until it renders again
_PATIENCE = 30.0
# Pages that were refused and are remembered: those of a few scenes
_REFUSED_MOST = 16


class SharedPages:
    """The pages that the devices of a session have in common, as long as one of them uses them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._key = b""
        self._refused: deque[bytes] = deque(maxlen=_REFUSED_MOST)
        self._last: weakref.ref[BuiltPages] | None = None

    def get(self, key: bytes, build: Callable[[], BuiltPages], cancelled: Callable[[], bool]) -> BuiltPages:
        """The pages with this `key`: those that are there, or what `build` makes, whose errors are raised. Others that
        ask meanwhile wait for it. Raises `BuildCancelledError`, and `ShareTooLargeError` for pages that were refused.
        """
        while not self._lock.acquire(timeout=_POLL):
            check_cancelled(cancelled)
        try:
            if key in self._refused:
                raise ShareTooLargeError("another device found no room beside its share of these pages")
            there = self._last() if self._last else None
            if there is not None and self._key == key:
                return there
            del there
            self._wait_for_room(cancelled)
            made = build()
            self._key, self._last = key, weakref.ref(made)
            return made
        finally:
            self._lock.release()

    def refuse(self, key: bytes) -> None:
        """Beside the pages with this `key` there is no room for anything else, on this device or any other, since they
        have the same budget: nobody builds them again. Called while they are held, without the lock: who has it may
        wait for them to be given up.
        """
        self._refused.append(key)

    def _wait_for_room(self, cancelled: Callable[[], bool]) -> None:
        """Until the pages of the last frame are gone: each device gives them up before it asks for others."""
        if self._last is None or self._last() is None:
            return
        gc.collect()
        until = time.monotonic() + _PATIENCE
        while self._last() is not None and time.monotonic() < until:
            check_cancelled(cancelled)
            time.sleep(_POLL)


@dataclass(frozen=True)
class PeerPages:
    """A device's part in a render whose devices hold pages for each other."""

    shared: SharedPages
    devices: tuple[wp.Device, ...]
    place: int  # of this device among them
    way: Hold = Hold(0, False)

    @staticmethod
    def of(shared: SharedPages, devices: Sequence[wp.Device]) -> list[PeerPages]:
        """The parts of all `devices`."""
        return [PeerPages(shared, tuple(devices), place) for place in range(len(devices))]

    @property
    def kind(self) -> tuple:
        """What pages and their place depend on."""
        return (self.place, *(each.alias for each in self.devices))
