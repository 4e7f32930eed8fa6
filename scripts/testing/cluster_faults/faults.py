"""What befalls workers in a render: faults drawn by chance, each at some moment of it, and how they are done."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from testing.cluster_faults.machines import Machine
from testing.cluster_faults.worker_faults import CUT

# By kind: what the report of the render should have of it, and what the table says
KINDS: dict[str, tuple[tuple[str, ...], str]] = {
    "killed": (("WORKER_GONE",), "its process is killed (SIGKILL)"),
    "machine killed": (("WORKER_GONE",), "its process and the one that would start it again are killed"),
    "cut off": (("WORKER_GONE",), "all its connections end"),
    "stopped": (("WORKER_SILENT", "TASK_LATE"), "it is stopped (SIGSTOP) till the end"),
    "paused": (("WORKER_SILENT", "TASK_LATE"), "it is stopped, and goes on after up to six seconds"),
    "slowed": (("WORKER_SILENT", "TASK_LATE"), "it has a fifth of its processor for some seconds"),
    "disk full": (("MACHINE_LEFT_OUT",), "nothing can be written to its disk, and it lacks the scene"),
    "result damaged": (("FILM_DAMAGED",), "one bit of a film that it sends is another one"),
}
# Of these a worker does not recover before the end of the render: one at least must be left
FOR_GOOD = ("stopped", "disk full")
# Of these a machine has one in a render: what goes on again by one would end another
STANDS = ("stopped", "paused", "slowed")
FAULTS_MOST = 4  # in a render
PAUSE_SECONDS = (0.5, 6.0)
SLOW_SECONDS = (2.0, 8.0)
SLOW_TURN = (0.08, 0.02)  # a slowed worker stands, and works [s]


@dataclass
class Fault:
    """One fault of one machine."""

    kind: str
    machine: int
    moment: float  # the share of the render's samples that are there; below 0: before the first
    seconds: float  # how long it lasts, where that is drawn [s]
    done_at: float | None = None  # clock [s]; None: it did not come to it

    @property
    def is_done(self) -> bool:
        """Whether it happened."""
        return self.done_at is not None


def drawn(random: np.random.Generator, machines: int) -> list[Fault]:
    """The faults of one render, in the order of their moments."""
    faults: list[Fault] = []
    for _ in range(int(random.integers(1, FAULTS_MOST + 1))):
        kind, machine = str(random.choice(list(KINDS))), int(random.integers(machines))
        out = {each.machine for each in faults if each.kind in FOR_GOOD}
        stands = {each.machine for each in faults if each.kind in STANDS}
        if (kind in FOR_GOOD and len(out | {machine}) == machines) or (kind in STANDS and machine in stands):
            kind = "killed"
        moment = -0.1 if kind == "disk full" else float(random.uniform(-0.1, 0.95))
        low, high = SLOW_SECONDS if kind == "slowed" else PAUSE_SECONDS
        faults.append(Fault(kind, machine, moment, float(random.uniform(low, high))))
    return sorted(faults, key=lambda each: each.moment)


class FaultsOfRender:
    """Does the faults of a render as it comes to their moments."""

    def __init__(self, faults: list[Fault], machines: Sequence[Machine]):
        self._faults, self._left, self._machines = faults, [*faults], machines
        self._threads: list[threading.Thread] = []
        self._over = threading.Event()

    def come_to(self, fraction: float) -> None:
        """So much of the render is done: do what is due. Where a machine has no worker that can, it is tried again."""
        for fault in [each for each in self._left if each.moment <= fraction]:
            now = time.monotonic()
            if self._do(fault, self._machines[fault.machine]):
                fault.done_at = now
                self._left.remove(fault)

    def _do(self, fault: Fault, machine: Machine) -> bool:
        if fault.kind == "machine killed":
            machine.end()
            return True
        if fault.kind == "disk full":
            return machine.fill_disk(is_full=True)
        if fault.kind == "result damaged":
            return machine.damage()
        if fault.kind == "cut off" and machine.stands:  # it cuts itself off, once it goes on
            return False
        number = {"killed": signal.SIGKILL, "cut off": signal.SIGUSR2}
        done = machine.signal(number.get(fault.kind, signal.SIGSTOP))
        if done and fault.kind == "paused":
            self._begin(lambda: self._pause(machine, fault.seconds))
        elif done and fault.kind == "slowed":
            self._begin(lambda: self._slow(machine, fault.seconds))
        return done

    def _begin(self, work: Callable[[], None]) -> None:
        self._threads.append(threading.Thread(target=work))
        self._threads[-1].start()

    def _pause(self, machine: Machine, seconds: float) -> None:
        self._over.wait(seconds)
        machine.signal(signal.SIGCONT)

    def _slow(self, machine: Machine, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self._over.is_set():
            machine.signal(signal.SIGSTOP)
            time.sleep(SLOW_TURN[0])
            machine.signal(signal.SIGCONT)
            time.sleep(SLOW_TURN[1])

    def note_when(self, ended: float) -> None:
        """Once the render is over, which `ended` then [s]: workers that were cut off did that to themselves, at once or
        when they went on; or they ended before.
        """
        for fault in self._faults:
            if fault.kind == "cut off" and fault.done_at is not None:
                noted = self._machines[fault.machine].noted(CUT)
                fault.done_at = next((each for each in noted if fault.done_at <= each <= ended), None)

    def end(self) -> None:
        """The render is over: nothing more befalls a machine."""
        self._over.set()
        for thread in self._threads:
            thread.join()
