"""The connection to a Dask cluster: its workers by machine, work sent to them, and a scheduler that comes back."""

from __future__ import annotations

import contextlib
import itertools
import pickle
import threading
import time
import uuid
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any

from ..errors import RayBatchError
from . import calls

# Workers render one range at a time for each unit of this resource, which they are started with
RESOURCE = "raybatch"
# How long to wait for a scheduler, at first and where it was lost [s]
CONNECT_SECONDS = 30.0
_LOOK_SECONDS = 0.5  # how often workers are looked at
_TOGETHER_SECONDS = 0.005  # what comes within it is looked at together
_NOTICED_SECONDS = 1.0  # the end of a scheduler is noticed so long after an error by it
_TOLD_SECONDS = 10.0  # words come at once, or their worker has ended
_SECURE_SECONDS = 60.0  # a film that is not copied by then is lost with its worker, if that ends
# A worker of which the scheduler heard nothing for so long, but of others, is taken to be gone [s]
SILENT_SECONDS = 30.0
# What installs Dask: the package is on no index
PACKAGES = 'install the wheel with its extra: pip install "$(echo dist/raybatch-*.whl)[cluster]"'


class ClusterError(RayBatchError):
    """Why a cluster does not render."""


class _ByValue:
    """A function that Dask sends with its code: the scheduler may not have the library at all, and workers may have it
    by another name.
    """

    def __init__(self, sent: bytes):
        """`sent`: the function as cloudpickle writes it with its code."""
        self._sent = sent

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return pickle.loads(self._sent)(*arguments, **named)

    def __reduce__(self) -> tuple[Callable[[bytes], Any], tuple[bytes]]:
        return pickle.loads, (self._sent,)  # there it is the function itself


@dataclass(frozen=True)
class Worker:
    """A process that works."""

    address: str
    host: str  # of its machine
    slots: int  # ranges that it renders at once


