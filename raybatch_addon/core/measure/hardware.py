"""Counters of the processor itself, where the machine gives them: Linux `perf_event_open` (see its manual page).

They count what this process does in user mode, in the thread that opens them and in all threads that it starts
afterwards. Where there are more of them than the processor has registers for, Linux takes turns and the figures are
scaled.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import platform
import sys
from typing import Any

UNAVAILABLE = "unavailable"  # in place of a figure

_HARDWARE, _CACHE = 0, 3  # PERF_TYPE_HARDWARE, PERF_TYPE_HW_CACHE
_L1_DATA, _LAST_LEVEL, _DATA_TLB = 0, 2, 3
_MISS = 1 << 16  # PERF_COUNT_HW_CACHE_RESULT_MISS of reads
EVENTS: dict[str, tuple[int, int]] = {
    "cycles": (_HARDWARE, 0),
    "instructions": (_HARDWARE, 1),
    "l1_loads": (_CACHE, _L1_DATA),
    "l1_load_misses": (_CACHE, _L1_DATA | _MISS),
    "llc_loads": (_CACHE, _LAST_LEVEL),
    "llc_load_misses": (_CACHE, _LAST_LEVEL | _MISS),
    "tlb_load_misses": (_CACHE, _DATA_TLB | _MISS),
}
_SYSTEM_CALL = {"x86_64": 298, "aarch64": 241}
_DISABLED, _INHERIT, _EXCLUDE_KERNEL, _EXCLUDE_HYPERVISOR = 1 << 0, 1 << 1, 1 << 5, 1 << 6
_TIME_ENABLED_AND_RUNNING = 1 | 2
_ENABLE, _DISABLE = 0x2400, 0x2401
_CLOSE_ON_EXEC = 8


class _Attributes(ctypes.Structure):
    """`struct perf_event_attr`, its first version."""

    _fields_ = (
        ("type", ctypes.c_uint32),
        ("size", ctypes.c_uint32),
        ("config", ctypes.c_uint64),
        ("sample_period", ctypes.c_uint64),
        ("sample_type", ctypes.c_uint64),
        ("read_format", ctypes.c_uint64),
        ("flags", ctypes.c_uint64),
        ("wakeup_events", ctypes.c_uint32),
        ("breakpoint_type", ctypes.c_uint32),
        ("breakpoint_address", ctypes.c_uint64),
    )


def _open(kind: int, config: int) -> int:
    """File descriptor of a counter of this thread and its children; raises `OSError`."""
    number = _SYSTEM_CALL.get(platform.machine())
    if not sys.platform.startswith("linux") or number is None:
        raise OSError(errno.ENOSYS, f"they are read on Linux alone, on {' and '.join(_SYSTEM_CALL)}")
    attributes = _Attributes(
        type=kind,
        size=ctypes.sizeof(_Attributes),
        config=config,
        read_format=_TIME_ENABLED_AND_RUNNING,
        flags=_DISABLED | _INHERIT | _EXCLUDE_KERNEL | _EXCLUDE_HYPERVISOR,
    )
    system_call = ctypes.CDLL(None, use_errno=True).syscall
    descriptor = system_call(
        ctypes.c_long(number),
        ctypes.byref(attributes),
        ctypes.c_int(0),
        ctypes.c_int(-1),
        ctypes.c_int(-1),
        ctypes.c_ulong(_CLOSE_ON_EXEC),
    )
    if descriptor < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return descriptor


def _why(error: OSError) -> str:
    """What `error` means for a counter, and what to do."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return (
            "not permitted: set kernel.perf_event_paranoid to 2 or less, and let perf_event_open through if this "
            "is a container"
        )
    if error.errno in (errno.ENOENT, errno.EOPNOTSUPP, errno.ENODEV):
        return "this machine does not have them (virtual machines often do not)"
    return error.strerror or str(error)


class HardwareCounters:
    """Counts while it is entered: `with HardwareCounters() as counters: ...; counters.report()`.

    Threads that are to be counted are started within.
    """

    def __init__(self):
        self._descriptors: dict[str, int] = {}
        self._reason = ""
        self._values: dict[str, int] = {}

    def __enter__(self) -> HardwareCounters:
        for name, (kind, config) in EVENTS.items():
            try:
                self._descriptors[name] = _open(kind, config)
            except OSError as error:
                self._reason = self._reason or _why(error)
        self._control(_ENABLE)
        return self

    def __exit__(self, *_) -> None:
        self._control(_DISABLE)
        for name, descriptor in self._descriptors.items():
            with contextlib.suppress(OSError):
                value, enabled, running = (
                    int.from_bytes(part, sys.byteorder) for part in _thirds(os.read(descriptor, 24))
                )
                if running:
                    self._values[name] = round(value * enabled / running)
            os.close(descriptor)
        self._descriptors = {}

    def report(self) -> dict[str, Any]:
        """Each of `EVENTS` as a number or "unavailable", and `reason` where any is."""
        found: dict[str, Any] = {name: self._values.get(name, UNAVAILABLE) for name in EVENTS}
        if len(self._values) < len(EVENTS):
            found["reason"] = self._reason or "the processor had no register free for them"
        return found

    def _control(self, request: int) -> None:
        if self._descriptors:
            import fcntl

            for descriptor in self._descriptors.values():
                fcntl.ioctl(descriptor, request, 0)


class CudaHardwareCounters(contextlib.AbstractContextManager):
    """Stands for `HardwareCounters` on a CUDA device, which counts for a profiler alone."""

    def __exit__(self, *_) -> None:
        return None

    def report(self) -> dict[str, Any]:
        """Everything is unavailable."""
        return {
            **dict.fromkeys(EVENTS, UNAVAILABLE),
            "reason": "CUDA devices count for a profiler alone: run this under ncu",
        }


def hardware_counters(is_cuda: bool) -> HardwareCounters | CudaHardwareCounters:
    """Counters for a render on a device of this kind."""
    return CudaHardwareCounters() if is_cuda else HardwareCounters()


def _thirds(data: bytes) -> tuple[bytes, bytes, bytes]:
    return data[:8], data[8:16], data[16:24]
