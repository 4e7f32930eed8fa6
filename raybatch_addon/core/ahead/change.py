"""From general to specialised kernels, while a render goes on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import warp as wp

from ..device.devices import is_compiled, load_kernels, warp_cache_folder, worker_count
from ..errors import RayBatchError
from ..scene.features import SceneFeatures
from ..wavefront.integrator import TileIntegrator
from ..wavefront.kernels import StageKernels
from .process import CompileProcess
from .request import CompileRequest

# Share of their time that general kernels lose to specialised ones
_LOSS = 0.25
# Share of the compiler's time that it takes from a render on a GPU, which leaves processors idle
_CUDA_COST = 0.1
_POLL_SECONDS = 0.1


def pays(request: CompileRequest, spent: float, left: float | None, device: wp.Device) -> bool:
    """Whether it is time to compile the specialised kernels.

    To compile takes processors away from a render on the CPU, and little from one on a GPU; it pays where what is
    `left` of the render [s] loses more by general kernels than that. Where it is short, nobody knows how many more
    renders of the kind there will be: then it is time when those so far have lost as much as compiling costs, which
    takes twice as long as the best choice at most (the ski rental problem; Karlin et al. 1988).

    Args:
        spent: how long general kernels have rendered such scenes [s].
        left: of this render, if known [s].
    """
    seconds = request.expected_seconds
    cost = seconds * _CUDA_COST if device.is_cuda else seconds / worker_count(device, request.settings.thread_count)
    worth_it = left is not None and left > seconds and (left - seconds) * _LOSS > cost
    return worth_it or spent * _LOSS > cost


class TierChanges:
    """Compiles specialised kernels for the renders of one session that general ones begin, for one scene at a time."""

    def __init__(self, device: wp.Device, between_renders: bool = False):
        """`between_renders`: whether to compile what a render lacked when it is over, for the next one."""
        self._device, self._between_renders = device, between_renders
        self._spent: dict[SceneFeatures, float] = {}
        self._failed: dict[SceneFeatures, str] = {}
        self._process: CompileProcess | None = None
        self._features: SceneFeatures | None = None  # that it compiles for
        self._closed = False

    def close(self) -> None:
        """End what still compiles, and begin nothing more."""
        self._closed = True
        if self._process:
            self._process.stop()
        self._process = None

    def open(self) -> None:
        """A render begins: what it needs may be compiled, also after `close`."""
        self._closed = False

    def is_closed(self) -> bool:
        """Whether the session is closed: nobody wants what compiles."""
        return self._closed

    def spend(self, request: CompileRequest, seconds: float) -> None:
        """Note that general kernels rendered for `seconds`."""
        self._spent[request.features] = self._spent.get(request.features, 0.0) + seconds

    def fail(self, features: SceneFeatures, complaint: str) -> None:
        """Note why there are no specialised kernels for `features`; they are not tried again."""
        self._failed[features] = complaint

    def complaint(self, request: CompileRequest) -> str:
        """Why the kernels of `request` could not be compiled; empty where nothing failed."""
        return self._failed.get(request.features, "")

    def poll(self, request: CompileRequest, left: float | None) -> bool:
        """Begin to compile if it pays; whether specialised kernels were compiled and can be loaded.

        `left`: of the render, if known [s].
        """
        ours = self._features == request.features
        if self._process is not None and not self._process.is_running:
            assert self._features is not None  # since the process was begun
            if complaint := self._process.complaint():
                self.fail(self._features, complaint)
            self._process = None
            if ours and not complaint:
                if all(is_compiled(kernel, self._device) for kernel in request.kernels(self._device)):
                    return True
                self.fail(request.features, "what was compiled is not in the folder for kernels")
        if (self._process is not None and ours) or self._closed or request.features in self._failed:
            return False
        if pays(request, self._spent.get(request.features, 0.0), left, self._device):
            self._begin(request)
        return False

    def rest(self, request: CompileRequest) -> None:
        """A render by general kernels is over, and leaves the processors idle until the next one, if there is one."""
        ours = self._process is not None and self._features == request.features
        if self._between_renders and not (ours or self._closed or request.features in self._failed):
            self._begin(request)

    def _begin(self, request: CompileRequest) -> None:
        if self._process is not None:
            self._process.stop()  # for a scene that is not rendered now
        self._process, self._features = None, request.features
        try:
            self._process = CompileProcess(self._device.alias, warp_cache_folder(), request)
        except OSError as error:
            self.fail(request.features, f"no process could be started: {error}")


class TierChange:
    """Watches one render, which general kernels began, and hands it the specialised ones when they are there."""

    def __init__(
        self,
        changes: TierChanges,
        request: CompileRequest,
        integrators: Sequence[TileIntegrator],
        left: Callable[[], float | None],
        device: wp.Device,
    ):
        """`left`: how long the render will take from now on, if known [s]."""
        self.request = request
        self.changed_after: float | None = None  # seconds from here
        self._changes, self._integrators = changes, integrators
        self._left, self._device = left, device
        self._over, self._begun = threading.Event(), time.perf_counter()
        self._thread: threading.Thread | None = None

    def go_on(self) -> None:
        """The render goes on: watch it from now on, unless it has just begun."""
        if self._thread is None and time.perf_counter() - self._begun >= _POLL_SECONDS:
            self._thread = threading.Thread(target=self._watch, daemon=True)
            self._thread.start()

    def close(self) -> None:
        """The render is over."""
        self._over.set()
        if self._thread:
            self._thread.join()
        seconds = time.perf_counter() - self._begun if self.changed_after is None else self.changed_after
        self._changes.spend(self.request, seconds)
        if self.changed_after is None:
            self._changes.rest(self.request)

    def _watch(self) -> None:
        try:
            while not self._over.is_set():
                if self._changes.poll(self.request, self._left()):
                    self._take_over()
                    return
                self._over.wait(_POLL_SECONDS)
        except (RayBatchError, RuntimeError, OSError, ValueError) as error:  # the render goes on as it began
            self._changes.fail(self.request.features, str(error))

    def _take_over(self) -> None:
        load_kernels(self.request.kernels(self._device), self._device, lambda done, total: None)
        kernels = StageKernels.choose(self.request.features, self._device)
        for integrator in self._integrators:
            integrator.use_kernels(kernels)
        self.changed_after = time.perf_counter() - self._begun
