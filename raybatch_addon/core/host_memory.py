"""The memory of the computer, what this process has of it, and arrays that lie in files without names instead: what is
read of them comes into memory, and goes again where the system needs its place.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .errors import OutOfMemoryError

Room = Callable[[tuple[int, ...], Any], np.ndarray]
"""Makes arrays of a shape and type, whose contents are not known: `numpy.empty`, or `mapped_empty` in a folder."""

MAPPED_LEAST = 1 << 26
"""Smaller arrays are in memory: a file for each would save little [bytes]."""
# Bytes that are written together where the system cannot take hold of room on a disk
_WRITTEN = 1 << 26


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


def mapped_empty(shape: tuple[int, ...], dtype: Any, folder: Path) -> np.ndarray:
    """An array in a file in `folder`, which is made and gone with the array; one below `MAPPED_LEAST` is in memory.

    Raises `OutOfMemoryError` where `folder` has no room for it.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < MAPPED_LEAST:
        return np.empty(shape, dtype)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder, prefix="raybatch-") as file:
            _take_room(file.fileno(), size)
            return np.asarray(np.memmap(file, dtype, "r+", shape=shape))
    except OSError as error:
        raise OutOfMemoryError(
            f"{size / 1e9:.2f} GB of geometry cannot be laid down in {folder} ({error.strerror or error}); free some "
            "space there, or choose another folder"
        ) from error


def _take_room(handle: int, size: int) -> None:
    """Give the file `size` bytes that are there when they are written; raises `OSError`."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(handle, 0, size)
        return
    zeros = bytes(_WRITTEN)
    for first in range(0, size, _WRITTEN):
        rest = memoryview(zeros)[: size - first]
        while len(rest):
            rest = rest[os.write(handle, rest) :]
