"""Slots on the device for tiles of images, and which tile is in which.

Between two turns of a worker's loop the tiles that its waiting rays need are brought in: all of them where they have
room, else those that the next ray needs, and then those that most look-ups want. Where slots are needed the tile leaves
that was read the longest time ago. While kernels run the slots stay as they are, so that whoever found all of its tiles
finds them until it is shaded.

A GPU copies tiles on a stream of its own while the next turn runs. A tile leaves before its slot is written, and one
that comes is shown a turn later, when its copy is over.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ...errors import BudgetError
from ...native.structs import record_type, to_numpy, upload_records
from ...shading.images.textures import ImageEntry, ImageTable
from ...shading.images.tiled.look_up import MARKS, PINNED, WANTED
from ...shading.images.tiled.pictures import TileSource
from .carry import TileCarrier
from .marks import IS_WANTED, WAS_SEEN, condense_marks_kernel
from .policy import choose_tiles, urgency_of

_WORD_BYTES = 8  # slots are arrays of words
_BLOCK_BYTES = 1 << 30  # of an array of slots


@dataclass(kw_only=True)
class TileTotals:
    """What was brought to one pool, or to several together."""

    tiles: int = 0  # of all images
    slots: int = 0
    slot_bytes: int = 0
    fetched: int = 0
    evicted: int = 0
    bytes: int = 0  # of the fetched ones
    turns: int = 0  # in which some were
    seconds: float = 0.0  # that took the host
    looked: int = 0  # times that a ray looked up images in tiles
    waited: int = 0  # times that it had to wait
    lost: int = 0  # look-ups that found no tile: a fault

    def report(self) -> dict[str, Any]:
        """For the statistics (see docs/statistics.md)."""
        share = self.waited / self.looked if self.looked else 0.0
        return {**dataclasses.asdict(self), "seconds": round(self.seconds, 6), "waited_share": round(share, 6)}

    def warnings(self) -> list[str]:
        """A fault, where there is one."""
        if not self.lost:
            return []
        return [
            f"{self.lost:,} look-ups of images found a tile that was not there, and are black; this is a fault, please "
            "report the scene"
        ]

    def merge(self, other: TileTotals) -> TileTotals:
        """Both together, of the same images."""
        merged = {
            each.name: getattr(self, each.name) + getattr(other, each.name) for each in dataclasses.fields(TileTotals)
        }
        return TileTotals(**{**merged, "tiles": self.tiles, "slot_bytes": self.slot_bytes})


def tile_slots_of(source: TileSource, budget: int, whole: int, workers: int, least: int) -> int:
    """Slots of each of `workers`, of `budget` bytes for all of them and for `whole` bytes of images that are not in
    tiles; at most one for each tile. Raises `BudgetError` where they are fewer than `least`, which one path may
    need at once.
    """
    slots = min(max(budget - whole, 0) // workers // source.slot_bytes, source.tile_count)
    if slots < min(least, source.tile_count):
        raise _few_slots(source, budget, whole, workers, least)
    return slots


def refuse_few_slots(source: TileSource, budget: int, whole: int, workers: int, least: int) -> None:
    """Raise the `BudgetError` of `tile_slots_of`, with what `workers` need, where there are too few for one of them: so
    much is known before it is known how many there will be.
    """
    if max(budget - whole, 0) // source.slot_bytes < min(least, source.tile_count):
        raise _few_slots(source, budget, whole, workers, least)


def _few_slots(source: TileSource, budget: int, whole: int, workers: int, least: int) -> BudgetError:
    least = min(least, source.tile_count)
    size = source.slot_bytes
    each, fewer = (f"for each of {workers} workers ", " or thread_count") if workers > 1 else ("", "")
    return BudgetError(
        f"texture_budget is {budget:,} bytes, and this scene needs {whole + least * workers * size:,} at least: "
        f"{whole:,} for images that are not in tiles, and {each}{least} tiles of {size:,}, which "
        f"one path may read at once; raise it, or lower texture_tile_size{fewer}, or set it to 0"
    )


class TilePool:
    """The slots of one worker, and its table of images."""

    def __init__(self, source: TileSource, slots: int):
        """`slots` for tiles of `source`."""
        self._source, self._device, self._rows = source, source.device, source.rows
        # half of the slots are filled while rays read the other half
        self._most = max(1, slots // 2) if source.device.is_cuda else slots
        # it is deleted before the slots, and waits for what is copied to them
        self._carrier = TileCarrier(source, self._most) if source.device.is_cuda else None
        device, numbers, size = source.device, source.number_count, source.slot_bytes
        self._on_host = wp.zeros(numbers, dtype=wp.uint64, device="cpu", pinned=device.is_cuda)
        self._addresses = to_numpy(self._on_host)
        self._on_device = wp.zeros(numbers, dtype=wp.uint64, device=device)
        self._marks = wp.zeros(MARKS * numbers, dtype=int, device=device)
        self._marks_host: wp.array | None = None  # where they are read one by one
        self._asked = wp.zeros(numbers, dtype=wp.uint8, device=device)
        self._asked_host = (
            wp.zeros(numbers, dtype=wp.uint8, device="cpu", pinned=True) if device.is_cuda else self._asked
        )
        self._addresses[self._rows] = self._marks.ptr + 4 * MARKS * self._rows.astype(np.uint64)
        self._per_block = max(1, _BLOCK_BYTES // size)
        self._blocks = [
            wp.zeros((min(self._per_block, slots - first), size // _WORD_BYTES), dtype=wp.uint64, device=device)
            for first in range(0, slots, self._per_block)
        ]
        self._block_addresses = np.array([each.ptr for each in self._blocks], np.uint64)
        self._tile_in = np.full(slots, -1, np.int64)  # number of the tile in a slot; -1: none
        self._slot_of = np.full(numbers, -1, np.int64)
        self._turn = 0  # in which tiles were brought, of all renders
        self._used_at = np.zeros(numbers, np.int64)  # the turn in which a tile was read last
        self._coming = np.zeros(0, np.int64)  # tiles that are being copied, and are shown in the next turn
        self.totals = TileTotals(tiles=source.tile_count, slots=slots, slot_bytes=size)
        self.table = ImageTable()
        entries = source.entries_at(self._on_device.ptr).astype(record_type(ImageEntry))
        self.table.entries = upload_records(entries, ImageEntry, device)
        self.table.tiles = source.table_tiles
        wp.copy(self._on_device, self._on_host)

    def begin(self) -> None:
        """Count anew; tiles stay where they are."""
        self._count_lost()
        totals = self.totals
        self.totals = TileTotals(tiles=totals.tiles, slots=totals.slots, slot_bytes=totals.slot_bytes)

    def bring(self) -> None:
        """Bring the tiles that waiting rays want by the marks, which are cleared."""
        started = time.perf_counter()
        asked = self._read_marks()
        self.totals.turns += 1
        self._turn += 1
        np.copyto(self._used_at, self._turn, where=(asked & WAS_SEEN).view(bool))
        missing, kept = self._choose(np.flatnonzero(asked & IS_WANTED))
        self._marks.zero_()
        self._show_coming()
        self._fill(missing, kept)
        wp.copy(self._on_device, self._on_host)  # kernels from now on find the tiles that are there
        self.totals.seconds += time.perf_counter() - started

    def count(self) -> TileTotals:
        """What was done since `begin`; waits for the device."""
        self._count_lost()
        return self.totals

    def _count_lost(self) -> None:
        self._read_marks()
        self._marks.zero_()

    def _read_marks(self) -> np.ndarray:
        """What was asked of each tile, as bits; look-ups that found none are counted."""
        asked = to_numpy(self._asked_host)
        wp.launch(condense_marks_kernel, len(asked), [self._marks, self._asked], device=self._device)
        if self._device.is_cuda:
            wp.copy(self._asked_host, self._asked)
            wp.synchronize_stream(self._device.stream)
        rows = self._rows
        if asked[rows].any():
            self.totals.lost += int(self._all_marks()[rows, WANTED].sum())
            asked[rows] = 0
        return asked

    def _all_marks(self) -> np.ndarray:
        """Marks of all tiles, shape [n, MARKS]."""
        if self._marks_host is None:
            self._marks_host = wp.zeros_like(self._marks, device="cpu", pinned=self._device.is_cuda)
        wp.copy(self._marks_host, self._marks)
        if self._device.is_cuda:
            wp.synchronize_stream(self._device.stream)
        return to_numpy(self._marks_host).reshape(-1, MARKS)

    def _choose(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the tiles `wanted` those to bring, and those that stay."""
        is_there, slots = self._slot_of[wanted] >= 0, len(self._tile_in)
        missing, kept = wanted[~is_there], wanted[is_there]
        if len(wanted) > slots or len(missing) > self._most:
            marks = self._all_marks()[wanted]
            urgency = urgency_of(marks[:, WANTED], marks[:, PINNED] != 0)
            missing, kept = (wanted[places] for places in choose_tiles(urgency, is_there, slots, self._most))
        self._used_at[missing] = self._used_at[kept] = self._turn
        return missing, kept

    def _show_coming(self) -> None:
        """Tiles have come that were on their way."""
        if self._carrier and len(self._coming):
            self._carrier.wait()
            self._addresses[self._coming] = self._slot_addresses(self._slot_of[self._coming])
            self._coming = self._coming[:0]

    def _slot_addresses(self, slots: np.ndarray) -> np.ndarray:
        block, row = np.divmod(slots, self._per_block)
        return self._block_addresses[block] + (row * self._source.slot_bytes).astype(np.uint64)

    def _fill(self, missing: np.ndarray, kept: np.ndarray) -> None:
        """Bring the tiles `missing`, into slots whose tile is none of `kept`."""
        if not len(missing):
            return
        slots = self._slots_for(len(missing), kept)
        left = self._tile_in[slots]
        left = left[left >= 0]
        self._slot_of[left], self._addresses[left] = -1, 0
        self._tile_in[slots], self._slot_of[missing] = missing, slots
        if self._carrier:
            self.totals.bytes += self._carrier.carry(missing, self._slot_addresses(slots))
            self._coming = missing
        else:
            for number, block, row in zip(
                missing.tolist(), *(each.tolist() for each in divmod(slots, self._per_block))
            ):
                target = to_numpy(self._blocks[block])[row].view(np.uint8)
                self.totals.bytes += self._source.copy_tile(number, target)
            self._addresses[missing] = self._slot_addresses(slots)
        self.totals.fetched += len(missing)
        self.totals.evicted += len(left)

    def _slots_for(self, count: int, kept: np.ndarray) -> np.ndarray:
        """So many slots whose tile is none of `kept`: empty ones, then those that were read the longest time ago."""
        is_free = np.ones(len(self._tile_in), bool)
        is_free[self._slot_of[kept]] = False
        free = np.flatnonzero(is_free)
        tiles = self._tile_in[free]
        age = np.where(tiles >= 0, self._used_at[tiles], -1)
        return free[np.argpartition(age, count - 1)[:count]] if count < len(free) else free
