"""What moves rays between waiting and being traced, where they wait for pages of geometry.

`where`, by ray slot, says what becomes of the ray: `IDLE`, `NEW`, `DONE`, or the treelet that it waits for. Taking rays is a pass over
all slots (count, scan, scatter): it reads 8 bytes a slot, so that a GPU looks at 64 million in a quarter of a millisecond, a fifth of
the time in which one page of 64 MB is copied; rays come out in the order of their slots, and nothing can run out. A *tally* counts the
slots of each class (`CLASS_...`, then one a page).
"""

from __future__ import annotations

import functools

import warp as wp

from ..bvh.tree import DONE, NEW
from ..kernel import KERNEL_OPTIONS, with_block_size

IDLE = -3
"""In `where`: no ray of the tracer's is in the slot."""

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
    """Where all rays are."""

    where: wp.array(dtype=int)  # by ray slot
    page: wp.array(dtype=int)  # by treelet
    tally: wp.array(dtype=int)  # slots of each class, shape [copies * classes]: the sum over copies counts
    classes: int
    copies: int
    shadow_first: int  # first slot of shadow rays
    # scratch of taking
    chunk: int  # slots a warp goes over, a multiple of `SLOTS_A_TURN`
    parts: wp.array(dtype=wp.uint64)  # rays of the first kind (low half) and of the second in each chunk, then before it


@wp.struct
class Taken:
    """A list of rays that was taken: first those of the first kind, then those of the second."""

    slots: wp.array(dtype=int)  # shape [capacity]
    where: wp.array(dtype=int)  # where they are; shape [capacity], or no entries
    count: wp.array(dtype=int)  # of both, shape [1]
    count_first: wp.array(dtype=int)  # shape [1]
    count_second: wp.array(dtype=int)  # shape [1]


