"""Lists of path slots by status, made by counting, exclusive scan and scatter: no locks, and always in slot order.

Paths are counted in blocks, so that only a block has places in the work arrays: on CUDA each warp counts a block, its lanes by
votes; on the CPU one block holds all paths, so that one launch counts and scatters, and vector
units look at many words at a time: where a tile comes to its end few of its slots are still in use. All lists of a worker lie in one array of two entries a path,
a list behind the one before it:

- at the end of a turn paths at their end, free slots (as long as there are paths to generate), and new extending rays by bounce: together at most one entry a path. Behind them
  new shadow rays, of which a path may have one too;
- when rays are back, paths that left the scene, and in the array's second half paths that met a surface. By then the lists of the turn
  before are used up.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from enum import Enum, IntEnum

import warp as wp

from ..kernel import KERNEL_OPTIONS
from ..launches import RepeatedLaunches
from .rays import BOUNCE_SHIFT, Status
from .tracer import NO_SLOTS, SlotList

# Paths that a warp counts, a multiple of 32
CUDA_BLOCK = 256


class Length(IntEnum):
    """Places of the lists' lengths among a worker's counts."""

    DONE = 0  # paths at their end
    FREE = 1  # slots that were free before
    BOUNCE_1 = 2  # new extending rays of paths that have scattered once (or not yet, and only passed what is transparent)
    BOUNCE_2 = 3  # twice
    BOUNCE_LATER = 4  # more often, or of walks below surfaces: these scatter all around
    SHADOW = 5  # new shadow rays
    BOUNCE = 6  # all new extending rays
    MISS = 7  # paths that left the scene
    SURFACE = 8  # paths that met a surface
    CAMERA = 9  # new paths
    SPILL = 10  # channels that were set aside


class ListSet(Enum):
    """Lists that are made together, in the order of their `Length`s."""

    TURN = 6  # DONE to SHADOW
    BACK = 2  # MISS, SURFACE


_ALIVE, _ENDED, _HIT = int(Status.ALIVE), int(Status.ENDED), int(Status.HIT)
_RAY_NEW, _RAY_OUT, _SHADOW_NEW, _SHADOW_OUT = int(Status.RAY_NEW), int(Status.RAY_OUT), int(Status.SHADOW_NEW), int(Status.SHADOW_OUT)
_WAITING = _RAY_NEW | _RAY_OUT | _SHADOW_NEW | _SHADOW_OUT

_BLOCK = """
    const int paths = status.shape[0];
    #if defined(__CUDA_ARCH__)
    const int block_number = thread / 32, lane = thread % 32;
    #else
    const int block_number = thread, lane = 0;
    #endif
    const int first = block_number * block_size, end = paths - first > block_size ? first + block_size : paths;
"""

# On the CPU `over_chunks(visit)` calls `visit(from, n, lists, masks)` for the paths of a block, `CHUNK` at a time and in their order, unless
# none of these is in a list: `lists` is what each path belongs to, and masks[k] which of them belong to list k. Vector units look at them
_OVER_CHUNKS = f"""
    #if !defined(__CUDA_ARCH__)
    constexpr int CHUNK = 16;
    constexpr unsigned int ALL = (1u << CHUNK) - 1u;
    auto over_chunks = [&](auto&& visit) {{
        for (int from = first; from < end; from += CHUNK) {{
            const int n = end - from > CHUNK ? CHUNK : end - from;
            int words[CHUNK] = {{}}, any = 0;
            if (n == CHUNK) for (int i = 0; i < CHUNK; ++i) words[i] = status.data[from + i];
            else for (int i = 0; i < n; ++i) words[i] = status.data[from + i];
            for (int i = 0; i < CHUNK; ++i) any |= words[i];
            if (!(any & {_ALIVE}) && !lists_of(0)) continue;
            unsigned int lists[CHUNK], masks[LISTS];
            for (int i = 0; i < CHUNK; ++i) lists[i] = lists_of(words[i]);
            for (int k = 0; k < LISTS; ++k) {{
                masks[k] = 0u;
                for (int i = 0; i < CHUNK; ++i) masks[k] |= (lists[i] >> k & 1u) << i;
                masks[k] &= ALL >> (CHUNK - n);
            }}
            visit(from, n, lists, masks);
        }}
    }};
    auto count = [&](int* found) {{
        over_chunks([&](int, int, const unsigned int*, const unsigned int* masks) {{
            for (int k = 0; k < LISTS; ++k) found[k] += __builtin_popcount(masks[k]);
        }});
    }};
    #endif
