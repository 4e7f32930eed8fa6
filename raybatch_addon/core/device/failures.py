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
_NO_MEMORY = "failed to allocate"
# What Warp calls failures of launches, copies and contexts
_STOPPED = ("warp cuda error", "warp copy error", "warp error", "launch failure", "cuda driver error")
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
    """What Warp reports of `device` in here, of launches, copies and memory, is raised as a `DeviceError` or an
    `OutOfMemoryError`, and so is a lack of the computer's own memory; other errors pass.
    """
    try:
        yield
    except RayBatchError:
        raise
    except MemoryError as error:
        text = " ".join(str(error).split())
        raise OutOfMemoryError(
            f"this computer ran out of memory{': ' if text else ''}{text}; close other programs, or lower tile_size"
        ) from error
    except RuntimeError as error:
        text = " ".join(str(error).split())
        if not _is_of_warp(error):
            raise
        if _NO_MEMORY in text.lower():
            where = "cpu" if "'cpu'" in text else device.alias
            check_device(device)
            raise OutOfMemoryError(
                f"{where} ran out of memory: {text}; close other programs, lower tile_size or ray_count, or render on "
                "another device"
            ) from error
        if any(each in text.lower() for each in _STOPPED):
            raise _stopped(device, text) from error
        raise


def lacks_memory(error: BaseException) -> bool:
    """Whether `error` says that memory ran out, on the host or on a device."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or "out of memory" in text or _NO_MEMORY in text


def check_device(device: wp.Device) -> None:
    """Raise a `DeviceError` if `device` has stopped: then it has no memory either, and says so first."""
    if device.is_cuda and not device.is_capturing:
        try:
            wp.synchronize_device(device)
        except RuntimeError as error:
            raise _stopped(device, " ".join(str(error).split())) from error


def _stopped(device: wp.Device, text: str) -> DeviceError:
    remedy = "restart the program" if device.is_cuda else "try again"
    return DeviceError(f"{device.alias} stopped: {text}; {remedy}, or render on another device")


def _is_of_warp(error: BaseException) -> bool:
    """Whether Warp's own code raised `error`."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and _WARP in Path(trace.tb_frame.f_code.co_filename).parents
