"""Work that each first render needs whatever its scene is, done before: the core is imported and general kernels
declared.

That takes half a second of Python. It happens in a thread: in a Blender with a window once a scene of the file has
RayBatch as its engine, else while Blender evaluates the scene that is to be rendered; other files never pay for it.
"""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Callable, Iterator

_thread: threading.Thread | None = None
_is_done = False
_waiting: list[Callable[[], None]] = []  # to call when it is
_waiting_lock = threading.Lock()


def warm_up() -> None:
    """Start it; nothing where that was done before."""
    global _thread
    if _thread is None:
        _thread = threading.Thread(target=_make, name="RayBatch warm-up")
        _thread.start()


def finish_warm_up() -> None:
    """Return once it is done, if it was begun. Each render waits: two threads must not declare one kernel."""
    if _thread is not None:
        _thread.join()


def is_over(then: Callable[[], None]) -> bool:
    """Whether it is done. Where it is not it is under way from now on, and `then` is called once it is."""
    with _waiting_lock:
        if _is_done:
            return True
        _waiting.append(then)
    warm_up()
    return False


def _make() -> None:
    global _is_done
    try:
        _make_all()
    finally:
        with _waiting_lock:
            _is_done = True
            waiting = [*_waiting]
            _waiting.clear()
        for each in waiting:
            each()


def _make_all() -> None:
    with without_collections(), contextlib.suppress(Exception):  # the render meets what goes wrong again, and says it
        from ..core.device.devices import find_device, is_compiled, start_warp
        from ..core.wavefront.tier import general_kernels
        from ..export import scene  # noqa: F401 - renders begin with it
        from . import sessions  # noqa: F401
        from .kernel_cache import kernel_cache_folder
        from .viewport import viewport  # noqa: F401

        start_warp(kernel_cache_folder())
        device = find_device("cpu")
        is_compiled(general_kernels(device)[0], device)  # makes the names of all of them


@contextlib.contextmanager
def without_collections() -> Iterator[None]:
    """Python does not look for what nobody uses: whatever is imported stays, and each look at all that Blender and the
    core hold takes a tenth of a second.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.unfreeze()  # both together: what is there now counts as old, without a look at it
        if was_enabled:
            gc.enable()
