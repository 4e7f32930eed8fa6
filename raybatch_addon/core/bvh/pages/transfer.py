"""Brings pages of geometry from their store into the slots of a pool on the device, while rays are traced.

On CUDA copies have a stream of their own, and marks (events) order them against the stream that traces: the host waits
for neither. Pages that are read from a file, or copied by the CPU, are read by threads; reading lets go of Python's
lock. Encoded pages arrive in staging buffers and are expanded into their slots: on the CPU by the thread that read
them, on CUDA by the stream that traces, because a kernel on the stream of copies would wait for the blocks of a launch
that runs for long.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np
import warp as wp

from ...device.devices import copy_stream
from ...errors import BudgetError
from ...native.structs import to_numpy
from .paged_scene import PagedScene
from .store import bytes_of_rows, padded, page_buffer

# Pages that are read at the same time; as many are staged on their way to a CUDA device
READER_COUNT = 2
# Bytes that are copied for a step, if the pool is large enough: 3.5 ms at 55 GB/s, many times the cost of a step's
# launches
_STEP_BYTES = 192 << 20

Arrived = Callable[[int, wp.Event | None, BaseException | None], None]
"""Called once a page is in its slot, or will be behind a mark: (page, mark or None, error or None); from any thread."""


class PageTransfer(Protocol):
    """Fills slots of the pool."""

    def fill(self, number: int, slot: int, used: wp.Event | None, arrived: Arrived) -> None:
        """Bring page `number` to `slot`, behind the mark `used` (None: at once)."""

    def room(self) -> int:
        """Number of further pages that can be on their way now, beside those that are not complete."""

    def mark(self) -> wp.Event | None:
        """The point behind everything that was launched so far; None where launches are over when they return."""

    def complete(self, number: int, slot: int, filled: wp.Event | None) -> None:
        """Let launches from now on find page `number` in `slot`, where it came behind the mark `filled`."""

    def close(self) -> None:
        """Returns when nothing is on its way any more."""


def largest_page(scene: PagedScene) -> int:
    """Bytes of the largest page in the store."""
    return max((page.byte_count for page in scene.pages), default=0)


def pages_a_step(scene: PagedScene, slot_count: int) -> int:
    """Pages that are brought in for a step of tracing, of a pool of `slot_count`: so many that a step's own cost does
    not count, but a quarter of the pool at most, since with fewer a step each is chosen better (of a pool of 20, one
    page a step copied 12 % less than five). Two at least, where there is room for them and for two that are traced."""
    enough = -(-_STEP_BYTES // max(1, largest_page(scene)))
    return max(1, min(slot_count // 4, enough), min(2, slot_count // 2))


def staging_count(scene: PagedScene, slot_count: int) -> int:
    """Staging buffers for encoded pages on a CUDA device: for those of a step, and of the next."""
    return 2 * pages_a_step(scene, slot_count) if slot_count > 1 else 1


def slot_bytes_of(scene: PagedScene) -> int:
    """Bytes of a slot of the pool."""
    return padded(max(1, scene.page_bytes_max))


def staging_bytes_of(scene: PagedScene, slots: int, device: wp.Device) -> int:
    """Device memory of the buffers in which the pages of a pool of `slots` arrive before they are expanded [bytes]."""
    if not (device.is_cuda and scene.encoded):
        return 0
    return staging_count(scene, slots) * largest_page(scene)


def slots_in(scene: PagedScene, budget: int, device: wp.Device) -> int:
    """Pages that fit in `budget` bytes beside what stays on the device, at most all; raises `BudgetError` for
    none.
    """
    size = slot_bytes_of(scene)
    least = scene.resident_bytes + size + staging_bytes_of(scene, 1, device)
    if budget < least:
        raise BudgetError(
            f"geometry_budget is {budget:,} bytes, and this scene needs {least:,} at least ({scene.resident_bytes:,} "
            "that always stay on "
            f"the device, and one page); raise it, or set it to 0"
        )
    away = len(scene.pages) - (0 if scene.home is None else int(np.count_nonzero(scene.home)))
    slots = min(max(1, away), (budget - scene.resident_bytes) // size)
    while slots > 1 and scene.resident_bytes + slots * size + staging_bytes_of(scene, slots, device) > budget:
        slots -= 1
    return slots


def page_transfer(scene: PagedScene, pool: wp.array, slot_bytes: int, device: wp.Device) -> PageTransfer:
    """The transfer of the pages of `scene` to slots of `slot_bytes` in `pool` (`page_rows`)."""
    if not device.is_cuda:
        return HostTransfer(scene, pool, slot_bytes)
    return CudaTransfer(scene, pool, slot_bytes, device)


class HostTransfer:
    """Threads read pages straight into the pool."""

    def __init__(self, scene: PagedScene, pool: wp.array, slot_bytes: int):
        self._scene, self._pool, self._slot_bytes = scene, pool, slot_bytes
        self._threads = ThreadPoolExecutor(READER_COUNT, thread_name_prefix="pages")
        self._staging: queue.SimpleQueue = queue.SimpleQueue()
        if scene.encoded:
            for _ in range(READER_COUNT):
                self._staging.put(page_buffer(largest_page(scene)))

    def fill(self, number: int, slot: int, used: wp.Event | None, arrived: Arrived) -> None:
        self._threads.submit(_read_and_report, arrived, number, self._read, slot)

    def _read(self, number: int, slot: int) -> None:
        scene, page = self._scene, self._scene.pages[number]
        target = bytes_of_rows(self._pool, slot * self._slot_bytes, page.device_bytes)
        if not scene.encoded:
            scene.store.read_into(page, to_numpy(target), direct=True)
            return
        buffer = self._staging.get()
        try:
            scene.store.read_into(page, to_numpy(buffer), direct=True)
            scene.expand(number, buffer[: page.byte_count], target)
        finally:
            self._staging.put(buffer)

    def room(self) -> int:
        return 2**31 - 1

    def mark(self) -> None:
        return None

    def complete(self, number: int, slot: int, filled: wp.Event | None) -> None:
        """Launches find pages in place."""

    def close(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)


def _read_and_report(arrived: Arrived, number: int, read: Callable[[int, int], wp.Event | None], slot: int) -> None:
    try:
        mark = read(number, slot)
    except BaseException as error:
        arrived(number, None, error)
    else:
        arrived(number, mark, None)


class CudaTransfer:
    """Copies on a stream of their own: from where pages lie in pinned memory, or from pinned buffers that threads
    fill.
    """

    def __init__(self, scene: PagedScene, pool: wp.array, slot_bytes: int, device: wp.Device):
        self._scene, self._pool, self._slot_bytes, self._device = scene, pool, slot_bytes, device
        self._stream = copy_stream(device.alias, "pages")
        self._threads: ThreadPoolExecutor | None = None
        # buffers, and the mark behind what was last done with them, or None
        self._pinned: queue.SimpleQueue = queue.SimpleQueue()
        self._staging: queue.SimpleQueue = queue.SimpleQueue()
        self._staged: dict[int, wp.array] = {}  # by page, until it has completed
        self._staging_free = staging_count(scene, pool.size // slot_bytes)
        if scene.encoded:
            for _ in range(self._staging_free):
                self._staging.put((wp.empty(largest_page(scene), dtype=wp.uint8, device=device), None))
        if scene.pages and scene.store.view(scene.pages[0]) is None:
            self._threads = ThreadPoolExecutor(READER_COUNT, thread_name_prefix="pages")
            for _ in range(READER_COUNT):
                self._pinned.put((page_buffer(largest_page(scene), pinned=True), None))
        # memory was allocated on the stream that traces
        self._stream.wait_event(device.stream.record_event())

    def fill(self, number: int, slot: int, used: wp.Event | None, arrived: Arrived) -> None:
        self._staging_free -= 1
        if self._threads is None:
            arrived(number, self._copy(number, slot, self._scene.store.view(self._scene.pages[number]), used), None)
        else:
            self._threads.submit(
                _read_and_report, arrived, number, lambda page, slot: self._read(page, slot, used), slot
            )

    def _read(self, number: int, slot: int, used: wp.Event | None) -> wp.Event:
        buffer, copied = self._pinned.get()
        try:
            if copied is not None:
                wp.synchronize_event(copied)
            copied = None
            self._scene.store.read_into(self._scene.pages[number], to_numpy(buffer), direct=True)
            copied = self._copy(number, slot, buffer, used)
        finally:
            self._pinned.put((buffer, copied))
        return copied

    def _copy(self, number: int, slot: int, source: wp.array, used: wp.Event | None) -> wp.Event:
        page = self._scene.pages[number]
        if self._scene.encoded:
            # the slot is written by the stream that traces: only the buffer must be free
            target, used = self._staging.get()
            self._staged[number] = target
        else:
            target = bytes_of_rows(self._pool, slot * self._slot_bytes, page.device_bytes)
        if used is not None:
            self._stream.wait_event(used)
        wp.copy(target, source, count=page.byte_count, stream=self._stream)
        return self._stream.record_event()

    def room(self) -> int:
        return self._staging_free if self._scene.encoded else 2**31 - 1

    def complete(self, number: int, slot: int, filled: wp.Event | None) -> None:
        stream, page = self._device.stream, self._scene.pages[number]
        stream.wait_event(filled)
        self._staging_free += 1
        if self._scene.encoded:
            buffer = self._staged.pop(number)
            target = bytes_of_rows(self._pool, slot * self._slot_bytes, page.device_bytes)
            self._scene.expand(number, buffer[: page.byte_count], target)
            self._staging.put((buffer, stream.record_event()))

    def mark(self) -> wp.Event:
        return self._device.stream.record_event()

    def close(self) -> None:
        try:
            if self._threads:
                self._threads.shutdown(wait=True, cancel_futures=True)
        finally:
            # also where one of the threads closes, which cannot wait for itself: the pool may be freed now
            wp.synchronize_stream(self._stream)
