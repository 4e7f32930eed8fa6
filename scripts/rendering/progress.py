"""Progress on standard error: samples, rays a second, time left."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from raybatch_addon.core.observers import Progress

if TYPE_CHECKING:
    from tqdm import tqdm

PLAIN_SECONDS = 5.0  # between lines where standard error is no terminal


class ProgressBar:
    """A bar on a terminal; a line now and then elsewhere. `label` may be changed between pictures."""

    def __init__(self) -> None:
        self.label = ""
        self._bar: tqdm | None = None
        self._terminal = sys.stderr.isatty()
        self._shown = time.perf_counter()

    def show(self, progress: Progress) -> None:
        """Show where the render stands."""
        text = progress_text(progress)
        if not self._terminal:
            if time.perf_counter() - self._shown >= PLAIN_SECONDS:
                self._shown = time.perf_counter()
                print(f"{self.label}{text}", file=sys.stderr, flush=True)
            return
        if self._bar is None:
            from tqdm import tqdm  # not needed where there is no terminal

            self._bar = tqdm(
                total=1.0,
                file=sys.stderr,
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


def progress_text(progress: Progress) -> str:
    """One line on where the render stands."""
    if progress.stage != "render":
        return progress.message
    rays = f"{progress.rays_per_second / 1e6:.2f} Mrays/s"
    left = "" if progress.seconds_left is None else f", {_clock(progress.seconds_left)} left"
    beside = ", compiling specialised kernels" if progress.compiles else ""
    return f"{progress.samples_done:.1f}/{progress.samples_total} samples, {rays}{left}{beside}"


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
