"""Arrays of the host that lie in files without names: what is read of them comes into memory, and goes again where the
system needs its place.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OutOfMemoryError

Room = Callable[[tuple[int, ...], Any], np.ndarray]
"""Makes arrays of a shape and type, whose contents are not known: `numpy.empty`, or `mapped_empty` in a folder."""

MAPPED_LEAST = 1 << 26
"""Smaller arrays are in memory: a file for each would save little [bytes]."""
# Bytes that are written together where the system cannot take hold of room on a disk
_WRITTEN = 1 << 26


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
