"""Which pages of a scene are on the device: a pool of slots that workers share, each slot as large as the largest page.

A page is *absent*, *coming* (chosen; on its way), *there*, or *leaving* (shown to no launch any more, but one that sees
it may still run). What is brought in, and what leaves, is decided elsewhere (`Residency.ask`); here it is seen to that
no launch ever sees a page that is not whole. On the CPU a launch holds its pages until it is over; on CUDA marks
(events) order copies behind it, and the host waits for neither.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ..tree import Treelets
from .address_ring import AddressRing
from .facts import PageCounts, PageFacts
from .paged_scene import PagedScene
from .store import page_rows
from .transfer import PageTransfer, page_transfer, slot_bytes_of, slots_in, staging_bytes_of

ABSENT, COMING, THERE, LEAVING = range(4)

Choose = Callable[[PageFacts, int], list[int]]
"""Chooses at most so many pages."""


@wp.kernel(**KERNEL_OPTIONS)
def address_kernel(
    page: wp.array(dtype=int),
    page_address: wp.array(dtype=wp.uint64),
    node_byte: wp.array(dtype=wp.int64),
    triangle_byte: wp.array(dtype=wp.int64),
    node_address: wp.uint64,
    treelets: Treelets,
):
    """Addresses of the blocks of every treelet, from that of its page (0: absent). `node_address` is that of all nodes
    where these stay on the device, and otherwise 0."""
    treelet = wp.tid()
    address = page_address[page[treelet]]
    nodes = wp.uint64(0)
    triangles = wp.uint64(0)
    if address != wp.uint64(0):
        triangles = address + wp.uint64(triangle_byte[treelet])
        nodes = address + wp.uint64(node_byte[treelet])
    if node_address != wp.uint64(0):
        nodes = node_address + wp.uint64(node_byte[treelet])
    treelets.nodes[treelet] = nodes
    treelets.triangles[treelet] = triangles


class Residency:
    """The pool of pages of a scene on one device; safe to be used by several threads."""

    def __init__(
        self, scene: PagedScene, budget: int, device: wp.Device, make: Callable[..., PageTransfer] = page_transfer
    ):
        """Hold at most `budget` bytes of the scene on the device, with what always stays there. Raises
        `OutOfMemoryError`.
        """
        self.scene, self.device = scene, device
        self.slot_count, self.slot_bytes = slots_in(scene, budget, device), slot_bytes_of(scene)
        count = len(scene.pages)
        self._pool = page_rows(self.slot_count * self.slot_bytes, device)
        self._transfer = make(scene, self._pool, self.slot_bytes, device)
        self._zero_copy: np.ndarray | None = None  # addresses of pages in pinned memory
        self._changed = threading.Condition()
        self._changes = 0
        self._error: BaseException | None = None
        # addresses of pages that lie on the device for good, outside the pool; 0: others
        self._home = np.zeros(count, np.uint64) if scene.home is None else scene.home
        self._state = np.where(self._home > 0, THERE, ABSENT).astype(np.int8)
        self._slot = np.full(count, -1, np.int32)
        self._pins = np.zeros(count, np.int32)
        self._filled: dict[int, wp.Event] = {}  # by page: the mark behind its copy, until a launch has waited for it
        self._free = deque(
            (slot, None) for slot in range(self.slot_count)
        )  # slots, and the marks behind the last launch that saw them
        self._used: list[wp.Event | None] = [None] * self.slot_count
        self._wanted: deque[int] = deque()  # coming pages that have no slot yet
        self._clock = 0
        self._waiting, self._since, self._loaded_at, self._left_at, self._served = (
            np.zeros(count, np.int64) for _ in range(5)
        )
        self._bytes_there = 0
        self._bytes_always = scene.resident_bytes + staging_bytes_of(scene, self.slot_count, device)
        self.bytes_peak = self._bytes_always  # of geometry on the device at most

        self._tables = (
            wp.array(np.asarray(scene.treelet_page, np.int32), dtype=int, device=device),
            wp.array(np.asarray(scene.treelet_node_byte, np.int64), dtype=wp.int64, device=device),
            wp.array(np.asarray(scene.treelet_triangle_byte, np.int64), dtype=wp.int64, device=device),
        )

    def __del__(self):
        # the last to know it may be a thread that reads
        with contextlib.suppress(RuntimeError):
            self.close()

    @property
    def page_of(self) -> wp.array:
        """Page of every treelet, on the device."""
        return self._tables[0]

    @property
    def has_zero_copy(self) -> bool:
        """Whether launches can read pages where they lie in pinned memory."""
        return bool(self.device.is_cuda and self.scene.pages and self._plain(0) is not None)

    @property
    def has_failed(self) -> bool:
        """Whether a page could not be brought in: from then on every launch raises the error."""
        return self._error is not None

    def view(self) -> ResidencyView:
        """A worker's window to the pages; to be closed."""
        return ResidencyView(self)

    def close(self) -> None:
        """Wait for pages on their way, and start no more."""
        transfer = getattr(self, "_transfer", None)
        if transfer is not None:
            with self._changed:
                self._wanted.clear()
            transfer.close()

    # --- what is brought in

    def ask(self, choose: Choose, victims: Choose, coming_most: int, counts: PageCounts) -> list[int]:
        """Bring in what `choose` says, while no more than `coming_most` pages are on their way; `victims` make room.
        Returns the pages.
        """
        with self._changed:
            self._check()
            room = min(
                coming_most - int((self._state == COMING).sum()) - len(self._filled),
                self._transfer.room() - len(self._wanted),
            )
            chosen = choose(self._facts(), room) if room > 0 else []
            if not chosen:
                return []
            self._vacate(victims, len(chosen), counts)
            chosen = chosen[: self._vacant()]
            for page in chosen:
                self._clock += 1
                self._state[page] = COMING
                self._loaded_at[page], self._served[page] = self._clock, self._waiting[page]
                counts.loaded += 1
                counts.bytes_copied += self.scene.pages[page].byte_count
                self._wanted.append(page)
            self._start()
            return chosen

    def make_room(self, victims: Choose, count: int, counts: PageCounts) -> None:
        """See to it that `count` slots are free for pages to come, as far as `victims` allow: what leaves is shown to
        no launch from now on, so that copies can begin while the next ones run."""
        with self._changed:
            self._vacate(victims, count, counts)

    def wait(self, changes: int, seconds: float) -> bool:
        """Wait until something has changed since `changes` was the number of changes; False if it took longer than
        `seconds`.
        """
        with self._changed:
            self._check()
            changed = self._changed.wait_for(lambda: self._changes != changes or self._error, seconds)
            self._check()
            return bool(changed)

    @property
    def changes(self) -> int:
        """Number of pages that arrived or left so far."""
        return self._changes

    def is_coming(self) -> bool:
        """Whether any page is on its way that no launch was shown yet."""
        with self._changed:
            return bool((self._state == COMING).any() or self._filled)

    def facts(self) -> PageFacts:
        """The facts about pages as they are now."""
        with self._changed:
            return self._facts()

    def there(self) -> np.ndarray:
        """Which pages the next launch would be shown, bool, shape [page_count]."""
        with self._changed:
            return self._state == THERE

    # --- with the lock held

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _facts(self) -> PageFacts:
        evictable = self._state == THERE
        evictable[list(self._filled)] = False  # no launch was shown them yet
        evictable[self._home > 0] = False
        return PageFacts(
            waiting=self._waiting.copy(),
            since=self._since.copy(),
            absent=self._state == ABSENT,
            evictable=evictable,
            loaded_at=self._loaded_at.copy(),
            left_at=self._left_at.copy(),
            served=self._served.copy(),
            clock=self._clock,
            pool=self.slot_count,
        )

    def _vacant(self) -> int:
        return len(self._free) + int((self._state == LEAVING).sum()) - len(self._wanted)

    def _vacate(self, victims: Choose, count: int, counts: PageCounts) -> None:
        need = count - self._vacant()
        for page in victims(self._facts(), need) if need > 0 else ():
            self._state[page] = LEAVING
            counts.evicted += 1
            self._let_go(page)

    def _let_go(self, page: int) -> None:
        """A leaving page's slot is free once no launch holds it."""
        if self._state[page] == LEAVING and self._pins[page] == 0:
            slot = int(self._slot[page])
            self._state[page], self._slot[page], self._left_at[page] = ABSENT, -1, self._clock
            self._bytes_there -= self.scene.pages[page].device_bytes
            self._free.append((slot, self._used[slot]))
            self._note_change()

    def _start(self) -> None:
        while self._wanted and self._free:
            page = self._wanted.popleft()
            slot, used = self._free.popleft()
            self._slot[page] = slot
            self._bytes_there += self.scene.pages[page].device_bytes
            self.bytes_peak = max(self.bytes_peak, self._bytes_always + self._bytes_there)
            self._transfer.fill(page, slot, used, self._arrived)

    def _arrived(self, page: int, filled: wp.Event | None, error: BaseException | None) -> None:
        with self._changed:
            if error is not None:
                self._error = error
            else:
                self._state[page] = THERE
                if filled is not None:
                    self._filled[page] = filled
            self._note_change()

    def _note_change(self) -> None:
        self._changes += 1
        self._changed.notify_all()

    # --- for views

    def _show(self) -> tuple[np.ndarray, np.ndarray]:
        """Pages that a launch is shown from now on, and their addresses (0: absent), uint64."""
        with self._changed:
            self._check()
            shown = np.flatnonzero(self._state == THERE)
            self._pins[shown] += 1
            addresses = np.zeros(len(self._state), np.uint64)
            addresses[shown] = self._pool.ptr + self._slot[shown].astype(np.int64) * self.slot_bytes
            addresses = np.where(self._home > 0, self._home, addresses)
            for page, filled in self._filled.items():
                self._transfer.complete(page, int(self._slot[page]), filled)
            self._filled.clear()
            return shown, addresses

    def _hide(self, shown: np.ndarray) -> None:
        with self._changed:
            mark = self._transfer.mark()
            for page in shown.tolist():
                self._pins[page] -= 1
                if self._slot[page] >= 0:
                    self._used[self._slot[page]] = mark
                    self._let_go(page)
            self._start()

    def _wait_changed(self, old: np.ndarray, new: np.ndarray) -> None:
        with self._changed:
            before = self._waiting
            self._waiting = before + new - old
            self._since[(before == 0) & (self._waiting > 0)] = self._clock
            if ((before > 0) & (self._waiting == 0)).any():
                # such pages may make room
                self._note_change()

    def zero_copy_addresses(self) -> np.ndarray:
        """Addresses of all pages in pinned memory, or in that of other devices, uint64."""
        if self._zero_copy is None:
            self._zero_copy = np.array([self._plain(page).ptr for page in range(len(self.scene.pages))], np.uint64)
        return self._zero_copy

    def _plain(self, page: int) -> wp.array | None:
        """Page number `page` behind the device as rays can read it; None where it is in a file, or encoded alone."""
        return self.scene.plain_view(page) if self.scene.encoded else self.scene.store.view(self.scene.pages[page])


