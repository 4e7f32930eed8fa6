"""A cluster on this computer whose workers stand for machines: each has an address of its own, and its own disk."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from testing.cluster_faults import worker_faults

ROOT = Path(__file__).resolve().parents[3]
# A machine whose programs ended starts them again after so long [s]
RESTARTED_AFTER = 1.0


class Machine:
    """A program of Dask's, the nanny, and its worker, at an address of their own."""

    def __init__(self, number: int, scheduler: str, folder: Path):
        """`folder`: holds what is on its disk."""
        self.host, self._scheduler, self._folder = f"127.0.0.{number + 2}", scheduler, folder
        self.parts, self._faults = folder / "parts", folder / "faults"
        for each in (self.parts, self._faults):
            each.mkdir(parents=True)
        self._ended: float | None = None
        self._process: subprocess.Popen | None = None
        self.start()

    def start(self) -> None:
        """Start the nanny, which starts the worker."""
        words = ["worker", self._scheduler, "--host", self.host, "--nworkers", "1", "--nthreads", "2"]
        words += ["--resources", "raybatch=1", "--no-dashboard", "--memory-limit", "0"]
        words += ["--preload", "testing.cluster_faults.worker_faults", "--local-directory", str(self._folder)]
        own = {"RAYBATCH_DEVICE": "cpu", "RAYBATCH_THREADS": "1", "RAYBATCH_PART_FOLDER": str(self.parts)}
        self._process, self._ended = _program(words, **own, **{worker_faults.FAULTS: str(self._faults)}), None

    def keep(self) -> None:
        """Start it again some time after it ended."""
        if self._process is not None and self._process.poll() is not None:
            self._ended = self._ended or time.monotonic()
            if time.monotonic() - self._ended > RESTARTED_AFTER:
                self.start()

    def noted(self, kind: str) -> list[float]:
        """When its workers noted faults of that kind (`worker_faults`), by the clock of `time.monotonic` [s]."""
        return worker_faults.noted(self._faults, kind)

    def worker(self) -> psutil.Process | None:
        """The process that works; None where it is not there yet, or ended."""
        with contextlib.suppress(psutil.Error):
            for each in psutil.Process(self._process.pid).children() if self._process else ():
                if any("spawn_main" in word for word in each.cmdline()):
                    return each
        return None

    def signal(self, number: int) -> bool:
        """Signal the worker; whether there is one."""
        worker = self.worker()
        with contextlib.suppress(psutil.Error):
            if worker is not None:
                worker.send_signal(number)
                return True
        return False

    @property
    def stands(self) -> bool:
        """Whether the worker is stopped: it does nothing, and heeds no signal but those that end it or let it go on."""
        worker = self.worker()
        with contextlib.suppress(psutil.Error):
            return worker is not None and worker.status() == psutil.STATUS_STOPPED
        return False

    def damage(self, is_wanted: bool = True) -> bool:
        """The next film that a worker sends is damaged, or is not; whether there is a worker."""
        wanted = self._faults / worker_faults.DAMAGE
        if is_wanted:
            wanted.touch()
        else:
            wanted.unlink(missing_ok=True)
        return self.worker() is not None

    def end(self) -> None:
        """Kill all of it: the machine goes."""
        worker = self.worker()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        with contextlib.suppress(psutil.Error):
            if worker is not None:
                worker.kill()

    def close(self) -> None:
        """Kill all of it for good."""
        self.end()
        self._process = None

    def fill_disk(self, is_full: bool) -> bool:
        """Whatever workers write to files fails, or no longer does, those that come later too; whether there is one."""
        worker, full = self.worker(), self._faults / worker_faults.FULL
        if is_full:
            full.touch()
        else:
            full.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            if worker is not None:
                worker_faults.fill_disk(worker.pid, is_full)
                return True
        return False

    def forget_parts(self) -> None:
        """What it has of scenes goes."""
        shutil.rmtree(self.parts, ignore_errors=True)
        self.parts.mkdir(exist_ok=True)


class Machines:
    """A scheduler and machines, whose programs start again when they end."""

    def __init__(self, folder: Path):
        self._folder, self.all = folder, list[Machine]()
        self._scheduler_file = folder / "scheduler.json"
        self._scheduler = _program(
            ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
            + ["--scheduler-file", str(self._scheduler_file)]
        )
        self.address = self._scheduler_address()
        self._over = threading.Event()
        self._keeper = threading.Thread(target=self._keep, name="machines are kept", daemon=True)
        self._keeper.start()

    @property
    def scheduler_pid(self) -> int:
        """The scheduler's process."""
        return self._scheduler.pid

    def _scheduler_address(self) -> str:
        import json

        while self._scheduler.poll() is None:
            with contextlib.suppress(OSError, ValueError, KeyError):
                return str(json.loads(self._scheduler_file.read_text())["address"])
            time.sleep(0.1)
        raise RuntimeError("Dask's scheduler does not start")

    def add(self) -> None:
        """Another machine comes."""
        number = len(self.all)
        self.all.append(Machine(number, self.address, self._folder / f"machine-{number}"))

    def _keep(self) -> None:
        while not self._over.wait(0.2):
            for machine in [*self.all]:
                machine.keep()

    def mend(self, connection: Any, seconds: float = 600.0) -> None:
        """All machines work, and have nothing of scenes; raises `RuntimeError` where they do not after some time."""
        for machine in self.all:
            machine.fill_disk(is_full=False)
            machine.damage(is_wanted=False)
            machine.signal(signal.SIGCONT)
        end = time.monotonic() + seconds
        while sorted(each.host for each in connection.workers()) != sorted(each.host for each in self.all):
            if time.monotonic() > end:
                raise RuntimeError(f"of {len(self.all)} workers {len(connection.workers())} came in {seconds:.0f} s")
            time.sleep(0.1)
        for machine in self.all:
            machine.fill_disk(is_full=False)  # a worker may have begun meanwhile
            machine.forget_parts()

    def close(self) -> None:
        """End all of it."""
        self._over.set()
        self._keeper.join()
        for machine in self.all:
            machine.close()
        self._scheduler.kill()
        self._scheduler.wait()


def _program(words: list[str], **environment: str) -> subprocess.Popen:
    """A program of Dask's, which finds the library and these scripts."""
    paths = [str(ROOT), str(ROOT / "scripts"), *filter(None, [os.environ.get("PYTHONPATH")])]
    own = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-m", f"distributed.cli.dask_{words[0]}", *words[1:]]
    return subprocess.Popen(command, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
