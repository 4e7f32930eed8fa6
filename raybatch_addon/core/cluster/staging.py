"""The parts of a scene on their way to every machine of a cluster: once to each, and from machine to machine."""

from __future__ import annotations

import time
from typing import Any

from .connection import ClusterError, Connection, Worker, told
from .parts import SceneParts
from .report.events import ClusterEvents

# Parts travel together up to this size, and so many bundles at once are on their way to a machine
_BUNDLE_BYTES, _AT_ONCE = 1 << 25, 4
_TRIES = 3
# A machine that failed so often is left out for so long, where others have the scene: its disk may be full [s]
LEFT_OUT_SECONDS = 30.0


# Digests of parts that travel together
Bundle = tuple[str, ...]


class Staging:
    """Brings the parts of one scene to machines as they come. `step` goes on with it, and never waits."""

    def __init__(self, connection: Connection, parts: SceneParts, events: ClusterEvents):
        self._connection, self._parts, self._events = connection, parts, events
        self._asked: dict[str, tuple[str, Any]] = {}  # by host: the worker that was asked, and what its machine lacks
        self._lacking: dict[str, list[Bundle]] = {}  # by host
        self._sending: dict[tuple[str, Bundle], tuple[str, Any]] = {}  # by host and bundle: the worker, and the future
        self._sent: dict[Bundle, Any] = {}  # those in the memory of some worker
        self._failures: dict[str, int] = {}  # by host
        self._left_out: dict[str, float] = {}  # hosts that cannot keep the scene: until when
        self._why = ""  # of the last of them
        self.ready: set[str] = set()  # hosts that have all
        self._was_ready = False  # some host had all: it may come back

    def again(self) -> None:
        """A part is not on some machine after all: all are asked anew."""
        self.ready.clear()

    def step(self, workers: list[Worker]) -> None:
        """Look what came, and send what comes next; raises `ClusterError` where no machine can keep them."""
        there = {each.address for each in workers}
        self._drop_gone(there)
        now, hosts = time.monotonic(), {each.host for each in workers if each.slots}
        self._left_out = {host: end for host, end in self._left_out.items() if now < end}
        if hosts and hosts <= self._left_out.keys() and not self._was_ready:
            raise ClusterError(self._why)
        for worker in workers:
            if worker.slots and worker.host not in self.ready and not self._is_under_way(worker.host):
                digests = sorted(self._parts.arrays)
                self._asked[worker.host] = worker.address, self._submit("lacks", digests, worker=worker.address)
        for host, (address, future) in [*self._asked.items()]:
            if future.done():
                del self._asked[host]
                if (found := self._result(host, future)) is not None:
                    self._lacking[host] = self._bundles(found)
                    self._go_on(host, address)
        for (host, bundle), (address, future) in [*self._sending.items()]:
            if future.done():
                del self._sending[host, bundle]
                if self._result(host, future) is None and host not in self._left_out:
                    self._lacking.setdefault(host, []).append(bundle)
                if host not in self._left_out:
                    self._go_on(host, address)
        if not self._sending:
            self._sent.clear()

    def _is_under_way(self, host: str) -> bool:
        return host in self._asked or host in self._lacking or host in self._left_out

    def _go_on(self, host: str, address: str) -> None:
        """Send what `host` lacks, some at a time; it is ready where it lacks nothing."""
        left = self._lacking.get(host, [])
        while left and sum(each == host for each, _ in self._sending) < _AT_ONCE:
            bundle = left.pop()
            if bundle not in self._sent:  # else it goes from the worker that has it
                arrays = {digest: self._parts.arrays[digest] for digest in bundle}
                self._sent[bundle] = self._connection.send(arrays, address)
            self._sending[host, bundle] = address, self._submit("put", self._sent[bundle], worker=address)
        if not left and not any(each == host for each, _ in self._sending):
            self._lacking.pop(host, None)
            self.ready.add(host)
            self._was_ready = True

    def _bundles(self, digests: list[str]) -> list[Bundle]:
        bundles, own, size = [], list[str](), 0
        for digest in digests:
            own.append(digest)
            size += self._parts.arrays[digest].nbytes
            if size >= _BUNDLE_BYTES:
                bundles.append(tuple(own))
                own, size = [], 0
        return [*bundles, tuple(own)] if own else bundles

    def _submit(self, name: str, *arguments: Any, worker: str) -> Any:
        return self._connection.submit(name, *arguments, workers=[worker], priority=100)

    def _result(self, host: str, future: Any) -> Any:
        """What came; None where it failed, and is tried again or `host` left out."""
        found = told(future)
        if not isinstance(found, dict):
            return found
        why = found["text"]
        self._failures[host] = self._failures.get(host, 0) + 1
        if self._failures[host] >= _TRIES:
            self._leave_out(host, why)
        return None

    def _leave_out(self, host: str, why: str) -> None:
        """Ask nothing of `host` for a while."""
        self._why = f"{host} cannot keep the scene: {why}"
        self._events.note("MACHINE_LEFT_OUT", host, self._why)
        self._left_out[host] = time.monotonic() + LEFT_OUT_SECONDS
        self._failures.pop(host)
        self._lacking.pop(host, None)

    def _drop_gone(self, there: set[str]) -> None:
        """Forget what was asked of workers that are gone: another one of their machine is asked anew."""
        gone = {host for host, (address, _) in self._asked.items() if address not in there}
        gone |= {host for (host, _), (address, _) in self._sending.items() if address not in there}
        for host in gone:
            self._asked.pop(host, None)
            self._lacking.pop(host, None)
            for key in [key for key in self._sending if key[0] == host]:
                del self._sending[key]
        if gone:
            self._sent.clear()  # perhaps in the memory of one of them