class ResidencyView:
    """One worker's window: addresses of the pages that its next launches see."""

    def __init__(self, residency: Residency):
        self._residency = residency
        scene, device = residency.scene, residency.device
        self.counts = PageCounts()
        self.treelets = Treelets()
        self.treelets.of_node, self.treelets.root, self.treelets.deform = scene.of_node, scene.root, scene.deform
        self.treelets.nodes = wp.zeros(scene.treelet_count, dtype=wp.uint64, device=device)
        self.treelets.triangles = wp.zeros(scene.treelet_count, dtype=wp.uint64, device=device)
        self._ring = AddressRing(len(scene.pages), device)
        self._waiting = np.zeros(len(scene.pages), np.int64)
        self._shown: np.ndarray | None = None

    def __del__(self):
        if hasattr(self, "_waiting"):
            self.close()

    @property
    def shown(self) -> np.ndarray:
        """Numbers of the pages that the launches since `begin` see."""
        return self._shown

    def begin(self, zero_copy: bool = False, only: np.ndarray | None = None) -> None:
        """Launches from now on see the pages that are there, and with `zero_copy` the others in pinned memory. They
        stay until `end`. `only` these (bool, shape [page_count]) are shown, where it is given."""
        assert self._shown is None, "the last launch has not ended"
        residency = self._residency
        self._shown, addresses = residency._show()
        if zero_copy:
            addresses = np.where(addresses == 0, residency.zero_copy_addresses(), addresses)
        if only is not None:
            addresses[~only] = 0
        scene = residency.scene
        page, node_byte, triangle_byte = residency._tables
        nodes = wp.uint64(scene.resident_nodes.ptr if scene.nodes_resident else 0)
        inputs = [page, self._ring.put(addresses), node_byte, triangle_byte, nodes, self.treelets]
        wp.launch(address_kernel, scene.treelet_count, inputs, device=residency.device)
        self._ring.was_read()

    def end(self) -> None:
        """The launches are over, or, on CUDA, all launched."""
        shown, self._shown = self._shown, None
        self._residency._hide(shown)

    def set_waiting(self, counts: np.ndarray) -> None:
        """Set how many of this worker's rays wait for each page, int64, shape [page_count]."""
        counts = np.asarray(counts, np.int64)
        self._residency._wait_changed(self._waiting, counts)
        self._waiting = counts.copy()

    def close(self) -> None:
        """Forget what this worker's rays wait for."""
        self.set_waiting(np.zeros_like(self._waiting))
        if self._shown is not None:
            self.end()
