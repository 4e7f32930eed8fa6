"""The parts of a scene on their way to every machine of a cluster: once to each, and from machine to machine."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from .connection import ClusterError, Connection, Worker, told
from .parts import SceneParts
from .report.events import ClusterEvents

# Parts travel together up to this size, and so many bundles at once are on their way to a machine
_BUNDLE_BYTES, _AT_ONCE = 1 << 25, 4
_TRIES = 3
# A machine that failed so often is left out for so long: its disk may be full [s]
LEFT_OUT_SECONDS = 30.0
# Where all that are there are left out, one that went is waited for for so long: it may start again [s]
RETURN_SECONDS = 300.0


# Digests of parts that travel together
Bundle = tuple[str, ...]


class LeftOut:
    """Machines that a render asks for nothing for a while, since they failed where others may not: a disk is full, or
    memory is too small.
    """

    def __init__(self, events: ClusterEvents):
        self._events = events
        self._failures: dict[tuple[str, bool], int] = {}  # by host, and whether it was to keep parts of the scene
        self._until: dict[str, float] = {}  # by host
        self._spells: dict[str, int] = {}  # by host: times that it was left out since some machine did its part
        self._why = ""  # of the last of them

    def __contains__(self, host: str) -> bool:
        return host in self._until

    @property
    def hosts(self) -> set[str]:
        """Those that are left out."""
        return {*self._until}

    def others(self, hosts: Iterable[str]) -> frozenset[str] | None:
        """Those of `hosts` that are not left out; None where no machine is, or all of them are."""
        left = frozenset(hosts) - self.hosts
        return left if left and self.hosts else None

    @property
    def why(self) -> str:
        """Which machine was left out last, and why; empty where none is."""
        return self._why if self._until else ""

    def see(self, hosts: set[str], known: set[str]) -> None:
        """`hosts` are there, and render; `known` did not long ago, and may again. Raises `ClusterError` where all of
        these are left out, or were twice since some machine did its part.
        """
        now = time.monotonic()
        self._until = {host: end for host, end in self._until.items() if now < end}
        hopeless = self._until.keys() | {host for host, spells in self._spells.items() if spells > 1}
        if hosts and hosts | known <= hopeless:
            raise ClusterError(self._why)

    def count(self, host: str, why: str, is_certain: bool = False, keeping: bool = False) -> None:
        """`host` failed once more, where it was to keep parts of the scene or to do its part; it is left out where it
        did so often, or would again for certain.
        """
        failures = self._failures[host, keeping] = self._failures.get((host, keeping), 0) + 1
        if (is_certain or failures >= _TRIES) and host not in self:
            self._why = why
            self._events.note("MACHINE_LEFT_OUT", host, why)
            self._until[host] = time.monotonic() + LEFT_OUT_SECONDS
            self._spells[host] = self._spells.get(host, 0) + 1
            self._failures.pop((host, keeping))

    def keeps(self, host: str) -> None:
        """`host` has all parts: what failed before does not count any more."""
        self._failures.pop((host, True), None)

    def note_work(self) -> None:
        """Some machine did its part: the render gets on."""
        self._spells.clear()


class Staging:
    """Brings the parts of one scene to machines as they come. `step` goes on with it, and never waits."""

    def __init__(self, connection: Connection, parts: SceneParts, left_out: LeftOut):
        """`left_out`: is asked which machines are, and told which cannot keep the parts."""
        self._connection, self._parts, self._left_out = connection, parts, left_out
        self._asked: dict[str, tuple[str, Any]] = {}  # by host: the worker that was asked, and what its machine lacks
        self._lacking: dict[str, list[Bundle]] = {}  # by host
        self._sending: dict[tuple[str, Bundle], tuple[str, Any]] = {}  # by host and bundle: the worker, and the future
        self._sent: dict[Bundle, Any] = {}  # those in the memory of some worker
        self.ready: set[str] = set()  # hosts that have all

    def again(self) -> None:
        """A part is not on some machine after all: all are asked anew."""
        self.ready.clear()

    def step(self, workers: list[Worker]) -> None:
        """Look what came, and send what comes next; raises `ClusterError` where no machine can keep the parts, or do
        its part otherwise.
        """
        hosts = {each.host for each in workers if each.slots}
        self._left_out.see(hosts, self._connection.known_hosts(RETURN_SECONDS))
        self._drop_gone({each.address for each in workers})
        for worker in workers:
            if worker.slots and worker.host not in self.ready and not self._is_under_way(worker.host):
                digests = sorted(self._parts.arrays)
                self._asked[worker.host] = worker.address, self._submit("lacks", digests, worker=worker.address)
        for host, (address, future) in [*self._asked.items()]:
            if future.done():
                del self._asked[host]
                if (found := self._result(host, future)) is not None and host not in self._left_out:
                    self._lacking[host] = self._bundles(found)
                    self._go_on(host, address)
        for (host, bundle), (address, future) in [*self._sending.items()]:
            if future.done():
                del self._sending[host, bundle]
                came = self._result(host, future) is not None
                if host in self._left_out:  # by what else it did, perhaps: it is asked anew when it is back
                    self._lacking.pop(host, None)
                    continue
                if not came:
                    self._lacking.setdefault(host, []).append(bundle)
                self._go_on(host, address)
        if not self._sending:
            self._sent.clear()

    def _is_under_way(self, host: str) -> bool:
        is_sent = any(each == host for each, _ in self._sending)
        return host in self._asked or is_sent or host in self._left_out

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
            self._left_out.keeps(host)

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
        if not found.get("is_lost"):  # as where a busy worker does not answer in time
            self._left_out.count(host, f"{host} cannot keep the scene: {found['text']}", keeping=True)
        return None

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
