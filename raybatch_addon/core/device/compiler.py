"""Warp's compiler for CPUs, in a process of its own for each module.

Inside Blender's process a compiler would write its diagnostics between everybody's lines, could not be stopped before
it is ready (not even by Blender's end), and where a disk is full it would end Blender with itself. A process takes 0.1
seconds longer.
"""

from __future__ import annotations

import base64
import contextlib
import ctypes
import errno
import json
import os
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from typing import Any

import warp as wp

_LENGTH = "<Q"  # of the order, before it
_POLL_SECONDS = 0.05
# Reads the call from standard input and makes it; ends when nobody holds the other end any more. It imports nothing of
# ours: it starts in a hundredth of a second.
_CHILD = """
import base64, ctypes, json, os, signal, struct, sys, threading, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
pipe = sys.stdin.buffer
library, function, arguments = json.loads(pipe.read(*struct.unpack("<Q", pipe.read(8))))
def end():
    pipe.read()
    os._exit(1)
threading.Thread(target=end, daemon=True).start()
def decode(value):
    if isinstance(value, dict):
        return ctypes.c_char_p(base64.b64decode(value["bytes"]))
    if isinstance(value, list):
        return (ctypes.c_char_p * (len(value) + 1))(*[each.encode() for each in value], None)
    kind = {bool: ctypes.c_bool, int: ctypes.c_int}.get(type(value), ctypes.c_char_p)
    return kind(value)
failed = getattr(ctypes.CDLL(library), function)(*map(decode, arguments))
print(time.process_time(), flush=True)
os._exit(1 if failed else 0)
"""

_lock = threading.Lock()
_running: set[subprocess.Popen] = set()
_ending = False  # this process ends, nothing more is compiled
_local = threading.local()
processor_seconds = 0.0  # that compilers took so far


class CompileError(Exception):
    """A compiler that failed; `log` is what it wrote, `code` its exit code: below 0 where a signal ended it."""

    def __init__(self, summary: str, log: str, code: int = 1):
        super().__init__(summary)
        self.log, self.code = log, code

    @property
    def lack_of_room(self) -> OSError | None:
        """The error of the file system that the compiler complains of, if it is one of a folder that is full."""
        lacks = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
        return next((OSError(each, os.strerror(each)) for each in lacks if os.strerror(each) in self.log), None)


class CompileStoppedError(RuntimeError):
    """A compiler that was stopped, because nobody waits for it."""


@contextlib.contextmanager
def given_up_when(given_up: Callable[[], bool] | None) -> Iterator[None]:
    """Inside, compilers that this thread starts are stopped once `given_up` says so."""
    before = given_up_now()
    _local.given_up = given_up
    try:
        yield
    finally:
        _local.given_up = before


def given_up_now() -> Callable[[], bool] | None:
    """What stops compilers of this thread."""
    return getattr(_local, "given_up", None)


def compile_apart() -> None:
    """Let Warp compile for the CPU in processes of their own from now on; called after `wp.init`."""
    library = wp._src.context.runtime.llvm
    within = getattr(library, "wp_compile_cpp", None)
    if within is None or getattr(within, "is_apart", False):
        return

    def compile_cpp(*arguments: Any) -> int:
        call = json.dumps([library._name, "wp_compile_cpp", [_encoded(each) for each in arguments]]).encode()
        try:
            log_file = tempfile.TemporaryFile()  # noqa: SIM115 (closed below)
        except OSError:
            log_file = None  # no room for a log: it is compiled all the same
        with log_file or contextlib.nullcontext():
            try:
                process = _start(log_file)
            except OSError:  # no process can be had
                return within(*arguments)
            _finish(process, call)
            if process.returncode == 0:
                return 0
            log = ""
            if log_file:
                log_file.seek(0)
                log = log_file.read().decode("utf-8", "replace")
            raise CompileError(_summary(log, process.returncode), log, process.returncode)

    compile_cpp.is_apart = True
    library.wp_compile_cpp = compile_cpp
    # before the interpreter waits for threads, which wait for compilers
    getattr(threading, "_register_atexit", lambda _: None)(_end)


def _start(log_file: Any) -> subprocess.Popen:
    with _lock:
        if _ending:
            raise CompileStoppedError
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _CHILD],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log_file or subprocess.DEVNULL,
            creationflags=subprocess.CREATE_NO_WINDOW if sys.platform == "win32" else 0,
        )
        _running.add(process)
        return process


def _finish(process: subprocess.Popen, call: bytes) -> None:
    """Hand over the call and wait; raises `CompileStoppedError` where it was stopped."""
    global processor_seconds
    given_up = given_up_now()
    try:
        with contextlib.suppress(OSError):  # it has ended: its code says so
            process.stdin.write(struct.pack(_LENGTH, len(call)) + call)
            process.stdin.flush()
        while True:
            try:
                process.wait(_POLL_SECONDS)
                break
            except subprocess.TimeoutExpired:
                if given_up is not None and given_up():
                    raise CompileStoppedError from None
        if process.returncode and _ending:
            raise CompileStoppedError
        with contextlib.suppress(ValueError):
            seconds = float(process.stdout.read())
            with _lock:
                processor_seconds += seconds
    finally:
        process.kill()
        process.wait()
        with _lock:
            _running.discard(process)
        process.stdout.close()
        with contextlib.suppress(OSError):
            process.stdin.close()


def _end() -> None:
    global _ending
    _ending = True
    with _lock:
        for process in _running:
            process.kill()


def _encoded(value: Any) -> Any:
    """`value` as JSON can hold it."""
    if isinstance(value, bytes):
        return {"bytes": base64.b64encode(value).decode()}
    if isinstance(value, ctypes.Array):
        return [each.decode() for each in value if each is not None]
    return value


def _summary(log: str, code: int) -> str:
    """What went wrong, in a line."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    for mark in ("LLVM ERROR:", "fatal error:", "error:"):
        for line in lines:
            if mark in line:
                return line.partition(mark)[2].strip()
    return lines[-1] if lines else f"the compiler ended with code {code}"
