"""The memory of the computer, and what this process has of it."""

from __future__ import annotations

import os
import sys


def host_memory_free() -> int:
    """Memory that this process may still take [bytes]; a very large number where the system does not say."""
    try:
        # what the kernel could free counts too
        with open("/proc/meminfo", encoding="ascii") as file:
            available = next(line for line in file if line.startswith("MemAvailable:"))
        return int(available.split()[1]) * 1024
    except (OSError, ValueError, StopIteration):
        return 2**63 - 1  # unknown here: allocation itself will show


def host_memory_peak() -> int:
    """Largest resident size of this process so far [bytes]; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def host_memory_used() -> int:
    """Resident size of this process [bytes]; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def size_text(size: int) -> str:
    """A number of bytes with a decimal unit and about three digits."""
    for unit, factor in (("GB", 10**9), ("MB", 10**6), ("KB", 10**3)):
        if size >= factor:
            return f"{size / factor:,.{0 if size >= 100 * factor else 1 if size >= 10 * factor else 2}f} {unit}"
    return f"{size} bytes"
