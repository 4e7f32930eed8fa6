"""The exit code of a Blender without a window, which by itself ends with 0 whatever became of its renders."""

from __future__ import annotations

import atexit
import os
import sys

RENDER_FAILED, REFUSED = 1, 3  # a render failed; one was refused, as it would have lacked something

_code = 0
_is_awaited = False  # a render has begun, and nobody has said what became of it
_leaves = False  # `_leave` is called at the end


def end_with(code: int) -> None:
    """This process is to end with `code`, or with a higher one that was asked for."""
    global _code
    _code = max(_code, code)
    _leave_at_end()


def await_render() -> None:
    """A render begins: it failed unless `has_ended` is called."""
    global _is_awaited
    _is_awaited = True
    _leave_at_end()


def has_ended() -> None:
    """What became of the render is known."""
    global _is_awaited
    _is_awaited = False


def is_awaited() -> bool:
    """Whether a render began, and what became of it is not known."""
    return _is_awaited


def _leave_at_end() -> None:
    global _leaves
    if not _leaves:
        atexit.register(_leave)
    _leaves = True


def _leave() -> None:
    code = max(_code, RENDER_FAILED if _is_awaited else 0)
    if code:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
