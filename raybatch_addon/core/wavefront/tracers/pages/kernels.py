"""Kernels that move rays between waiting and being traced, where they wait for pages of geometry.

`location`, by ray slot, says what becomes of the ray: `IDLE`, `NEW`, `DONE`, or the treelet that it waits for. Taking
rays is a pass over all slots (count, scan, scatter): it reads 8 bytes a slot, so that a GPU looks at 64 million in a
quarter of a millisecond, a fifth of the time in which one page of 64 MB is copied; rays come out in the order of their
slots, and nothing can run out. Its scan is one launch of its own: it sums both kinds of rays at once, packed in 64
bits, and decides how many are taken; a general scan would take more launches for that. A *tally* counts the slots of
each class (`CLASS_...`, then one a page).

Rays that are taken are a `DeviceRayList`: first those of the first kind, then those of the second. Its `count` has
three entries: rays of both kinds, of the first, and of the second.
"""

from __future__ import annotations

import functools

import warp as wp

from ....bvh.tree import DONE, NEW
from ....device.kernel import KERNEL_OPTIONS, with_block_size
from ....native.build import native_source
from ....rays import DeviceRayList

IDLE = -3
"""In `location`: no ray of the tracer's is in the slot."""

CLASS_IDLE, CLASS_NEW, CLASS_DONE_CLOSEST, CLASS_DONE_SHADOW, CLASS_PAGES = range(5)
TALLY_COPIES = 32
"""Copies of the tally on CUDA, so that not all threads add to the same few words."""
CHUNKS_MOST = 1 << 14
"""Warps that go over all slots, each over a chunk."""
SLOTS_A_TURN = 128
"""Slots that a warp looks at at once."""
SCAN_THREADS = 1024


@wp.struct
class Waiting:
    """The state of all rays of the tracer."""

    location: wp.array(dtype=int)  # by ray slot
    page: wp.array(dtype=int)  # by treelet
    tally: wp.array(dtype=int)  # slots of each class, shape [copies * classes]: the sum over copies counts
    classes: int
    copies: int
    shadow_first: int  # first slot of shadow rays
    # scratch of taking
    chunk: int  # slots a warp goes over, a multiple of `SLOTS_A_TURN`
    parts: wp.array(
        dtype=wp.uint64
    )  # rays of the first kind (low half) and of the second in each chunk, then before it


_DEFINES = {
    "IDLE": IDLE,
    "NEW": NEW,
    "DONE": DONE,
    "CLASS_IDLE": CLASS_IDLE,
    "CLASS_NEW": CLASS_NEW,
    "CLASS_DONE_CLOSEST": CLASS_DONE_CLOSEST,
    "CLASS_DONE_SHADOW": CLASS_DONE_SHADOW,
    "CLASS_PAGES": CLASS_PAGES,
    "SLOTS_A_TURN": SLOTS_A_TURN,
    "SCAN_THREADS": SCAN_THREADS,
}


@functools.cache
def take_kernels(ready: bool) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel]:
    """Kernels (waiting, there, taken, second_most) that take rays: count, scan and scatter, of which the CPU needs the
    last alone, launched once.

    With `ready` rays are taken that wait for treelets of which `there` holds an address (first), and new ones (second);
    else those that are done, closest-hit rays (first) and shadow rays (second), whose slots are idle then. No more than
    `taken` holds are taken, and of the second kind no more than `second_most`; the others stay.
    """
    defines = {**_DEFINES, "READY": ready}

    @wp.func_native(native_source("pages/kinds.h", "pages/walk.h", "pages/count.h", device="cuda", **defines))
    def count_native(waiting: Waiting, there: wp.array(dtype=wp.uint64), thread: int): ...

    @wp.func_native(native_source("pages/kinds.h", "pages/write.h", "pages/scan.h", device="cuda", **defines))
    def scan_native(
        waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: DeviceRayList, second_most: int, thread: int
    ): ...

    @wp.func_native(native_source("pages/kinds.h", "pages/write.h", "pages/walk.h", "pages/scatter.h", **defines))
    def scatter_native(
        waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: DeviceRayList, second_most: int, thread: int
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def count_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: DeviceRayList, second_most: int):
        count_native(waiting, there, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scan_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: DeviceRayList, second_most: int):
        scan_native(waiting, there, taken, second_most, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scatter_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: DeviceRayList, second_most: int):
        scatter_native(waiting, there, taken, second_most, wp.tid())

    return count_taken, with_block_size(scan_taken, SCAN_THREADS), scatter_taken


@functools.cache
def put_kernel() -> wp.Kernel:
    """Kernel (waiting, taken): the rays of `taken` are where it says now. One thread a ray, in whole warps; on the CPU
    launched once.
    """

    @wp.func_native(native_source("pages/put.h", **_DEFINES))
    def put_native(waiting: Waiting, taken: DeviceRayList, thread: int): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def put_taken(waiting: Waiting, taken: DeviceRayList):
        put_native(waiting, taken, wp.tid())

    return put_taken


@wp.kernel(**KERNEL_OPTIONS)
def submit_kernel(waiting: Waiting, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """The idle slots that are listed have new rays."""
    i = wp.tid()
    if i >= count[0]:
        return
    waiting.location[slots[i]] = NEW
    if i == 0:
        waiting.tally[CLASS_NEW] = waiting.tally[CLASS_NEW] + count[0]
        waiting.tally[CLASS_IDLE] = waiting.tally[CLASS_IDLE] - count[0]


@wp.kernel(**KERNEL_OPTIONS)
def tally_kernel(
    waiting: Waiting, taken: DeviceRayList, visits: wp.array(dtype=wp.int64), totals: wp.array(dtype=wp.int64)
):
    """Slots of each class, then how many rays were taken last, then visits to treelets so far; shape [classes + 2]."""
    i = wp.tid()
    if i == waiting.classes:
        totals[i] = wp.int64(taken.count[0])
    elif i > waiting.classes:
        totals[i] = visits[0]
    else:
        total = int(0)
        for copy in range(waiting.copies):
            total += waiting.tally[copy * waiting.classes + i]
        totals[i] = wp.int64(total)


def streaming_kernels() -> list[wp.Kernel]:
    """All kernels of this file, for compiling ahead."""
    return [*take_kernels(True), *take_kernels(False), put_kernel(), submit_kernel, tally_kernel]
