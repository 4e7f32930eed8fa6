"""What a device fails at, as errors that name the device and the remedy."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import warp as wp

from ..errors import DeviceError, OutOfMemoryError, RayBatchError

_WARP = Path(wp.__file__).parent
_NO_MEMORY = ("failed to allocate", "out of memory")
_Given = ParamSpec("_Given")
_Returned = TypeVar("_Returned")


def names_failures(method: Callable[_Given, _Returned]) -> Callable[_Given, _Returned]:
    """`method` of what has a `device`: its errors are as of `named_failures`."""

    @functools.wraps(method)
    def named(*arguments: _Given.args, **options: _Given.kwargs) -> _Returned:
        owner: Any = arguments[0]
        with named_failures(owner.device):
            return method(*arguments, **options)

    return named


@contextlib.contextmanager
def named_failures(device: wp.Device) -> Iterator[None]:
    """Errors that Warp raises in here, of launches, copies and allocations on `device`, are raised as a `DeviceError`
    or an `OutOfMemoryError`; others pass.
    """
    try:
        yield
    except RayBatchError:
        raise
    except (RuntimeError, MemoryError) as error:
        text = " ".join(str(error).split())
        if any(each in text.lower() for each in _NO_MEMORY):
            raise OutOfMemoryError(
                f"{device.alias} ran out of memory: {text}; close other programs, lower tile_size or ray_count, or "
                "render on another device"
            ) from error
        if not _is_of_warp(error):
            raise
        remedy = "restart the program" if device.is_cuda else "try again"
        raise DeviceError(f"{device.alias} stopped: {text}; {remedy}, or render on another device") from error


def _is_of_warp(error: BaseException) -> bool:
    """Whether Warp's own code raised `error`."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and _WARP in Path(trace.tb_frame.f_code.co_filename).parents