"""

# `lists_of`: which lists a path belongs to, as bits
_RULES = {
    ListSet.TURN: f"""
    constexpr int LISTS = 6;
    const unsigned int free = with_free ? 2u : 0u, second = by_bounce ? 8u : 4u, later = by_bounce ? 16u : 4u;
    auto lists_of = [&](int word) -> unsigned int {{
        const int bounce = word >> {BOUNCE_SHIFT};
        const unsigned int extending = word & INSIDE ? later : bounce <= 1 ? 4u : bounce == 2 ? second : later;
        const unsigned int rays = (word & {_RAY_NEW} ? extending : 0u) | (word & {_SHADOW_NEW} ? 32u : 0u);
        const unsigned int alive = (word & {_ENDED | _WAITING}) == {_ENDED} ? 1u : rays;
        return word & {_ALIVE} ? alive : free;
    }};
    """,
    ListSet.BACK: f"""
    constexpr int LISTS = 2;
    auto lists_of = [&](int word) -> unsigned int {{
        const unsigned int back = word & {_HIT} ? 2u : 1u;
        return (word & {_ALIVE | _ENDED | _WAITING}) == {_ALIVE} ? back : 0u;
    }};
    """,
}

_COUNT = """
    const int blocks = (counts.shape[0] - 1) / LISTS;
    int found[LISTS] = {};
    #if defined(__CUDA_ARCH__)
    for (int from = first; from < end; from += 32) {
        const unsigned int lists = from + lane < end ? lists_of(status.data[from + lane]) : 0u;
        for (int k = 0; k < LISTS; ++k) found[k] += __popc(__ballot_sync(0xffffffffu, lists >> k & 1u));
    }
    #else
    count(found);
    #endif
    if (lane == 0)
        for (int k = 0; k < LISTS; ++k) counts.data[k * blocks + block_number] = found[k];
"""

_SCATTER = """
    const int blocks = (offsets.shape[0] - 1) / LISTS;
    #if defined(__CUDA_ARCH__)
    auto start = [&](int k, int block) { return offsets.data[k * blocks + block]; };
    #else
    int starts[LISTS + 1] = {};
    if (blocks == 1) {
        count(starts + 1);
        for (int k = 0; k < LISTS; ++k) starts[k + 1] += starts[k];
    }
    auto start = [&](int k, int block) { return blocks == 1 ? starts[k] : offsets.data[k * blocks + block]; };
    #endif
    int at[LISTS];
    for (int k = 0; k < LISTS; ++k) at[k] = start(k, block_number);
    if (block_number == 0 && lane == 0) tell();
    place_apart();
    #if defined(__CUDA_ARCH__)
    for (int from = first; from < end; from += 32) {
        const int path = from + lane;
        const unsigned int lists = path < end ? lists_of(status.data[path]) : 0u;
        for (int k = 0; k < LISTS; ++k) {
            const unsigned int vote = __ballot_sync(0xffffffffu, lists >> k & 1u);
            if (lists >> k & 1u) slots.data[at[k] + __popc(vote & ((1u << lane) - 1u))] = slot_of(path, k);
            at[k] += __popc(vote);
        }
        if (lists) submit(path, lists);
    }
    #else
    over_chunks([&](int from, int n, const unsigned int* lists, const unsigned int* masks) {
        for (int k = 0; k < LISTS; ++k)
            if (masks[k] == ALL) {
                for (int i = 0; i < CHUNK; ++i) slots.data[at[k] + i] = slot_of(from + i, k);
                at[k] += CHUNK;
            } else
                for (unsigned int rest = masks[k]; rest; rest &= rest - 1u) slots.data[at[k]++] = slot_of(from + __builtin_ctz(rest), k);
        for (int i = 0; i < n; ++i) submit(from + i, lists[i]);
    });
    #endif