class Connection:
    """A client of a cluster, made anew where the scheduler was lost."""

    def __init__(
        self, address: str, report: Callable[[str], None] = lambda text: None, seconds: float = CONNECT_SECONDS
    ):
        """`address` is the scheduler's, as tcp://host:8786 or tls://host:8786; certificates are those of Dask's own
        configuration. `report` gets notes. Raises `ClusterError`.
        """
        try:
            import cloudpickle
            import distributed
        except ImportError as error:
            raise ClusterError(f"Dask is not installed ({error}): {PACKAGES}") from None
        cloudpickle.register_pickle_by_value(calls)
        self._call, self._keep_copies, self._has_dashboard, self._failed_on, self._leave_out = (
            _ByValue(cloudpickle.dumps(each))
            for each in (calls.call, calls.keep_copies, calls.has_dashboard, calls.failed_on, calls.drop)
        )
        self._distributed, self._address, self._report, self._seconds = distributed, address, report, seconds
        self._client: Any = None
        self._looked, self._workers = float("-inf"), list[Worker]()
        self._known: dict[str, float] = {}  # hosts with slots: when they were there last
        self._dropped: set[str] = set()  # addresses of workers that were silent
        self._names = itertools.count()
        self._something_came = threading.Event()
        self._own = uuid.uuid4().hex[:8]
        self._connect()

    @property
    def dashboard(self) -> str:
        """The address of Dask's own pages on what goes on; empty where there are none."""
        with contextlib.suppress(OSError, TimeoutError, RuntimeError, AttributeError):
            if self._client.run_on_scheduler(self._has_dashboard):
                return str(self._client.dashboard_link or "")
        return ""

    @property
    def silent(self) -> set[str]:
        """Addresses of workers that were left out since nothing was heard of them."""
        return self._dropped

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._drop()

    def _connect(self) -> None:
        try:
            self._client = self._distributed.Client(
                self._address, timeout=self._seconds, set_as_default=False, direct_to_workers=False
            )
            self._client.run_on_scheduler(self._keep_copies)
        except (OSError, TimeoutError, ValueError) as error:
            self._drop()
            raise ClusterError(
                f"there is no scheduler at {self._address} ({type(error).__name__}: {error}); start one with `dask "
                "scheduler`, or name its address"
            ) from error
        self._looked, self._scheduler, self._workers = float("-inf"), self._scheduler_now, []

    @property
    def _scheduler_now(self) -> str:
        """Which process the client speaks with: one that came back at the same address, which Dask finds by itself,
        knows of nothing that was asked.
        """
        return str(self._client._scheduler_identity.get("id", ""))

    def _drop(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(Exception):  # it may be gone
                client.close(timeout=5)

    @property
    def is_lost(self) -> bool:
        """Whether the scheduler is gone, with all that was asked of it."""
        client = self._client
        return client is None or client.status != "running" or self._scheduler_now != self._scheduler

    def was_lost(self) -> bool:
        """Whether an error is for that, which may be noticed a moment later."""
        end = time.monotonic() + _NOTICED_SECONDS
        while not self.is_lost:
            if time.monotonic() > end:
                return False
            time.sleep(0.05)
        return True

    def reconnect(self, cancelled: Callable[[], bool]) -> bool:
        """Wait for the scheduler to come back; False once `cancelled()`. Raises `ClusterError` after a while."""
        self._report(f"the scheduler at {self._address} is lost; waiting for it to come back")
        self._drop()
        end = time.monotonic() + max(self._seconds, CONNECT_SECONDS)
        seconds, self._seconds = self._seconds, 2.0
        try:
            while not cancelled():
                try:
                    self._connect()
                    return True
                except ClusterError:
                    if time.monotonic() > end:
                        raise
                    time.sleep(0.2)
            return False
        finally:
            self._seconds = seconds

    def workers(self) -> list[Worker]:
        """Those that there are, as of less than a second ago."""
        if time.monotonic() - self._looked >= _LOOK_SECONDS:
            self._looked = time.monotonic()
            with contextlib.suppress(OSError, TimeoutError, RuntimeError, ValueError):
                found = self._client.scheduler_info(n_workers=-1)["workers"]
                newest = max((each["last_seen"] for each in found.values()), default=0.0)  # by the scheduler's clock
                silent = {name for name, each in found.items() if newest - each["last_seen"] > SILENT_SECONDS}
                self._dropped -= found.keys() - silent  # who came back may be silent again
                for address in silent - self._dropped:
                    self._report(f"the worker {address} is silent; what it was asked for is rendered elsewhere")
                    self._dropped.add(address)
                    self._client.run_on_scheduler(self._leave_out, address)
                before = {each.address for each in self._workers if each.slots}
                for address in sorted(before - found.keys() - self._dropped):
                    self._report(f"worker {address} ended; what it was asked for is rendered elsewhere")
                self._workers = [
                    Worker(address, str(each["host"]), int(each["resources"].get(RESOURCE, 0)))
                    for address, each in found.items()
                    if address not in silent
                ]
                self._known |= {each.host: self._looked for each in self._workers if each.slots}
        return self._workers

    def known_hosts(self, seconds: float) -> set[str]:
        """Hosts that render, and are there, or were in the last `seconds`: they may come back."""
        return {host for host, last in self._known.items() if self._looked - last < seconds}

    def submit(self, name: str, *arguments: Any, workers: Iterable[str] | None = None, priority: int = 0, slot=False):
        """The future of `work`'s function `name`, on one of `workers` (addresses or hosts; default: any). With `slot`
        it takes a worker's slot. When it is done, `wait` ends.
        """
        future = self._client.submit(
            self._call,
            name,
            *arguments,
            key=f"raybatch-{name}-{self._own}-{next(self._names)}",
            workers=None if workers is None else sorted(workers),
            allow_other_workers=False,
            priority=priority,
            resources={RESOURCE: 1} if slot else None,
            pure=False,
        )
        future.add_done_callback(lambda _: self._something_came.set())
        return future

    def wait(self, seconds: float) -> None:
        """Until something that was asked for is there, at most so long."""
        if self._something_came.wait(seconds):
            time.sleep(_TOGETHER_SECONDS)  # more may come with it
            self._something_came.clear()

    def send(self, value: Any, worker: str):
        """The future of `value`, in the memory of `worker`."""
        return self._client.scatter(value, workers=[worker], hash=False, direct=False)

    def failed_on(self, future: Any) -> str:
        """The host that is at fault for the error of `future`, for its disk, its memory, or what is installed there;
        empty where none is.
        """
        if future.status == "error" and isinstance(future.exception(), (OSError, MemoryError, ImportError)):
            with contextlib.suppress(OSError, TimeoutError, RuntimeError):
                return next(iter(self._client.run_on_scheduler(self._failed_on, future.key)), "")
        return ""

    def went_with(self, addresses: Iterable[str]) -> set[tuple[str, float]]:
        """What the workers that went had, and Dask makes again elsewhere: keys of futures, with the time of that."""
        with contextlib.suppress(OSError, TimeoutError, RuntimeError):
            found = [each for address in addresses for each in self._client.get_events(address)]
            ends = [(time, each) for time, each in found if each.get("action") == "remove-worker"]
            kinds = "processing-tasks", "lost-computed-tasks"
            return {(key, time) for time, each in ends for kind in kinds for key in each.get(kind, ())}
        return set()

    def secure(self, future: Any) -> None:
        """Have two workers hold what `future` is of, where there are two: the end of one then loses nothing. Waits."""
        if len(self.workers()) > 1:
            with contextlib.suppress(Exception):  # the film may be lost with its worker, and is rendered anew
                self._client.sync(self._client._replicate, [future], n=2, callback_timeout=_SECURE_SECONDS)

    def cancel(self, futures: list[Any]) -> None:
        """Nobody wants them any more."""
        if futures and not self.is_lost:
            with contextlib.suppress(OSError, TimeoutError, RuntimeError):
                self._client.cancel(futures, force=True)


def why_lost(future: Any) -> str:
    """Why a future has no result."""
    if future.status != "error":
        return "it was lost with its worker"
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        return "the workers that rendered it ended, one after the other; do they run out of memory?"
    if is_diagnosed(future):
        return str(error)
    return f"{type(error).__name__}: {error}"


def is_diagnosed(future: Any) -> bool:
    """Whether it failed for what RayBatch knows of the machine, so that it would again (`calls.call`)."""
    error = future.exception() if future.status == "error" else None
    return type(error) is OSError and error.errno is None


def told(future: Any) -> Any:
    """The small result of a future that is done, or why there is none, as `calls.call` has errors; `is_lost`: it may
    well be there when it is asked for again.
    """
    if future.status != "finished":
        return {"text": why_lost(future), "is_lost": future.status != "error"}
    try:
        return future.result(timeout=_TOLD_SECONDS)
    except (TimeoutError, CancelledError, OSError):  # its worker ended meanwhile, and Dask would have it made again
        return {"text": "it was lost with its worker", "is_lost": True}