_CONSTANTS = f"""
    constexpr int IDLE = {IDLE}, NEW = {NEW}, DONE = {DONE};
    constexpr int C_IDLE = {CLASS_IDLE}, C_NEW = {CLASS_NEW}, C_CLOSEST = {CLASS_DONE_CLOSEST}, C_SHADOW = {CLASS_DONE_SHADOW};
    constexpr int C_PAGES = {CLASS_PAGES};
"""
# Kinds of rays that are taken together
_READY = r"""
    auto is_first = [&](int place, int slot) { return place >= 0 && there.data[place] != 0; };
    auto is_second = [&](int place, int slot) { return place == NEW; };
    constexpr bool READY = true;
"""
_FINISHED = r"""
    auto is_first = [&](int place, int slot) { return place == DONE && slot < waiting.shadow_first; };
    auto is_second = [&](int place, int slot) { return place == DONE && slot >= waiting.shadow_first; };
    constexpr bool READY = false;
"""
_WRITE = r"""
    // once, when it is known how many are taken
    auto write_counts = [&](int first, int second) {
        taken.count.data[0] = first + second;
        taken.count_first.data[0] = first;
        taken.count_second.data[0] = second;
        if (!READY) {
            waiting.tally.data[C_CLOSEST] -= first;
            waiting.tally.data[C_SHADOW] -= second;
            waiting.tally.data[C_IDLE] += first + second;
        }
    };
    auto write_ray = [&](int rank, int slot, int place) {
        taken.slots.data[rank] = slot;
        if (READY) taken.where.data[rank] = place;
        else waiting.where.data[slot] = IDLE;
    };
"""
# A warp goes over its chunk 128 slots at a time, 4 a lane, and asks for the next ones before it looks at these
_WALK = r"""
    const int lane = thread & 31, warp = thread >> 5;
    const long long begin = (long long)warp * waiting.chunk;
    const long long all = waiting.where.shape[0], end = begin + waiting.chunk < all ? begin + waiting.chunk : all;
    auto four = [&](long long i) {
        int4 places = make_int4(IDLE, IDLE, IDLE, IDLE);
        if (i + 3 < end) return *(const int4*)(waiting.where.data + i);
        if (i < end) places.x = waiting.where.data[i];
        if (i + 1 < end) places.y = waiting.where.data[i + 1];
        if (i + 2 < end) places.z = waiting.where.data[i + 2];
        return places;
    };
    int4 next = four(begin + 4 * lane);
"""
_COUNT = r"""
#if defined(__CUDA_ARCH__)
    WALK
    unsigned int first = 0, second = 0;
    for (long long base = begin; base < end; base += 128) {
        const int slot = (int)base + 4 * lane;
        const int places[4] = {next.x, next.y, next.z, next.w};
        next = four(base + 128 + 4 * lane);
        for (int k = 0; k < 4; ++k) {
            first += is_first(places[k], slot + k) ? 1 : 0;
            second += is_second(places[k], slot + k) ? 1 : 0;
        }
    }
    unsigned long long both = (unsigned long long)second << 32 | first;
    for (int step = 16; step > 0; step /= 2) both += __shfl_xor_sync(0xffffffffu, both, step);
    if (lane == 0) waiting.parts.data[warp] = both;
#endif
"""
_SCAN = r"""
#if defined(__CUDA_ARCH__)
    __shared__ unsigned long long sums[THREADS];
    const int n = waiting.parts.shape[0], each = (n + THREADS - 1) / THREADS, begin = min(thread * each, n), end = min(begin + each, n);
    unsigned long long sum = 0;
    for (int i = begin; i < end; ++i) sum += waiting.parts.data[i];
    sums[thread] = sum;
    __syncthreads();
    for (int step = 1; step < THREADS; step *= 2) {
        const unsigned long long before = thread >= step ? sums[thread - step] : 0ull;
        __syncthreads();
        sums[thread] += before;
        __syncthreads();
    }
    unsigned long long before = sums[thread] - sum;
    for (int i = begin; i < end; ++i) {
        const unsigned long long part = waiting.parts.data[i];
        waiting.parts.data[i] = before;
        before += part;
    }
    if (thread == THREADS - 1) {
        const int capacity = taken.slots.shape[0];
        const int first = min((int)(unsigned int)sums[thread], capacity);
        write_counts(first, min(min((int)(sums[thread] >> 32), second_most), capacity - first));
    }
#endif
"""
_SCATTER = r"""
#if defined(__CUDA_ARCH__)
    WALK
    const unsigned int before = (1u << lane) - 1;
    const int first = taken.count_first.data[0], second = taken.count_second.data[0];
    int rank_first = (int)(unsigned int)waiting.parts.data[warp], rank_second = (int)(waiting.parts.data[warp] >> 32);
    for (long long base = begin; base < end; base += 128) {
        const int slot = (int)base + 4 * lane;
        const int places[4] = {next.x, next.y, next.z, next.w};
        next = four(base + 128 + 4 * lane);
        // those of lanes before this one, then its own in order
        int rank_a = rank_first, rank_b = rank_second;
        for (int k = 0; k < 4; ++k) {
            const unsigned int all_a = __ballot_sync(0xffffffffu, is_first(places[k], slot + k));
            const unsigned int all_b = __ballot_sync(0xffffffffu, is_second(places[k], slot + k));
            rank_a += __popc(all_a & before);
            rank_b += __popc(all_b & before);
            rank_first += __popc(all_a);
            rank_second += __popc(all_b);
        }
        for (int k = 0; k < 4; ++k) {
            if (is_first(places[k], slot + k)) {
                if (rank_a < first) write_ray(rank_a, slot + k, places[k]);
                ++rank_a;
            } else if (is_second(places[k], slot + k)) {
                if (rank_b < second) write_ray(first + rank_b, slot + k, places[k]);
                ++rank_b;
            }
        }
    }
#else
    const int n = waiting.where.shape[0], capacity = taken.slots.shape[0];
    int first = 0, second = 0;
    for (int i = 0; i < n && first < capacity; ++i) {
        const int place = waiting.where.data[i];
        if (is_first(place, i)) write_ray(first++, i, place);
    }
    const int most = second_most < capacity - first ? second_most : capacity - first;
    for (int i = 0; i < n && second < most; ++i) {
        const int place = waiting.where.data[i];
        if (is_second(place, i)) write_ray(first + second++, i, place);
    }
    write_counts(first, second);
#endif
"""
_PUT = r"""
    const int n = taken.count.data[0];
    auto class_of = [&](int place, int slot) {
        if (place >= 0) return C_PAGES + waiting.page.data[place];
        if (place == DONE) return slot < waiting.shadow_first ? C_CLOSEST : C_SHADOW;
        return place == NEW ? C_NEW : C_IDLE;
    };
#if defined(__CUDA_ARCH__)
    const bool mine = thread < n;
    int from = -1, to = -1;
    if (mine) {
        const int slot = taken.slots.data[thread], place = taken.where.data[thread], old = waiting.where.data[slot];
        if (place != old) {
            waiting.where.data[slot] = place;
            from = class_of(old, slot);
            to = class_of(place, slot);
        }
    }
    // lanes of a class add together
    int* tally = waiting.tally.data + (thread >> 7) % waiting.copies * waiting.classes;
    const int lane = thread & 31;
    unsigned int same = __match_any_sync(0xffffffffu, from);
    if (from >= 0 && __ffs(same) - 1 == lane) atomicSub(tally + from, __popc(same));
    same = __match_any_sync(0xffffffffu, to);
    if (to >= 0 && __ffs(same) - 1 == lane) atomicAdd(tally + to, __popc(same));
#else
    for (int i = 0; i < n; ++i) {
        const int slot = taken.slots.data[i], place = taken.where.data[i], old = waiting.where.data[slot];
        --waiting.tally.data[class_of(old, slot)];
        ++waiting.tally.data[class_of(place, slot)];
        waiting.where.data[slot] = place;
    }
#endif
"""


