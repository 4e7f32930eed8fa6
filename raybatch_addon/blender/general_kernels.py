"""The general kernels, with which any scene can begin: compiled in a process of their own once RayBatch is enabled."""

from __future__ import annotations

from collections.abc import Callable

from ..core.ahead.process import CompileProcess
from .kernel_cache import kernel_cache_folder

_process: CompileProcess | None = None
_failure = ""


def start() -> None:
    """Compile those that are not in the cache, for the device that renders by default; nothing if that is under way."""
    global _process, _failure
    if is_compiling():
        return
    _failure = ""
    try:
        _process = CompileProcess("AUTO", kernel_cache_folder())
    except OSError as error:
        _process, _failure = None, f"no process could be started: {error}"


def is_compiling() -> bool:
    """Whether they are being compiled."""
    return _process is not None and _process.is_running


def state() -> str:
    """How far they are, in a few words."""
    if is_compiling():
        return "being compiled in the background; renders compile what they need until then"
    if failure := _failure or (_process.complaint() if _process else ""):
        return f"could not be compiled: {failure}"
    return "ready: a scene's first render waits for no compiler" if _process else "not looked for yet"


def stop() -> None:
    """Compile no longer."""
    global _process
    if _process:
        _process.stop()
    _process = None


def watch(on_change: Callable[[], None]) -> Callable[[], float | None]:
    """A function for Blender's timers, which calls `on_change` until nothing is being compiled."""

    def look() -> float | None:
        on_change()
        return 1.0 if is_compiling() else None

    return look
