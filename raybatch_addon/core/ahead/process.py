"""A process that compiles kernels into the cache: the render beside it keeps Python to itself, and may end without
waiting for a compiler.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import warp as wp

    from .request import Request

_PACKAGE_FOLDER = Path(__file__).resolve().parents[2]
_CHILD = "import sys; sys.path[:0] = [sys.argv[1]]; from core.ahead.process import compile_as_asked; compile_as_asked()"
_NICENESS = 10
_COMPLAINT_LENGTH = 1000
_LENGTHS = "<QQ"  # of the order and of the request, before both
_PROGRESS = "modules: "  # begins a line of the answer that says how many modules there are, and of how many
_ANSWER_SECONDS = 5.0  # that the answer of a process that has ended is waited for: another may hold its pipe
_lock = threading.Lock()
_running: list[CompileProcess] = []  # and some that have ended


class CompileProcess:
    """Compiles kernels; begins at once, and ends with this process at the latest. Warp need not be there yet."""

    def __init__(self, device: str, cache_folder: str | Path, request: Request | None = None, hurried: bool = False):
        """For `device` (AUTO, cpu, cuda:N, or ALL: the CPU and a GPU of each kind) into `cache_folder`.

        `request`: what to compile (default: the general kernels). `hurried`: a render that keeps all cores busy waits
        for it; else it has low priority. Raises `OSError` where no process can be started.
        """
        self._last_line = ""
        self.progress: tuple[int, int] | None = None  # modules that are there, and all; None: not counted yet
        order = {
            "paths": [path for path in sys.path if path],
            "cache": str(cache_folder),
            "device": device,
            "niceness": 0 if hurried else _NICENESS,
            "core": __name__.removesuffix("ahead.process"),
        }
        data = b""
        if request is not None:
            from .request import encode_request

            data = encode_request(request)
        head = json.dumps(order).encode()
        flags = 0
        if sys.platform == "win32":
            flags = subprocess.CREATE_NO_WINDOW | (0 if hurried else subprocess.BELOW_NORMAL_PRIORITY_CLASS)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _CHILD, str(_PACKAGE_FOLDER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            creationflags=flags,
        )
        assert self._process.stdin is not None and self._process.stderr is not None  # pipes
        # else the answer would fill its pipe
        self._reader = threading.Thread(target=self._read, args=(self._process.stderr,), daemon=True)
        with _lock:
            _running[:] = [each for each in _running if each.is_running] + [self]
        try:
            self._reader.start()
        except RuntimeError as error:
            self.stop()
            self._process.stdin.close()
            self._process.stderr.close()
            raise OSError(f"no thread can be had for its answer: {error}") from error
        with contextlib.suppress(OSError):  # it has ended: `complaint` says why
            # the pipe stays open: its end lets the other process know that this one is gone
            self._process.stdin.write(struct.pack(_LENGTHS, len(head), len(data)) + head + data)
            self._process.stdin.flush()

    @property
    def is_running(self) -> bool:
        """Whether it still compiles."""
        return self._process.poll() is None

    def complaint(self) -> str:
        """Why it failed, in a line; empty where it did not, or has not ended."""
        if self._process.poll() in (None, 0):
            return ""
        return self._report() or f"it ended with code {self._process.returncode}"

    def notes(self) -> str:
        """What is to be known of it although it did not fail, in a line; empty as long as it compiles."""
        return self._report() if self._process.poll() == 0 else ""

    def _report(self) -> str:
        self._reader.join(_ANSWER_SECONDS)
        return self._last_line

    def _read(self, pipe: BinaryIO) -> None:
        """Take in the answer, line by line, until its end."""
        with pipe:
            for line in pipe:
                text = line.decode("utf-8", "replace").strip()
                if text.startswith(_PROGRESS):
                    done, total = text.removeprefix(_PROGRESS).split()
                    self.progress = int(done), int(total)
                elif text:
                    self._last_line = text

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()

    def stop(self) -> None:
        """End it, however far it is."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
            if self._reader.is_alive():
                self._reader.join(_ANSWER_SECONDS)


def stop_all() -> None:
    """End all processes that still compile."""
    with _lock:
        running = list(_running)
    for each in running:
        each.stop()


atexit.register(stop_all)


def compile_as_asked() -> None:
    """The other process: compile what standard input asks for."""
    # compilers may write what nobody asked for: the answer is how far this is, and in the end one line
    answer = os.fdopen(os.dup(2), "w", buffering=1, encoding="utf-8")
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), 2)
    try:
        pipe = sys.stdin.buffer
        head_length, data_length = struct.unpack(_LENGTHS, pipe.read(struct.calcsize(_LENGTHS)))
        order: dict[str, Any] = json.loads(pipe.read(head_length))
        data = pipe.read(data_length)
        if hasattr(os, "nice"):
            os.nice(order["niceness"])
        threading.Thread(target=_end_with, args=(pipe,), daemon=True).start()
        sys.path += [path for path in order["paths"] if path not in sys.path]
        from ..device.devices import find_device, load_kernels, one_of_each_kind, start_warp
        from ..device.kept_kernels import keep_or_fail, remove_abandoned
        from ..device.notes import take_notes
        from .request import GeneralRequest, decode_request

        keep_or_fail()
        start_warp(order["cache"])
        remove_abandoned()
        request = decode_request(data, order["core"]) if data else GeneralRequest()
        devices = [find_device(order["device"])] if order["device"] != "ALL" else one_of_each_kind()
        kernels: list[tuple[wp.Device, list[wp.Kernel]]] = []
        failures: list[Exception] = []  # one device's do not stop another's
        for device in devices:
            try:
                kernels.append((device, request.kernels(device)))
            except Exception as error:
                failures.append(error)
        total, before = sum(len({each.module.name for each in of_one}) for _, of_one in kernels), 0
        for device, of_one in kernels:

            def tell(done: int, _of_device: int, before: int = before) -> None:
                answer.write(f"{_PROGRESS}{before + done} {total}\n")

            try:
                before += len(load_kernels(of_one, device, tell))
            except Exception as error:
                failures.append(error)
        if failures:
            raise failures[0]
        answer.write("; ".join(take_notes()))
        answer.close()
    except Exception as error:  # whatever it is, who asked goes on without, and says so
        answer.write(f"{type(error).__name__}: {error}".replace("\n", " ")[:_COMPLAINT_LENGTH])
        answer.close()
        os._exit(1)
    os._exit(0)  # a thread still reads the pipe


def _end_with(pipe: BinaryIO) -> None:
    """End this process when nobody holds the other end of `pipe` any more."""
    pipe.read()
    os._exit(1)
