"""Page-locked memory of the host, which a CUDA device copies from and to, or reads, by itself.

The driver's own allocation of such memory takes longest where the system first has to find the pages, which it does one
after another (measured: 1.6 to 2.6 GB/s). Here threads touch ordinary memory first (27 GB/s), which is then
registered with the driver (39 GB/s). Where the driver cannot register memory under its own address, its allocation is
what there is.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import math
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .bulk import in_slices

# Flags of the driver: memory is locked for all contexts, and mapped
_REGISTER_FLAGS = 1 | 2
_CAN_USE_HOST_POINTER = 91  # CU_DEVICE_ATTRIBUTE_CAN_USE_HOST_POINTER_FOR_REGISTERED_MEM
_CALLS = (
    "cuMemHostRegister_v2",
    "cuMemHostUnregister",
    "cuCtxPushCurrent_v2",
    "cuCtxPopCurrent_v2",
    "cuCtxSynchronize",
)
# Bytes from which on new memory is registered: less is had soon enough
_REGISTERED_LEAST = 1 << 22
# Bytes from which on an array has pages of memory of its own, as systems place it. A smaller one shares pages with
# others, whose copies would return before they are over, and the pages would be given back under these
OWN_PAGES_LEAST = 1 << 26
_ALIGNMENT = 4096


@dataclass
class _Registration:
    """Memory that is registered with the driver, and how many arrays there are of it."""

    memory: np.ndarray
    users: int = 0


# By address and size [bytes]; who asks for one waits meanwhile until another is made or given back
_registrations: dict[tuple[int, int], _Registration] = {}
_asking_driver = threading.RLock()
_still_locked: list[np.ndarray] = []  # that the driver did not give back


def locked_empty(shape: int | tuple[int, ...], dtype: type, hurry: bool = True) -> wp.array:
    """Page-locked memory without contents of the host that begins at a multiple of 4096 bytes, as an array of the CPU.

    `hurry`: all cores touch it; without, the calling thread does, and leaves the others to their work. Raises as Warp
    where there is not so much.
    """
    shape = (shape,) if isinstance(shape, int) else shape
    size = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
    driver = _driver() if size >= _REGISTERED_LEAST else None
    if driver is not None:
        memory = np.empty(size + 2 * _ALIGNMENT, np.uint8)
        start = -memory.ctypes.data % _ALIGNMENT
        pages = memory[start : start + -(-size // _ALIGNMENT) * _ALIGNMENT].reshape(-1, _ALIGNMENT)
        in_slices(len(pages), lambda part: pages[part, 0].fill(0), _ALIGNMENT if hurry else len(pages))
        made = _registered(driver, pages, dtype, shape, wp.get_device("cpu"))
        if made is not None:
            return made
        del memory, pages
    memory = wp.empty(size + _ALIGNMENT, dtype=wp.uint8, device="cpu", pinned=True)
    start = -memory.ptr % _ALIGNMENT
    return wp.array(
        ptr=memory.ptr + start,
        dtype=dtype,
        shape=shape,
        device="cpu",
        pinned=True,
        deleter=lambda pointer, size, kept=memory: None,
    )


def locked_view(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array | None:
    """`values`, contiguous, as an array of the CUDA device `device`, which reads them where they lie, or of the CPU;
    None where they are small, or the driver cannot lock them. Each dimension is below 2^31, as Warp counts them.

    They are locked as long as such an array lives: several devices may ask for one at the same time.
    """
    driver = _driver()
    if driver is None or values.nbytes < OWN_PAGES_LEAST:
        return None
    return _registered(driver, values, dtype, shape_of(values, dtype), device)


def shape_of(values: np.ndarray, dtype: type) -> tuple[int, ...]:
    """Shape of `values` as an array of `dtype`, whose own dimensions, those of a vector, are no part of it."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False).shape


def _registered(driver: Any, memory: np.ndarray, dtype: type, shape: tuple[int, ...], device: wp.Device):
    """`memory` registered with the driver, as an array of `device`; None where that cannot be."""
    place = memory.ctypes.data, memory.nbytes
    with _asking_driver:
        held = _registrations.get(place)
        if held is None:
            pointer, size = ctypes.c_void_p(place[0]), ctypes.c_size_t(place[1])
            with _context(driver):
                if driver.cuMemHostRegister_v2(pointer, size, _REGISTER_FLAGS) != 0:
                    return None
            held = _registrations[place] = _Registration(memory)
        held.users += 1

    def let_go(*_: Any) -> None:
        # at the end of the program there may be nothing left to ask
        with contextlib.suppress(Exception), _asking_driver:
            held.users -= 1
            if not held.users:
                _give_back(driver, _registrations.pop(place).memory)

    try:
        return wp.array(ptr=place[0], dtype=dtype, shape=shape, device=device, pinned=device.is_cpu, deleter=let_go)
    except BaseException:
        let_go()
        raise


def _give_back(driver: Any, memory: np.ndarray) -> None:
    """Let the driver unlock `memory`."""
    for each in wp.get_cuda_devices():  # any of them may still read it
        with _context(driver, each):
            driver.cuCtxSynchronize()
    with _context(driver):
        if driver.cuMemHostUnregister(ctypes.c_void_p(memory.ctypes.data)) != 0:
            _still_locked.append(memory)


@contextlib.contextmanager
def _context(driver: Any, device: wp.Device | None = None) -> Iterator[None]:
    """Inside, the driver is asked in the context of `device` (default: the first), on this thread alone."""
    device = device or wp.get_cuda_devices()[0]
    if driver.cuCtxPushCurrent_v2(ctypes.c_void_p(device.context)) != 0:
        raise OSError(f"the driver does not take the context of {device.alias}")
    try:
        yield
    finally:
        driver.cuCtxPopCurrent_v2(ctypes.byref(ctypes.c_void_p()))


@functools.cache
def _driver() -> Any | None:
    """The driver, where every CUDA device reads registered memory under the host's address."""
    with contextlib.suppress(OSError, AttributeError):
        devices = wp.get_cuda_devices()
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        for name in _CALLS:
            getattr(driver, name)
        for device in devices:
            value = ctypes.c_int()
            if driver.cuDeviceGetAttribute(ctypes.byref(value), _CAN_USE_HOST_POINTER, device.ordinal) != 0:
                return None
            if not value.value:
                return None
        return driver if devices else None
    return None
