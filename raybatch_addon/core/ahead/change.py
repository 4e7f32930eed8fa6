"""From general to specialised kernels, while a render goes on."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
_NOT_READY = "they were not ready before the end"
_lock = threading.Lock()  # of both that follow
_ends: weakref.WeakSet[threading.Event] = weakref.WeakSet()  # of renders that are watched
_ending = False  # this process ends, nothing more is watched


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
    costs = f"{takes}, which costs {cost:.1f} s of rendering"
    after = 0.0 if left is None else max(left - seconds, 0.0)
    if after * loss > cost:
        gains = f"general kernels lose {after * loss:.1f} s in the {after:.0f} s that are left then"
        return Decision(True, f"{costs}, and {gains}", left)
    if spent * loss > cost:
        lost = f"in {spent:.0f} s of rendering such scenes general kernels have lost {spent * loss:.1f} s"
        return Decision(True, f"{costs}, and {lost}", left)
    if left is None:
        return Decision(False, f"{takes}, and it is not known how long the render takes", left)
    if left <= seconds:
        return Decision(False, f"{takes} and {left:.0f} s are left, so general kernels render to the end", left)
    gains = f"the {after * loss:.1f} s that general kernels lose in the {after:.0f} s that are left then"
    return Decision(False, f"{costs}, more than {gains}", left)


class Polled(NamedTuple):
    """What `TierChanges.poll` found."""

    is_ready: bool  # specialised kernels were compiled, and can be loaded
    decision: Decision | None = None  # where there was something to decide


class TierChanges:
    """Compiles specialised kernels for the renders of one session that general ones begin, for one scene at a time."""

    def __init__(self, device: wp.Device, between_renders: bool = False):
        """`between_renders`: whether to compile what a render lacked when it is over, for the next one."""
        self._device, self._between_renders = device, between_renders
        self._spent: dict[SceneFeatures, float] = {}
        self._lock = threading.Lock()  # of all that follows: a session may be closed while others render and watch
        self._failed: dict[SceneFeatures, str] = {}
        self._process: CompileProcess | None = None  # who ends it takes it away first
        self._features: SceneFeatures | None = None  # that it compiles for
        self._closed = False

    def close(self) -> None:
        """End what still compiles, and begin nothing more."""
        with self._lock:
            self._closed = True
            process, self._process = self._process, None
        if process:
            process.stop()

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
        """Note why there are no specialised kernels for `features`; they are not tried again.

        Nothing is noted once the session is closed, which ends what goes on.
        """
        with self._lock:
            if not self._closed:
                self._failed[features] = complaint

    def complaint(self, request: CompileRequest) -> str:
        """Why the kernels of `request` could not be compiled; empty where nothing failed."""
        return self._failed.get(request.features, "")

    def is_compiling(self, request: CompileRequest) -> bool:
        """Whether the kernels of `request` are being compiled."""
        with self._lock:
            process, features = self._process, self._features
        return process is not None and features == request.features and process.is_running

    def poll(self, request: CompileRequest, left: float | None, given_up: Callable[[], bool] = lambda: False) -> Polled:
        """Begin to compile if it pays, or take in what was compiled.

        Args:
            left: of the render, if known [s].
            given_up: whether nobody wants the kernels any more; then `CompileStoppedError` is raised.
        """
        with self._lock:
            process, features = self._process, self._features
        if process is not None and not process.is_running:
            assert features is not None  # since the process was begun
            ours = features == request.features
            complaint = process.complaint() or (self._lack(request, given_up) if ours else "")
            if not self._take_away(process):
                return Polled(False)  # it was ended
            process = None
            if complaint:
                self.fail(features, complaint)
            elif ours:
                return Polled(True)
        if (process is not None and features == request.features) or self._closed or request.features in self._failed:
            return Polled(False)
        decision = weigh_compiling(request, self._spent.get(request.features, 0.0), left, self._device)
        if decision.pays:
            self._begin(request, hurried=True)
        return Polled(False, decision)

    def rest(self, request: CompileRequest) -> None:
        """A render by general kernels is over, and leaves the processors idle until the next one, if there is one."""
        with self._lock:
            ours = self._process is not None and self._features == request.features
        if self._between_renders and not (ours or request.features in self._failed):
            self._begin(request)

    def _lack(self, request: CompileRequest, given_up: Callable[[], bool]) -> str:
        """A complaint where kernels of `request` are not there although they were compiled."""
        for kernel in request.kernels(self._device):
            if given_up():
                raise CompileStoppedError
            if not is_compiled(kernel, self._device):
                return "what was compiled is not in the folder for kernels"
        return ""

    def _take_away(self, process: CompileProcess) -> bool:
        """Forget `process`; whether nobody did before."""
        with self._lock:
            if self._process is not process:
                return False
            self._process = None
        return True

    def _begin(self, request: CompileRequest, hurried: bool = False) -> None:
        """Begin to compile, unless the session is closed. `hurried`: a render waits for it. Beside one that keeps all
        cores busy a compiler of low priority would get a tenth of one, and end after the render; one that began between
        two renders stays what it is.
        """
        with self._lock:
            if self._closed:
                return
            before, self._process, self._features = self._process, None, request.features
        if before:
            before.stop()  # for a scene that is not rendered now
        try:
            process = CompileProcess(self._device.alias, warp_cache_folder(), request, hurried)
        except OSError as error:
            self.fail(request.features, f"no process could be started: {error}")
            return
        with self._lock:
            if not self._closed:
                self._process = process
                return
        process.stop()  # the session was closed meanwhile


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
        """`left`: how long the render will take from now on, if known [s]. The integrators may be on several devices
        of the model of `device`.
        """
        self.request = request
        self.changed_after: float | None = None  # seconds from here
        self.compiled_for_next = False  # whether they were still compiled when the render was over
        self.why = ""  # the others took over, or did not; once the render is over
        self._decision: Decision | None = None  # that counts: the first one to compile, else that with most time left
        self._begun_before = changes.is_compiling(request)  # by an earlier render
        self._is_compiled = False  # the others are there, and taken over where the render goes on
        self._changes, self._integrators = changes, integrators
        self._left, self._device = left, device
        self._over, self._begun = threading.Event(), time.perf_counter()
        self._thread: threading.Thread | None = None

    def go_on(self) -> None:
        """The render goes on: watch it from now on, unless it has just begun."""
        if self._thread is None and time.perf_counter() - self._begun >= _POLL_SECONDS:
            # Python waits for it before it ends: while a module is loaded, nothing of it may go
            thread = threading.Thread(target=self._watch, name="RayBatch change of kernels", daemon=False)
            with _lock, contextlib.suppress(RuntimeError):  # no thread can be had: perhaps later
                if not _ending:
                    _ends.add(self._over)
                    thread.start()
                    self._thread = thread

    @property
    def complaint(self) -> str:
        """Why the specialised kernels could not be compiled; empty where nothing failed."""
        return self._changes.complaint(self.request)

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
        if self.changed_after is None and not self._is_compiled:
            self._changes.rest(self.request)
            self.compiled_for_next = self.is_compiling

    def _reason(self, seconds: float) -> str:
        """Why specialised kernels took over or did not, in a render that general ones rendered for `seconds`."""
        if self.changed_after is not None:
            decided = f": {self._decision.why}" if self._decision else ""
            return f"specialised ones took over after {seconds:.1f} s{decided}"
        if self.complaint:
            return "they could not be compiled"
        decision = self._decision
        if decision and decision.pays:
            return f"{decision.why}; {_NOT_READY}"
        if self._begun_before or self._is_compiled:
            return f"compiling began with an earlier render; {_NOT_READY}"
        if decision:
            return decision.why
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
                polled = self._changes.poll(self.request, self._left(), self._over.is_set)
                self._note(polled.decision)
                if polled.is_ready:
                    self._is_compiled = True
                    self._take_over()
                    return
                self._over.wait(_POLL_SECONDS)
        except CompileStoppedError:
            return
        except (RayBatchError, RuntimeError, OSError, ValueError) as error:  # the render goes on as it began
            self._changes.fail(self.request.features, str(error))

    def _take_over(self) -> None:
        devices = {each.alias: each for each in (self._device, *(each.device for each in self._integrators))}
        for device in devices.values():
            load_kernels(self.request.kernels(device), device, lambda done, total: None, self._over.is_set)
            if self._over.is_set():
                raise CompileStoppedError
        for integrator in self._integrators:
            integrator.use_kernels(StageKernels.choose(self.request.features, integrator.device))
        self.changed_after = time.perf_counter() - self._begun


def _end_all() -> None:
    global _ending
    with _lock:
        _ending = True
        for over in _ends:
            over.set()


# before Python waits for threads, whatever thread renders
getattr(threading, "_register_atexit", lambda _: None)(_end_all)
