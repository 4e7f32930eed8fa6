"""Progress on standard error: samples, rays a second, time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import IO, TYPE_CHECKING

from raybatch_addon.blender.status.text import status_text
from raybatch_addon.core.observers import Progress

if TYPE_CHECKING:
    from tqdm import tqdm

PLAIN_SECONDS = 5.0  # between lines where there is no terminal


class ProgressBar:
    """A bar on a terminal; elsewhere a line at most every `PLAIN_SECONDS`, as a Blender without a window prints those
    of the add-on. `label` may be changed between pictures: it begins the bar, and errors about a picture.
    """

    def __init__(self, stream: IO[str] | None = None, clock: Callable[[], float] = time.perf_counter) -> None:
        """`stream`: where to (default: standard error); `clock`: the time [s]."""
        self.label = ""
        self._stream, self._clock = stream or sys.stderr, clock
        self._bar: tqdm | None = None
        self._terminal = self._stream.isatty()
        self._shown = clock()

    def show(self, progress: Progress, frame: int | None = None) -> None:
        """Show where the render stands, of `frame` if the picture is one of an animation."""
        text = status_text(progress)
        if not self._terminal:
            now = self._clock()
            if now - self._shown >= PLAIN_SECONDS:
                self._shown = now
                print(text if frame is None else f"Fra: {frame} | {text}", file=self._stream, flush=True)
            return
        if self._bar is None:
            from tqdm import tqdm  # not needed where there is no terminal

            self._bar = tqdm(
                total=1.0,
                file=self._stream,
                leave=False,
                dynamic_ncols=True,
                bar_format="{desc} |{bar}| {percentage:3.0f} %",
            )
        self._bar.n = progress.fraction
        self._bar.set_description_str(f"{self.label}{text}", refresh=True)

    def close(self) -> None:
        """Clear the line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
