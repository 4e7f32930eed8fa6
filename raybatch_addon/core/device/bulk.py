"""Large arrays of the host, filled and hashed by threads: NumPy lets go of Python's lock meanwhile."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from ..native.structs import record_type
from .devices import worker_count

# Rows that a thread works on together
_SLICE_ROWS = 1 << 20
# Rows that NumPy compares together
_ROWS_AT_ONCE = 64
# Bytes that are hashed together
_SLICE_BYTES = 1 << 26


# Types of Warp's arrays as those of NumPy's
_HOST_TYPES = {int: (np.int32, ()), float: (np.float32, ()), wp.vec3: (np.float32, (3,))}


def large_empty(count: int, dtype: Any, device: wp.Device, zeros: bool = False) -> wp.array:
    """An array like that of `wp.empty` (or `wp.zeros`) for int, float, vec3 and structs. On a CPU its memory is
    NumPy's, who asks the system for large pages: to touch hundreds of megabytes of small ones for the first time takes
    longer than to fill them.
    """
    if not device.is_cpu:
        return wp.zeros(count, dtype=dtype, device=device) if zeros else wp.empty(count, dtype=dtype, device=device)
    base, shape = _HOST_TYPES.get(dtype) or (record_type(dtype), ())
    values = (np.zeros if zeros else np.empty)((count, *shape), base)
    return wp.array(values, dtype=dtype, device=device, copy=False)


def in_slices(count: int, work: Callable[[slice], object], size: int = 0) -> None:
    """Call `work` for slices of at most `size` (0: what is worth a thread for rows) that cover 0..count, each in a
    thread; raises what one of them raised.
    """
    size = size or _SLICE_ROWS
    if count <= size:
        work(slice(0, count))
        return
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    with ThreadPoolExecutor(worker_count(wp.get_device("cpu"), 0)) as pool:
        list(pool.map(work, parts))


def take_rows(source: np.ndarray, indices: np.ndarray, out: np.ndarray) -> None:
    """out[i] = source[indices[i]]: rows of `source`, whose type `out` has; `indices` are valid, shape [n]."""
    # any other mode makes a copy first
    in_slices(len(indices), lambda part: source.take(indices[part], axis=0, out=out[part], mode="clip"))


def add_rows(source: np.ndarray, number: int, out: np.ndarray) -> None:
    """out = source + number, for integers."""
    in_slices(len(source), lambda part: np.add(source[part], number, out=out[part], dtype=out.dtype, casting="unsafe"))


def copy_rows(source: np.ndarray, out: np.ndarray) -> None:
    """out = source, which may be of another type."""
    in_slices(len(source), lambda part: np.copyto(out[part], source[part], casting="unsafe"))


def digest_of(arrays: Iterable[np.ndarray], words: str = "") -> bytes:
    """32 bytes that are equal for equal arrays and words only."""
    pieces, digest = [], hashlib.blake2b(words.encode(), digest_size=32)
    for array in arrays:
        digest.update(str((array.dtype.str, array.shape)).encode())
        data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        pieces += [data[i : i + _SLICE_BYTES] for i in range(0, len(data), _SLICE_BYTES)]
    if sum(map(len, pieces)) <= _SLICE_BYTES:
        hashed = list(map(_hashed, pieces))
    else:
        with ThreadPoolExecutor(worker_count(wp.get_device("cpu"), 0)) as pool:
            hashed = list(pool.map(_hashed, pieces))
    for each in hashed:
        digest.update(each)
    return digest.digest()


def _hashed(piece: np.ndarray) -> bytes:
    # twice as fast as others where processors have instructions for it
    return hashlib.sha1(piece, usedforsecurity=False).digest()


def column_bounds(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest number in each column of `rows`, shape [n, ...], n >= 1; NaN where there is one."""
    lows, highs = [], []

    def look(part: slice) -> None:
        # NumPy goes through narrow rows one by one: many of them make a wide one
        some = rows[part]
        count = len(some) // _ROWS_AT_ONCE * _ROWS_AT_ONCE
        if count:
            wide = some[:count].reshape(-1, _ROWS_AT_ONCE, *rows.shape[1:])
            lows.append(wide.min(0).min(0))
            highs.append(wide.max(0).max(0))
        if count < len(some):
            lows.append(some[count:].min(0))
            highs.append(some[count:].max(0))

    in_slices(len(rows), look)
    return np.min(lows, 0), np.max(highs, 0)


def kinds_of(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each number among `numbers`, integers [n], comes first, in the order in which they come: int64 [k], rising;
    and which of these each of `numbers` is, int32 [n].
    """
    _, first, kind = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return first[order], place[kind.reshape(-1)]
