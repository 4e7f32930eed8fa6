"""Lines of progress where there is no window: seldom, however many frames there are, and yet the end is said.

The last line of a frame waits where it would come too soon behind another. Where a frame follows, that one's lines come
in its place; where none does, it is printed when it is due, or when Blender ends.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable

import bpy

# From one line to the next, of whatever frame [s]
PLAIN_SECONDS = 5.0
# Whether lines wait. A script that brought in Blender as a module knows itself when its render is over, and what is
# printed then is its own
WAITS = not bpy.app.module


class PlainLines:
    """When lines may be printed."""

    def __init__(self, write: Callable[[str], object] = lambda text: print(text, flush=True)) -> None:
        """`write` prints a line that had to wait; on any thread."""
        self._write_late = write
        self._said_at = float("-inf")
        self._waiting: str | None = None
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()

    @property
    def is_due(self) -> bool:
        """Whether a line may be printed now."""
        return time.perf_counter() - self._said_at >= PLAIN_SECONDS

    def note(self) -> None:
        """One is printed now."""
        self._said_at = time.perf_counter()

    def begin(self) -> None:
        """Something else is under way, or was said: the line that waits is out of date."""
        with self._lock:
            _, timer = self._take()
        _join(timer)

    def wait_with(self, text: str) -> None:
        """Print `text` when it is due, unless something else begins before."""
        with self._lock:
            _, before = self._take()
            if WAITS:
                self._waiting = text
                seconds = max(0.0, self._said_at + PLAIN_SECONDS - time.perf_counter())
                timer = threading.Timer(seconds, lambda: self.flush(timer))
                timer.daemon = True
                timer.start()
                self._timer = timer
                # At its end Python calls last what was registered first. `exit_code` registers a function that ends
                # the process, before which the line has to be printed: so it is registered only now, not when Blender
                # starts
                atexit.register(self.flush)
        _join(before)

    def flush(self, timer: threading.Timer | None = None) -> None:
        """Print the line that waits, now; for a `timer` only if it is the one of that line, not of one before it."""
        with self._lock:
            if timer is not None and timer is not self._timer:
                return
            text, ended = self._take()
            if text is not None:
                self.note()
                self._write_late(text)
        _join(ended)

    def _take(self) -> tuple[str | None, threading.Timer | None]:
        """The line that waits, and its timer, which is cancelled."""
        text, self._waiting = self._waiting, None
        timer, self._timer = self._timer, None
        if timer is not None:
            timer.cancel()
            atexit.unregister(self.flush)
        return text, timer


def _join(timer: threading.Timer | None) -> None:
    """Wait for the end of a timer's thread: beside one the module bpy 4.5 would hang when the process ends."""
    if timer is not None and timer is not threading.current_thread():
        timer.join()


def line_of_frame(frame: int, text: str) -> str:
    """`text` as Blender prints what an engine says of a frame."""
    return f"Fra: {frame} | {text}" if bpy.app.version >= (5, 0) else f"Fra:{frame} | {text}"


plain_lines = PlainLines()  # of this Blender
