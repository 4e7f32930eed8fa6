"""Brings pages of geometry from their store into the slots of a pool on the device, while rays are traced.

On CUDA copies have a stream of their own, and marks (events) order them against the stream that traces: the host waits for neither.
Pages that are read from a file, or copied by the CPU, are read by threads; reading lets go of Python's lock.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import queue
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import warp as wp

from .page_build import PagedScene
from .page_store import page_buffer

# Pages that are read at the same time; as many are staged on their way to a CUDA device
READER_COUNT = 2

Arrived = Callable[[int, Any, BaseException | None], None]
"""Called once a page is in its slot, or will be behind a mark: (page, mark or None, error or None); from any thread."""


class PageLine(Protocol):
    """Fills slots of the pool."""

    def fill(self, number: int, slot: int, used: Any, arrived: Arrived) -> None:
        """Bring page `number` to `slot`, behind the mark `used` (None: at once)."""

    def mark(self) -> Any:
        """The point behind everything that was launched so far; None where launches are over when they return."""

    def wait_for(self, filled: Any) -> None:
        """What is launched from now on comes behind the mark `filled`."""

    def close(self) -> None:
        """Returns when nothing is on its way any more."""


def page_line(scene: PagedScene, pool: wp.array, slot_bytes: int, device: wp.Device) -> PageLine:
    """The line for the pages of `scene` to slots of `slot_bytes` in `pool`."""
    if not device.is_cuda:
        return HostLine(scene, pool, slot_bytes)
    return CudaLine(scene, pool, slot_bytes, device)


class HostLine:
    """Threads read pages straight into the pool."""

    def __init__(self, scene: PagedScene, pool: wp.array, slot_bytes: int):
        self._scene, self._memory, self._slot_bytes = scene, pool.numpy(), slot_bytes
        self._threads = ThreadPoolExecutor(READER_COUNT, thread_name_prefix="pages")

    def fill(self, number: int, slot: int, used: Any, arrived: Arrived) -> None:
        self._threads.submit(_told, arrived, number, self._read, slot)

    def _read(self, number: int, slot: int) -> None:
        start = slot * self._slot_bytes
        page = self._scene.pages[number]
        self._scene.store.read_into(page, self._memory[start : start + page.byte_count], direct=True)

    def mark(self) -> None:
        return None

    def wait_for(self, filled: Any) -> None:
        """Launches find pages in place."""

    def close(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)


def _told(arrived: Arrived, number: int, read: Callable[[int, int], Any], slot: int) -> None:
    try:
        mark = read(number, slot)
    except BaseException as error:  # noqa: BLE001  it is raised again where pages are waited for
        arrived(number, None, error)
    else:
        arrived(number, mark, None)


class CudaLine:
    """Copies on a stream of their own: from where pages lie in pinned memory, or from staging buffers that threads fill."""

    def __init__(self, scene: PagedScene, pool: wp.array, slot_bytes: int, device: wp.Device):
        self._scene, self._pool, self._slot_bytes, self._device = scene, pool, slot_bytes, device
        self._stream = copy_stream(device.alias)
        # the pool was allocated on the stream that traces
        self._stream.wait_event(device.stream.record_event())
        self._threads: ThreadPoolExecutor | None = None
        self._staging: queue.SimpleQueue = queue.SimpleQueue()  # (pinned buffer, mark behind its last copy or None)
        if scene.pages and scene.store.view(scene.pages[0]) is None:
            self._threads = ThreadPoolExecutor(READER_COUNT, thread_name_prefix="pages")
            largest = max(page.byte_count for page in scene.pages)
            for _ in range(READER_COUNT):
                self._staging.put((page_buffer(largest, pinned=True), None))

    def fill(self, number: int, slot: int, used: Any, arrived: Arrived) -> None:
        if self._threads is None:
            arrived(number, self._copy(number, slot, self._scene.store.view(self._scene.pages[number]), used), None)
        else:
            self._threads.submit(_told, arrived, number, lambda page, place: self._read(page, place, used), slot)

    def _read(self, number: int, slot: int, used: Any) -> wp.Event:
        buffer, copied = self._staging.get()
        try:
            if copied is not None:
                wp.synchronize_event(copied)
            copied = None
            self._scene.store.read_into(self._scene.pages[number], buffer.numpy(), direct=True)
            copied = self._copy(number, slot, buffer, used)
        finally:
            self._staging.put((buffer, copied))
        return copied

    def _copy(self, number: int, slot: int, source: wp.array, used: Any) -> wp.Event:
        if used is not None:
            self._stream.wait_event(used)
        size = self._scene.pages[number].byte_count
        wp.copy(self._pool, source, dest_offset=slot * self._slot_bytes, count=size, stream=self._stream)
        return self._stream.record_event()

    def mark(self) -> wp.Event:
        return self._device.stream.record_event()

    def wait_for(self, filled: wp.Event) -> None:
        self._device.stream.wait_event(filled)

    def close(self) -> None:
        if self._threads:
            self._threads.shutdown(wait=True, cancel_futures=True)
        wp.synchronize_stream(self._stream)


@functools.cache
def copy_stream(alias: str) -> wp.Stream:
    """The stream for copies to the CUDA device `alias`, which does not wait for the device's default stream.

    Warp's own streams do: it frees memory on the default stream, and each such call would hold up tracing until all copies that were
    begun are over. Where the driver gives no such stream, one of Warp's stands for it.
    """
    non_blocking = 1  # CU_STREAM_NON_BLOCKING of the driver
    device = wp.get_device(alias)
    with contextlib.suppress(OSError, AttributeError), wp.ScopedDevice(device):
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        handle = ctypes.c_void_p()
        if driver.cuStreamCreate(ctypes.byref(handle), ctypes.c_uint(non_blocking)) == 0 and handle.value:
            return wp.Stream(device, cuda_stream=handle.value)
    return wp.Stream(device)
