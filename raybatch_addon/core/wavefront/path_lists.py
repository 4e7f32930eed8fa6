"""Lists of path slots by status, made by counting, exclusive scan and scatter: no locks, and always in slot order.

Paths are counted in blocks, so that the work arrays have entries for blocks only: on CUDA each warp counts a block, its
lanes by votes; on the CPU one block holds all paths, so that one launch counts and scatters, and vector
units look at many words at a time: where a tile comes to its end few of its slots are still in use. All lists of a
worker lie in one array of two entries a path, a list behind the one before it:

- at the end of a turn paths at their end, free slots (as long as there are paths to generate), and new extending rays
  by bounce: together at most one entry a path. Behind them new shadow rays, of which a path may have one too;
- when rays are back, paths that left the scene, and in the array's second half paths that met a surface. By then the
  lists of the turn before are used up.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from enum import Enum, IntEnum

import warp as wp

from ..device.kernel import KERNEL_OPTIONS
from ..device.launches import RepeatedLaunches
from ..native.build import native_source
from ..native.structs import to_numpy
from ..rays import NO_RAYS, RayList
from .rays import BOUNCE_SHIFT, Status

# Paths that a warp counts, a multiple of 32
CUDA_BLOCK = 256


class Length(IntEnum):
    """Indices of the lists' lengths among a worker's counts."""

    DONE = 0  # paths at their end
    FREE = 1  # slots that were free before
    # new extending rays of paths that have scattered once (or not yet, and only passed what is transparent)
    BOUNCE_1 = 2
    BOUNCE_2 = 3  # twice
    BOUNCE_LATER = 4  # more often, or of walks below surfaces: these scatter all around
    SHADOW = 5  # new shadow rays
    BOUNCE = 6  # all new extending rays
    MISS = 7  # paths that left the scene
    SURFACE = 8  # paths that met a surface
    CAMERA = 9  # new paths
    SPILL = 10  # channels that were set aside
    MATTES = 11  # weights of mattes that were set aside


class ListSet(Enum):
    """Lists that are made together, in the order of their `Length`s."""

    TURN = 6  # DONE to SHADOW
    BACK = 2  # MISS, SURFACE


@functools.cache
def list_kernels(lists: ListSet, walks: bool) -> tuple[wp.Kernel, wp.Kernel]:
    """Kernels (status, block_size, by_bounce, with_free, counts) and (status, block_size, by_bounce, with_free,
    offsets, slots, lengths).

    The first counts each block's paths of every list, the second writes the lists to `slots`, flips the status of rays
    that are listed, and writes `lengths`. `counts` and `offsets`, its exclusive scan, have shape [lists * blocks + 1];
    where there is one block the CPU's second kernel counts for itself, and reads no `offsets`. A block is `block_size`
    paths; on CUDA 32 threads take one, on the CPU one thread. `walks`: rays may be steps of walks below surfaces.
    """
    status_bits = {each.name: int(each) for each in Status}
    if not walks:
        status_bits["INSIDE"] = 0  # a scene without walks does not look for them
    defines = {
        "TURN": lists is ListSet.TURN,
        "LISTS": lists.value,
        "BOUNCE_SHIFT": BOUNCE_SHIFT,
        **status_bits,
        **{f"LENGTH_{each.name}": int(each) for each in Length},
    }

    @wp.func_native(native_source("lists/block.h", "lists/count.h", **defines))
    def count_block(
        status: wp.array(dtype=int),
        block_size: int,
        by_bounce: int,
        with_free: int,
        counts: wp.array(dtype=int),
        thread: int,
    ): ...

    @wp.func_native(native_source("lists/block.h", "lists/scatter.h", **defines))
    def scatter_block(
        status: wp.array(dtype=int),
        block_size: int,
        by_bounce: int,
        with_free: int,
        offsets: wp.array(dtype=int),
        slots: wp.array(dtype=int),
        lengths: wp.array(dtype=int),
        thread: int,
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def count_paths(
        status: wp.array(dtype=int), block_size: int, by_bounce: int, with_free: int, counts: wp.array(dtype=int)
    ):
        count_block(status, block_size, by_bounce, with_free, counts, wp.tid())

    @wp.kernel(**KERNEL_OPTIONS)
    def scatter_paths(
        status: wp.array(dtype=int),
        block_size: int,
        by_bounce: int,
        with_free: int,
        offsets: wp.array(dtype=int),
        slots: wp.array(dtype=int),
        lengths: wp.array(dtype=int),
    ):
        scatter_block(status, block_size, by_bounce, with_free, offsets, slots, lengths, wp.tid())

    return count_paths, scatter_paths


def path_list_kernels(walks: bool) -> list[wp.Kernel]:
    """Everything that `PathLists` launches."""
    return [*list_kernels(ListSet.TURN, walks), *list_kernels(ListSet.BACK, False)]


class Counts:
    """Lengths of all lists of a worker, side by side on the device, so that one copy brings them to the host."""

    def __init__(self, device: wp.Device):
        size = len(Length)
        self.on_device = wp.zeros(size, dtype=int, device=device)
        # a CUDA device writes to memory that the host has pinned without a detour
        self._on_host = wp.zeros(size, dtype=int, device="cpu", pinned=True) if device.is_cuda else self.on_device
        self._lengths = to_numpy(self._on_host)  # the same memory
        self._single = [self.on_device[i : i + 1] for i in range(size)]
        self._sent = wp.Event(device) if device.is_cuda else None

    def at(self, index: int) -> wp.array:
        """One count, int32, shape [1]."""
        return self._single[index]

    def send(self) -> None:
        """They go to the host behind what was launched."""
        if self._sent:
            wp.copy(self._on_host, self.on_device)
            self.on_device.device.stream.record_event(self._sent)

    def arrived(self) -> list[int]:
        """All of them, as they were sent last; waits for the device."""
        if self._sent:
            wp.synchronize_event(self._sent)
        return self._lengths.tolist()

    def fetch(self) -> list[int]:
        """All of them, once the device has done what was launched."""
        self.send()
        return self.arrived()


@dataclass(frozen=True)
class TurnLists:
    """The lists that the next turn begins with."""

    free: wp.array | None  # free slots, those of paths at their end too, if they were asked for
    bounced: RayList  # new extending rays
    bounced_parts: list[RayList]  # the same by bounce, if that was asked for
    shadow: RayList  # new shadow rays


class PathLists:
    """Makes and holds the lists of one worker."""

    def __init__(self, path_count: int, device: wp.Device, block_size: int = 0, walks: bool = False):
        """Allocate for `path_count` paths. `block_size`: paths of a block (0: as the device asks for); `walks`: some
        may walk below surfaces.
        """
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

    def back(self, status: wp.array, bound: int) -> tuple[RayList, RayList]:
        """Paths whose rays are all back: those that left the scene, and those that met a surface; neither is longer
        than `bound`.
        """
        self._make(ListSet.BACK, status)
        lengths = (self.counts.at(Length.MISS), self.counts.at(Length.SURFACE))
        return tuple(RayList(slots, length, bound) for slots, length in zip(self._halves, lengths))

    def end_turn(self, status: wp.array, bound: int, by_bounce: bool, with_free: bool) -> RayList:
        """Make all lists of the next turn; rays in them count as under way from now on. Returns the paths at their end,
        at most `bound`.

        `by_bounce`: list new extending rays by bounce; `with_free`: list free slots, for paths that are to be
        generated.
        """
        self._make(ListSet.TURN, status, by_bounce, with_free)
        return RayList(self._halves[0], self.counts.at(Length.DONE), bound)

    def next_turn(self, lengths: list[int], by_bounce: bool, with_free: bool) -> TurnLists:
        """The lists that `end_turn` has made, with the fetched `lengths`; valid until `back`."""
        first = lengths[Length.DONE] + lengths[Length.FREE]
        free = self._slots[:first] if first and with_free else None
        bounced, parts = self._part(first, lengths, Length.BOUNCE), []
        for length in (Length.BOUNCE_1, Length.BOUNCE_2, Length.BOUNCE_LATER):
            if by_bounce:
                parts.append(self._part(first, lengths, length))
            first += lengths[length]
        return TurnLists(free, bounced, parts, self._part(first, lengths, Length.SHADOW))

    def _part(self, first: int, lengths: list[int], which: Length) -> RayList:
        length = lengths[which]
        return RayList(self._slots[first : first + length], self.counts.at(which), length) if length else NO_RAYS

    def _make(self, lists: ListSet, status: wp.array, by_bounce: bool = False, with_free: bool = False) -> None:
        count_paths, scatter_paths = list_kernels(lists, self._walks and lists is ListSet.TURN)
        counts, offsets = self._work[lists]
        rule = (status, self._block_size, int(by_bounce), int(with_free))
        threads = self._blocks * (32 if self._device.is_cuda else 1)
        if self._device.is_cuda or self._blocks > 1:
            self._launches.launch(count_paths, threads, *rule, counts)
            wp.utils.array_scan(counts, offsets, inclusive=False)
        self._launches.launch(scatter_paths, threads, *rule, offsets, self._slots, self.counts.on_device)