@functools.cache
def take_kernels(ready: bool) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel]:
    """Kernels (waiting, there, taken, second_most) that take rays: count, scan and scatter, of which the CPU needs the last alone,
    launched once.

    With `ready` rays are taken that wait for treelets of which `there` holds an address (first), and new ones (second); else those that
    are done, closest-hit rays (first) and shadow rays (second), whose slots are idle then. No more than `taken` holds are taken, and of
    the second kind no more than `second_most`; the others stay.
    """
    kinds = _CONSTANTS + (_READY if ready else _FINISHED)

    @wp.func_native(kinds + _COUNT.replace("WALK", _WALK))
    def count_native(waiting: Waiting, there: wp.array(dtype=wp.uint64), thread: int): ...

    @wp.func_native(kinds + _WRITE + _SCAN.replace("THREADS", str(SCAN_THREADS)))
    def scan_native(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: Taken, second_most: int, thread: int): ...

    @wp.func_native(kinds + _WRITE + _SCATTER.replace("WALK", _WALK))
    def scatter_native(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: Taken, second_most: int, thread: int): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def count_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: Taken, second_most: int):
        count_native(waiting, there, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scan_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: Taken, second_most: int):
        scan_native(waiting, there, taken, second_most, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scatter_taken(waiting: Waiting, there: wp.array(dtype=wp.uint64), taken: Taken, second_most: int):
        scatter_native(waiting, there, taken, second_most, wp.tid())

    return count_taken, with_block_size(scan_taken, SCAN_THREADS), scatter_taken


@functools.cache
def put_kernel() -> wp.Kernel:
    """Kernel (waiting, taken): the rays of `taken` are where it says now. One thread a ray, in whole warps; on the CPU launched once."""

    @wp.func_native(_CONSTANTS + _PUT)
    def put_native(waiting: Waiting, taken: Taken, thread: int): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def put_taken(waiting: Waiting, taken: Taken):
        put_native(waiting, taken, wp.tid())

    return put_taken


@wp.kernel(**KERNEL_OPTIONS)
def submit_kernel(waiting: Waiting, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """The idle slots that are listed have new rays."""
    i = wp.tid()
    if i >= count[0]:
        return
    waiting.where[slots[i]] = NEW
    if i == 0:
        waiting.tally[CLASS_NEW] = waiting.tally[CLASS_NEW] + count[0]
        waiting.tally[CLASS_IDLE] = waiting.tally[CLASS_IDLE] - count[0]


@wp.kernel(**KERNEL_OPTIONS)
def tally_kernel(waiting: Waiting, taken: Taken, visits: wp.array(dtype=wp.int64), totals: wp.array(dtype=wp.int64)):
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
    """For compiling ahead."""
    return [*take_kernels(True), *take_kernels(False), put_kernel(), submit_kernel, tally_kernel]
