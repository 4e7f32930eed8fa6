"""Arrays on the device of which an edit changes a few rows: the same array is kept, and only those rows are copied."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .native.structs import to_numpy, upload_anew

# So many runs of rows are copied one by one; more of them together, with what lies between
_RUNS_MOST = 16


def overwrite_rows(array: wp.array, first: int, rows: np.ndarray) -> None:
    """`rows`, laid out as those of the one-dimensional `array`, from its entry `first` on."""
    if len(rows) and array is not None and array.size:
        rows = np.ascontiguousarray(rows)
        source = wp.array(ptr=rows.ctypes.data, dtype=array.dtype, shape=len(rows), device="cpu")
        wp.copy(array, source, dest_offset=first, count=len(rows))


def overwrite_changed(
    array: wp.array, changed: np.ndarray, rows: np.ndarray, follow: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> None:
    """Those of `rows`, which are all of `array`, whose numbers `changed` holds, ascending, or what `follow` makes of
    some of them, row by row.
    """
    runs = np.split(changed, np.flatnonzero(np.diff(changed) > 1) + 1)
    if len(runs) > _RUNS_MOST:
        runs = [changed[[0, -1]]]
    for run in runs:
        if len(run):
            overwrite_rows(array, int(run[0]), follow(rows[run[0] : run[-1] + 1]))


@dataclass
class _Kept:
    """An array on the device, and what is in it."""

    array: wp.array
    shape: tuple
    row: tuple  # types of an element, by NumPy and by Warp
    copied: np.ndarray | None  # what is in it; None: it can be looked at where it is

    @property
    def values(self) -> np.ndarray:
        """What is in it."""
        return to_numpy(self.array) if self.copied is None else self.copied


class KeptArrays:
    """Small arrays of the last scene by name, and what is in them."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, str], _Kept] = {}

    def clear(self) -> None:
        """Forget them."""
        self._kept = {}

    def upload(self, name: str, values: np.ndarray, dtype: Any, device: wp.Device) -> wp.array:
        """`values` on `device`: the array that was returned for `name` before, if it is of the same shape. What was
        returned before holds `values` now.

        Records have the type of `record_type(dtype)`.
        """
        values = np.ascontiguousarray(values)
        key, row = (device.alias, name), (values.dtype, dtype)
        last = self._kept.get(key)
        if last is not None and (last.shape, last.row) == (values.shape, row) and last.values.dtype == values.dtype:
            changed = changed_rows(last.values, values)
            if len(changed) and last.array.ndim == 1:
                overwrite_changed(last.array, changed, values)
                last.copied = None if last.copied is None else values.copy()
                return last.array
            if len(changed) == 0:
                return last.array
        del last
        self._kept.pop(key, None)  # before there are two of them
        made = upload_anew(name, values, dtype, device)
        self._kept[key] = _Kept(made, values.shape, row, None if device.is_cpu else values.copy())
        return made

    @property
    def bytes(self) -> int:
        """Memory that all of them take on their devices [bytes]."""
        return sum(int(each.array.capacity) for each in self._kept.values())


def changed_rows(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Numbers of the rows whose bytes differ, ascending; both have the same shape."""
    if len(after) == 0:
        return np.zeros(0, int)
    old, new = (np.ascontiguousarray(each).view(np.uint8).reshape(len(after), -1) for each in (before, after))
    return np.flatnonzero((old != new).any(1))
