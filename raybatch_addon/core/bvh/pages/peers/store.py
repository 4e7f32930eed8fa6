"""Pages in device memory of those that share a render, and in host memory what has no room there.

All pages are written before any is read: `add_page` returns when its copy is over, so that no stream has to wait for
another device's. The memory is freed when nothing on any device reads it any more.
"""

from __future__ import annotations

import contextlib
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
import warp as wp

from ....native.structs import to_numpy
from ..store import PAGE_ALIGNMENT, HostStore, Page, bytes_of_rows, padded, page_rows
from ..tables import PageTables

# Pages smaller than a quarter of this lie together in blocks of so many bytes: to have memory takes a call each
_BLOCK_BYTES = 1 << 26
# In place of a device: the page lies in host memory
_HOST = -1


class _Share:
    """The memory of one device for pages."""

    def __init__(self, device: wp.Device, room: int):
        self.device = device
        self.held = 0  # bytes of blocks
        self._room = room // PAGE_ALIGNMENT * PAGE_ALIGNMENT  # bytes that further blocks may take
        self._block: wp.array | None = None
        self._used = 0

    @property
    def left(self) -> int:
        """Bytes that are not used yet."""
        return self._room + (self._block.size - self._used if self._block is not None else 0)

    def take(self, size: int) -> wp.array | None:
        """Memory for a page of `size` bytes, uint8; None where there is none any more."""
        if self._block is None or self._used + size > self._block.size:
            if size > self._room:
                return None
            count = size if size >= _BLOCK_BYTES // 4 else min(_BLOCK_BYTES, self._room)
            try:
                self._block = page_rows(count, self.device)
            except (MemoryError, RuntimeError):  # others have it: the page goes elsewhere
                self._room, self._block = 0, None
                return None
            self._used, self._room, self.held = 0, self._room - count, self.held + count
        first, self._used = self._used, self._used + size
        return bytes_of_rows(self._block, first, size)


class PeerStore:
    """Pages that `devices` hold for each other. Written by one thread, then read by all; a device is named by its place
    among them, because tests let one stand for several.
    """

    def __init__(self, devices: Sequence[wp.Device], share: int):
        """Empty; each of `devices` holds at most `share` bytes, and they read each other's memory (`let_read`)."""
        self.devices = tuple(devices)
        self.byte_count = 0
        self._shares = [_Share(each, share) for each in devices]
        self._host = HostStore(pinned=any(each.is_cuda for each in devices))
        self._firsts: list[int] = []  # of all pages, in the store's own count
        self._places: list[int] = []  # number of the device, or `_HOST`
        self._memory: list[wp.array] = []

    def __del__(self):
        # the pool takes memory back without a look at what other devices still read
        with contextlib.suppress(Exception):
            for device in {each.alias: each for each in self.devices if each.is_cuda}.values():
                wp.synchronize_device(device)

    def add_page(self, memory: np.ndarray, node_bytes: int) -> int:
        """Copy a page, uint8, of whole `PAGE_ALIGNMENT`, behind the others: where it begins."""
        size = padded(len(memory))
        # where most is left, so that all hold the same
        for place in sorted(range(len(self._shares)), key=lambda i: -self._shares[i].left):
            target = self._shares[place].take(size)
            if target is not None:
                break
        else:
            place, target = _HOST, self._host.at(self._host.add(size)[0], size)
        if target.device.is_cuda:
            wp.copy(target, wp.array(memory, dtype=wp.uint8, device="cpu", copy=False))
            wp.synchronize_stream(target.device.stream)  # the next page overwrites what was copied
        else:
            to_numpy(target)[: len(memory)] = memory
        self._firsts.append(self.byte_count)
        self._places.append(place)
        self._memory.append(target)
        self.byte_count += size
        return self._firsts[-1]

    def held_by(self, place: int) -> int:
        """Bytes that the device at `place` holds."""
        return self._shares[place].held

    @property
    def bytes_on_host(self) -> int:
        """Bytes of pages that no device had room for."""
        return self._host.byte_count

    def place_of(self, page: Page) -> int:
        """The place of the device that holds `page`; negative: host memory does."""
        return self._places[self._number(page)]

    def view(self, page: Page, place: int) -> wp.array:
        """`page` where it lies, uint8: as memory of the device at `place`, which reads that of the others under the
        same address, or in host memory, pinned.

        An array of another device would do for copies too, but Warp lets that one's stream wait for each.
        """
        number = self._number(page)
        start, device = page.byte_first - self._firsts[number], self.devices[place]
        part = self._memory[number][start : start + page.byte_count]
        if self._places[number] == _HOST or part.device == device:
            return part
        return wp.array(ptr=part.ptr, dtype=wp.uint8, shape=part.shape, device=device)

    def _number(self, page: Page) -> int:
        return bisect_right(self._firsts, page.byte_first) - 1


class BuiltPages:
    """Pages that are built, and their tables: the same for all devices."""

    def __init__(self, tables: PageTables, store: PeerStore):
        self.tables, self.store = tables, store


class PeerPlace:
    """The `PageStore` of one of the devices."""

    def __init__(self, built: BuiltPages, place: int):
        self._built, self.place = built, place  # with the tables, for those that come later
        self.store = built.store
        self.byte_count = built.store.byte_count

    def read_into(self, page: Page, host: np.ndarray, direct: bool) -> None:
        """See `PageStore`."""
        part, target = self.view(page), host[: page.byte_count]
        if not part.device.is_cuda:
            target[:] = to_numpy(part)
            return
        wp.copy(wp.array(target, dtype=wp.uint8, device="cpu", copy=False), part)
        wp.synchronize_stream(part.device.stream)

    def view(self, page: Page) -> wp.array:
        """See `PageStore`."""
        return self.store.view(page, self.place)

    def home_addresses(self, pages: Sequence[Page]) -> np.ndarray:
        """Addresses of those of `pages` that this device holds itself, uint64, shape [pages]; 0: it does not."""
        return np.array(
            [self.view(page).ptr if self.store.place_of(page) == self.place else 0 for page in pages], np.uint64
        )

    @property
    def held(self) -> int:
        """Bytes of pages that this device holds, for all."""
        return self.store.held_by(self.place)

    def statistics(self) -> dict[str, int]:
        """Where pages lie, by name."""
        return {
            "peer_count": len(self.store.devices),
            "peer_bytes": self.byte_count - self.store.bytes_on_host,
            "host_bytes": self.store.bytes_on_host,
        }

    def close(self) -> None:
        """See `PageStore`: the memory goes when the last device gives it up."""
