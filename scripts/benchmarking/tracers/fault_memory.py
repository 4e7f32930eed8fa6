"""Memory of which a part is there at a time: pages come when a thread runs into them, and the oldest make room.

It stands for a file that the system maps where memory is short, with two differences: what comes is copied from other
memory, so no disk is measured, and what is there is known to the byte. Linux's userfaultfd tells which page a thread
waits for.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import select
import struct
import sys
import threading
from collections import deque

import numpy as np
import warp as wp
from lib.command import UsageError

PAGE = 1 << 16
"""Bytes that come at a time: a multiple of the system's pages."""
_SYSCALL = {"x86_64": 323, "aarch64": 282}  # userfaultfd
_USER_MODE_ONLY = 1
_API, _REGISTER, _COPY, _WAKE = 0xC018AA3F, 0xC020AA00, 0xC028AA03, 0x8010AA02  # ioctls: linux/userfaultfd.h
_API_VERSION, _MODE_MISSING, _PAGE_FAULT = 0xAA, 1, 0x12
_MESSAGE, _ADDRESS_AT = 32, 16  # bytes of an event, and where its address is


def _opened() -> int:
    """A descriptor for page faults; raises `UsageError` where the system has none for this process."""
    number = _SYSCALL.get(platform.machine()) if platform.system() == "Linux" else None
    if number is None:
        raise UsageError(f"--beyond needs Linux on x86_64 or aarch64, and this is {platform.system()}: leave it out")
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = libc.syscall(number, os.O_CLOEXEC | os.O_NONBLOCK | _USER_MODE_ONLY)
    if descriptor < 0:
        raise UsageError(
            f"--beyond cannot see page faults (userfaultfd: {os.strerror(ctypes.get_errno())}): allow it, by sysctl "
            "vm.unprivileged_userfaultfd=1 or in the container's rules, or leave --beyond out"
        )
    return descriptor


class FaultMemory:
    """Read-only copies of arrays, of which `budget` bytes at most are there. While a thread is in a kernel any page may
    come and go; Python itself must not read the arrays, since the thread that brings pages needs the interpreter.
    """

    def __init__(self, arrays: list[wp.array], budget: int):
        """Of `arrays` on the CPU; `budget` [bytes], at least one page. Raises `UsageError`."""
        if budget < PAGE:
            raise UsageError(f"--budget {budget} is less than a page of --beyond: give {PAGE} bytes or more")
        self._pages_most = budget // PAGE
        firsts = np.cumsum(
            [0, *(-(-array.size * wp.types.type_size_in_bytes(array.dtype) // PAGE) for array in arrays)]
        )
        self._descriptor = _opened()
        self._memory = mmap.mmap(-1, max(1, int(firsts[-1])) * PAGE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self._memory.madvise(mmap.MADV_NOHUGEPAGE)
        self._source = np.zeros(len(self._memory), np.uint8)
        self._at = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        self.arrays: list[wp.array] = []
        for array, first in zip(arrays, firsts * PAGE, strict=False):
            data = np.ascontiguousarray(array.numpy()).view(np.uint8).reshape(-1)
            self._source[first : first + len(data)] = data
            self.arrays.append(wp.array(ptr=self._at + int(first), dtype=array.dtype, shape=array.shape, device="cpu"))
        self._there: deque[int] = deque()
        self._is_there = bytearray(len(self._memory) // PAGE)
        self.pages_brought = 0
        self._ioctl(_API, struct.pack("=QQQ", _API_VERSION, 0, 0))
        self._ioctl(_REGISTER, struct.pack("=QQQQ", self._at, len(self._memory), _MODE_MISSING, 0))
        self._end_read, self._end_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="page faults", daemon=True)
        self._thread.start()

    @property
    def bytes_brought(self) -> int:
        """What came so far [bytes]."""
        return self.pages_brought * PAGE

    def close(self) -> None:
        """End the thread; nobody reads the arrays any more."""
        os.write(self._end_write, b"x")
        self._thread.join()
        for descriptor in (self._descriptor, self._end_read, self._end_write):
            os.close(descriptor)

    def _ioctl(self, request: int, argument: bytes) -> None:
        import fcntl

        fcntl.ioctl(self._descriptor, request, bytearray(argument))

    def _serve(self) -> None:
        poll = select.poll()
        for descriptor in (self._descriptor, self._end_read):
            poll.register(descriptor, select.POLLIN)
        while not any(descriptor == self._end_read for descriptor, _ in poll.poll()):
            try:
                told = os.read(self._descriptor, 64 * _MESSAGE)
            except BlockingIOError:  # a thread that was woken meanwhile
                continue
            try:
                for first in range(0, len(told), _MESSAGE):
                    if told[first] == _PAGE_FAULT:
                        address = struct.unpack_from("=Q", told, first + _ADDRESS_AT)[0]
                        self._bring((address - self._at) // PAGE)
            except OSError as error:  # who waits for a page would wait for ever
                print(f"--beyond: a page could not be brought in ({error})", file=sys.stderr, flush=True)
                os._exit(1)

    def _bring(self, page: int) -> None:
        target = self._at + page * PAGE
        if self._is_there[page]:  # another thread asked first
            self._ioctl(_WAKE, struct.pack("=QQ", target, PAGE))
            return
        if len(self._there) >= self._pages_most:
            oldest = self._there.popleft()
            self._is_there[oldest] = 0
            self._memory.madvise(mmap.MADV_DONTNEED, oldest * PAGE, PAGE)
        self._there.append(page)
        self._is_there[page] = 1
        self.pages_brought += 1
        source = self._source.ctypes.data + page * PAGE
        self._ioctl(_COPY, struct.pack("=QQQQq", target, source, PAGE, 0, 0))
