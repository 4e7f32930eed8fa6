"""The general kernels, with which any scene can begin: where none that fit were shipped, they are compiled
in a process of their own once RayBatch is enabled.
"""

from __future__ import annotations

from ..core.ahead.process import CompileProcess
from .kernel_cache import kernel_cache_folder

_process: CompileProcess | None = None
_failure = ""


def start() -> None:
    """Compile those that were neither shipped nor compiled before; nothing if that is under way."""
    global _process, _failure
    if is_compiling():
        return
    _failure = ""
    try:
        _process = CompileProcess("ALL", kernel_cache_folder())
    except OSError as error:
        _process, _failure = None, f"no process could be started: {error}"


def is_compiling() -> bool:
    """Whether they are being compiled."""
    return _process is not None and _process.is_running


def state() -> str:
    """How far they are, in a few words."""
    if is_compiling():
        assert _process is not None  # since it compiles
        counted = "" if _process.progress is None else ", {} of {} ready".format(*_process.progress)
        return f"being compiled in the background{counted}; renders compile what they need until then"
    if failure := _failure or (_process.complaint() if _process else ""):
        return f"could not be compiled: {failure}"
    if not _process:
        return "not looked for yet"
    notes = _process.notes()
    return f"ready: a scene's first render waits for no compiler{'; ' if notes else ''}{notes}"


def stop() -> None:
    """Compile no longer."""
    global _process
    if _process:
        _process.stop()
    _process = None
