"""From general to specialised kernels, while a render goes on."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import warp as wp

from ..device.compiler import CompileStoppedError
from ..device.devices import is_compiled, load_kernels, warp_cache_folder, worker_count
from ..errors import RayBatchError
from ..scene.features import SceneFeatures
from ..wavefront.integrator import TileIntegrator
from ..wavefront.kernels import StageKernels
from .process import CompileProcess
from .request import CompileRequest

# Share of their time that general kernels lose to specialised ones, on a CPU and on a GPU (medians of twelve and of
# thirteen files: docs/studies/equal-error.md, docs/architecture.md)
_LOSS, _CUDA_LOSS = 0.21, 0.36
# Share of the compiler's time that it takes from a render on a GPU, which leaves processors idle
_CUDA_COST = 0.1
_POLL_SECONDS = 0.1
_ends: weakref.WeakSet[threading.Event] = weakref.WeakSet()  # of renders that are watched


@dataclass(frozen=True)
class Decision:
    """Whether it is time to compile the specialised kernels."""

    pays: bool
    why: str  # in numbers
    left: float | None  # what was known of the render then [s]


def weigh_compiling(request: CompileRequest, spent: float, left: float | None, device: wp.Device) -> Decision:
    """Whether it is time to compile the specialised kernels.

    To compile takes processors away from a render on the CPU, and little from one on a GPU; it pays where what is
    `left` of the render [s] loses more by general kernels than that. Where it is short, nobody knows how many more
    renders of the kind there will be: then it is time when those so far have lost as much as compiling costs, which
    takes twice as long as the best choice at most (the ski rental problem; Karlin et al. 1988).

    Args:
        spent: how long general kernels have rendered such scenes [s].
        left: of this render, if known [s].
    """
    seconds, loss = request.expected_seconds, _CUDA_LOSS if device.is_cuda else _LOSS
    cost = seconds * _CUDA_COST if device.is_cuda else seconds / worker_count(device, request.settings.thread_count)
    takes = f"compiling takes about {seconds:.0f} s of a processor"
    if left is not None and left > seconds and (left - seconds) * loss > cost:
        lost = (left - seconds) * loss
        return Decision(True, f"{takes}, and of the {left:.0f} s that are left general kernels lose {lost:.0f}", left)
    if spent * loss > cost:
        lost = spent * loss
        why = f"{takes}, and of {spent:.0f} s of rendering such scenes general kernels have lost {lost:.0f}"
        return Decision(True, why, left)
    if left is None:
        return Decision(False, f"{takes}, and it is not known how long the render takes", left)
    if left <= seconds:
        return Decision(False, f"{takes} and {left:.0f} s are left, so general kernels render to the end", left)
    return Decision(False, f"{takes}, more than general kernels lose in the {left:.0f} s that are left", left)


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
        self.decision: Decision | None = None  # of the last `poll`, where there was something to decide

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

    def is_compiling(self, request: CompileRequest) -> bool:
        """Whether the kernels of `request` are being compiled."""
        process = self._process  # another thread may end it
        return process is not None and self._features == request.features and process.is_running

    def poll(self, request: CompileRequest, left: float | None) -> bool:
        """Begin to compile if it pays; whether specialised kernels were compiled and can be loaded.

        `left`: of the render, if known [s].
        """
        self.decision = None
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
        self.decision = weigh_compiling(request, self._spent.get(request.features, 0.0), left, self._device)
        if self.decision.pays:
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
        self.compiled_for_next = False  # whether they were still compiled when the render was over
        self.why = ""  # the others took over, or did not; once the render is over
        self._decision: Decision | None = None  # that counts: the first one to compile, else that with most time left
        self._changes, self._integrators = changes, integrators
        self._left, self._device = left, device
        self._over, self._begun = threading.Event(), time.perf_counter()
        self._thread: threading.Thread | None = None

    def go_on(self) -> None:
        """The render goes on: watch it from now on, unless it has just begun."""
        if self._thread is None and time.perf_counter() - self._begun >= _POLL_SECONDS:
            _ends.add(self._over)
            # Python waits for it before it ends: while a module is loaded, nothing of it may go
            self._thread = threading.Thread(target=self._watch, name="RayBatch change of kernels", daemon=False)
            self._thread.start()

    @property
    def is_compiling(self) -> bool:
        """Whether the specialised kernels are being compiled."""
        return self._changes.is_compiling(self.request)

    def close(self) -> None:
        """The render is over."""
        self._over.set()
        if self._thread:
            self._thread.join()
        seconds = time.perf_counter() - self._begun if self.changed_after is None else self.changed_after
        self.why = self._reason(seconds)
        self._changes.spend(self.request, seconds)
        if self.changed_after is None:
            self._changes.rest(self.request)
            self.compiled_for_next = self.is_compiling

    def _reason(self, seconds: float) -> str:
        """Why specialised kernels took over or did not, in a render that general ones rendered for `seconds`."""
        if self.changed_after is not None:
            decided = f": {self._decision.why}" if self._decision else ""
            return f"specialised ones took over after {seconds:.1f} s{decided}"
        if self._changes.complaint(self.request):
            return "they could not be compiled"
        if self.is_compiling:
            decided = self._decision.why if self._decision else "they are being compiled since an earlier render"
            return f"{decided}; they were not ready before the end"
        if self._decision:
            return self._decision.why
        expected = self.request.expected_seconds
        return f"compiling takes about {expected:.0f} s of a processor, and the render took {seconds:.1f} s"

    def _note(self, decision: Decision | None) -> None:
        before = self._decision
        if decision is None or (before and before.pays):
            return
        if before is None or decision.pays or (decision.left or 0.0) > (before.left or 0.0):
            self._decision = decision

    def _watch(self) -> None:
        try:
            while not self._over.is_set():
                is_ready = self._changes.poll(self.request, self._left())
                self._note(self._changes.decision)
                if is_ready:
                    self._take_over()
                    return
                self._over.wait(_POLL_SECONDS)
        except CompileStoppedError:
            return
        except (RayBatchError, RuntimeError, OSError, ValueError) as error:  # the render goes on as it began
            self._changes.fail(self.request.features, str(error))

    def _take_over(self) -> None:
        load_kernels(self.request.kernels(self._device), self._device, lambda done, total: None, self._over.is_set)
        kernels = StageKernels.choose(self.request.features, self._device)
        for integrator in self._integrators:
            integrator.use_kernels(kernels)
        self.changed_after = time.perf_counter() - self._begun


def _end_all() -> None:
    for over in list(_ends):
        over.set()


# before Python waits for threads, whatever thread renders
getattr(threading, "_register_atexit", lambda _: None)(_end_all)
