"""The exit code of a Blender without a window, which by itself ends with 0 whatever became of its renders."""

from __future__ import annotations

import atexit
import os
import sys

RENDER_FAILED, REFUSED = 1, 3  # a render failed; one was refused, as it would have lacked something

_code = 0


def end_with(code: int) -> None:
    """This process is to end with `code`, or with a higher one that was asked for."""
    global _code
    if not _code:
        atexit.register(_leave)
    _code = max(_code, code)


def _leave() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(_code)
