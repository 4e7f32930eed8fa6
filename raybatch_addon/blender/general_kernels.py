"""The general kernels, with which any scene can begin on a CPU: compiled in a process of their own once RayBatch is
enabled.
"""

from __future__ import annotations

from ..core.ahead.process import CompileProcess
from .kernel_cache import kernel_cache_folder

_process: CompileProcess | None = None
_failure = ""


def start() -> None:
    """Compile those that are not in the cache; nothing if that is under way."""
    global _process, _failure
    if is_compiling():
        return
    _failure = ""
    try:
        _process = CompileProcess("cpu", kernel_cache_folder())
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
    return "ready: on the CPU a scene's first render waits for no compiler" if _process else "not looked for yet"


def stop() -> None:
    """Compile no longer."""
    global _process
    if _process:
        _process.stop()
    _process = None
