"""Progress on standard error: a bar on a terminal, a line for each step elsewhere."""

from __future__ import annotations

import sys
import time


class Steps:
    """Shows how many of `total` steps are done."""

    def __init__(self, total: int) -> None:
        self._total, self._done, self._began = total, 0, time.perf_counter()
        self._bar = None
        if sys.stderr.isatty():
            try:
                from tqdm import tqdm
            except ImportError:
                return
            self._bar = tqdm(
                total=total, file=sys.stderr, leave=False, dynamic_ncols=True, bar_format="{desc} |{bar}| {n}/{total}"
            )

    def begin(self, text: str) -> None:
        """The next step begins: it is about `text`."""
        if self._bar is not None:
            self._bar.set_description_str(text, refresh=True)
        else:
            print(
                f"[{self._done + 1}/{self._total}, {time.perf_counter() - self._began:.0f} s] {text}",
                file=sys.stderr,
                flush=True,
            )

    def end(self) -> None:
        """The step is done."""
        self._done += 1
        if self._bar is not None:
            self._bar.update()

    def close(self) -> None:
        """Clear the bar."""
        if self._bar is not None:
            self._bar.close()