"""

# What the scattering of either set does beside: it tells lengths, and counts rays that are listed as under way
_SCATTERED = {
    ListSet.TURN: f"""
    auto tell = [&]() {{
        for (int k = 0; k < LISTS; ++k) lengths.data[{Length.DONE} + k] = start(k + 1, 0) - start(k, 0);
        lengths.data[{Length.BOUNCE}] = start(5, 0) - start(2, 0);
    }};
    auto place_apart = []() {{}};
    auto slot_of = [&](int path, int k) {{ return k == 5 ? paths + path : path; }};
    auto submit = [&](int path, unsigned int lists) {{
        const int flipped = (lists & 28u ? {_RAY_NEW | _RAY_OUT} : 0) | (lists & 32u ? {_SHADOW_NEW | _SHADOW_OUT} : 0);
        if (flipped) status.data[path] ^= flipped;
    }};
    """,
    ListSet.BACK: f"""
    auto tell = [&]() {{
        for (int k = 0; k < LISTS; ++k) lengths.data[{Length.MISS} + k] = start(k + 1, 0) - start(k, 0);
    }};
    auto place_apart = [&]() {{ at[1] += paths - start(1, 0); }};
    auto slot_of = [](int path, int) {{ return path; }};
    auto submit = [](int, unsigned int) {{}};
    """,
}


@functools.cache
def list_kernels(lists: ListSet, walks: bool) -> tuple[wp.Kernel, wp.Kernel]:
    """Kernels (status, block_size, by_bounce, with_free, counts) and (status, block_size, by_bounce, with_free, offsets, slots, lengths).

    The first counts each block's paths of every list, the second writes the lists to `slots`, flips the status of rays that are listed, and
    tells `lengths`. `counts` and `offsets`, its exclusive scan, have shape [lists * blocks + 1]; where there is one block the CPU's
    second kernel counts for itself, and reads no `offsets`. A block is `block_size` paths; on CUDA 32 threads take one, on the CPU one
    thread. `walks`: rays may be steps of walks below surfaces.
    """
    # a scene without walks does not look for them
    before = f"    constexpr int INSIDE = {int(Status.INSIDE) if walks else 0};\n" + _BLOCK + _RULES[lists] + _OVER_CHUNKS
    scatter_text = before + _SCATTER.replace("    if (block_number == 0", _SCATTERED[lists] + "    if (block_number == 0", 1)

    @wp.func_native(before + _COUNT)
    def count_block(status: wp.array(dtype=int), block_size: int, by_bounce: int, with_free: int, counts: wp.array(dtype=int), thread: int): ...

    @wp.func_native(scatter_text)
    def scatter_block(
        status: wp.array(dtype=int), block_size: int, by_bounce: int, with_free: int, offsets: wp.array(dtype=int),
        slots: wp.array(dtype=int), lengths: wp.array(dtype=int), thread: int,
    ): ...  # fmt: skip

    @wp.kernel(**KERNEL_OPTIONS)
    def count_paths(status: wp.array(dtype=int), block_size: int, by_bounce: int, with_free: int, counts: wp.array(dtype=int)):
        count_block(status, block_size, by_bounce, with_free, counts, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scatter_paths(
        status: wp.array(dtype=int), block_size: int, by_bounce: int, with_free: int, offsets: wp.array(dtype=int),
        slots: wp.array(dtype=int), lengths: wp.array(dtype=int),
    ):  # fmt: skip
        scatter_block(status, block_size, by_bounce, with_free, offsets, slots, lengths, wp.tid())

    return count_paths, scatter_paths


def queue_kernels(walks: bool) -> list[wp.Kernel]:
    """Everything that `PathLists` launches."""
    return [*list_kernels(ListSet.TURN, walks), *list_kernels(ListSet.BACK, False)]


class Counts:
    """Lengths of all lists of a worker, side by side on the device, so that one copy brings them to the host."""

    def __init__(self, device: wp.Device):
        size = len(Length)
        self.on_device = wp.zeros(size, dtype=int, device=device)
        # a CUDA device writes to memory that the host has pinned without a detour
        self._on_host = wp.zeros(size, dtype=int, device="cpu", pinned=True) if device.is_cuda else self.on_device
        self._lengths = self._on_host.numpy()  # the same memory
        self._places = [self.on_device[place : place + 1] for place in range(size)]

    def at(self, place: int) -> wp.array:
        """One count, int32, shape [1]."""
        return self._places[place]

    def fetch(self) -> list[int]:
        """All of them, once the device is done with what it was told."""
        device = self.on_device.device
        if device.is_cuda:
            wp.copy(self._on_host, self.on_device)
            wp.synchronize_stream(device.stream)
        return self._lengths.tolist()


@dataclass(frozen=True)
class TurnLists:
    """What the next turn begins with."""

    free: wp.array | None  # free slots, those of paths at their end too, if they were asked for
    bounced: SlotList  # new extending rays
    bounced_parts: list[SlotList]  # the same by bounce, if that was asked for
    shadow: SlotList  # new shadow rays


class PathLists:
    """Makes and holds the lists of one worker."""

    def __init__(self, path_count: int, device: wp.Device, block_size: int = 0, walks: bool = False):
        """For `path_count` paths. `block_size`: paths of a block (0: as the device asks for); `walks`: some may walk below surfaces."""
        self._device, self._path_count, self._walks = device, path_count, walks
        self._launches = RepeatedLaunches(device)
        self._block_size = block_size or (CUDA_BLOCK if device.is_cuda else path_count)
        self._blocks = -(-path_count // self._block_size)
        self.counts = Counts(device)
        self._slots = wp.zeros(2 * path_count, dtype=int, device=device)
        self._halves = [self._slots[:path_count], self._slots[path_count:]]
        self._work = {}
        shared = [wp.zeros(ListSet.TURN.value * self._blocks + 1, dtype=int, device=device) for _ in range(2)]
        for lists in ListSet:
            self._work[lists] = [array[: lists.value * self._blocks + 1] for array in shared]

    def all_free(self, status: wp.array) -> wp.array:
        """The list of free slots while no path is alive."""
        self._make(ListSet.TURN, status, with_free=True)
        return self._halves[0]

    def back(self, status: wp.array, bound: int) -> tuple[SlotList, SlotList]:
        """Paths whose rays are all back: those that left the scene, and those that met a surface; neither is longer than `bound`."""
        self._make(ListSet.BACK, status)
        lengths = (self.counts.at(Length.MISS), self.counts.at(Length.SURFACE))
        return tuple(SlotList(slots, length, bound) for slots, length in zip(self._halves, lengths))

    def end_turn(self, status: wp.array, bound: int, by_bounce: bool, with_free: bool) -> SlotList:
        """Make all lists of the next turn; rays in them count as under way from now on. Returns the paths at their end, at most `bound`.

        `by_bounce`: list new extending rays by bounce; `with_free`: list free slots, for paths that are to be generated.
        """
        self._make(ListSet.TURN, status, by_bounce, with_free)
        return SlotList(self._halves[0], self.counts.at(Length.DONE), bound)

    def next_turn(self, lengths: list[int], by_bounce: bool, with_free: bool) -> TurnLists:
        """The lists that `end_turn` has made, with the fetched `lengths`; valid until `back`."""
        place = lengths[Length.DONE] + lengths[Length.FREE]
        free = self._slots[:place] if place and with_free else None
        bounced, parts = self._part(place, lengths, Length.BOUNCE), []
        for length in (Length.BOUNCE_1, Length.BOUNCE_2, Length.BOUNCE_LATER):
            if by_bounce:
                parts.append(self._part(place, lengths, length))
            place += lengths[length]
        return TurnLists(free, bounced, parts, self._part(place, lengths, Length.SHADOW))

    def _part(self, place: int, lengths: list[int], which: Length) -> SlotList:
        length = lengths[which]
        return SlotList(self._slots[place : place + length], self.counts.at(which), length) if length else NO_SLOTS

    def _make(self, lists: ListSet, status: wp.array, by_bounce: bool = False, with_free: bool = False) -> None:
        count_paths, scatter_paths = list_kernels(lists, self._walks and lists is ListSet.TURN)
        counts, offsets = self._work[lists]
        rule = (status, self._block_size, int(by_bounce), int(with_free))
        threads = self._blocks * (32 if self._device.is_cuda else 1)
        if self._device.is_cuda or self._blocks > 1:
            self._launches.launch(count_paths, threads, *rule, counts)
            wp.utils.array_scan(counts, offsets, inclusive=False)
        self._launches.launch(scatter_paths, threads, *rule, offsets, self._slots, self.counts.on_device)
