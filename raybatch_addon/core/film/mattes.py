"""Mattes by identity (Cryptomatte): how much of a pixel belongs to which object, material or asset, as exact sums.

A pixel has a few slots on the device for each kind of identity. What finds none is set aside, fetched, and kept by the
host. In the host's memory the order of entries is fixed, weights are integers, and nothing is left out: so films merge
exactly, whatever was set aside when. The passes show the identities with most weight, as "Cryptomatte" by Friedman and
Jones (2015) stores them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ..native.structs import to_numpy
from ..scene.passes import MATTE_KINDS, matte_kinds

# Identities that a pixel has slots for, of each kind
SLOTS = 6
# Weights are counted in units of its inverse
WEIGHT_SCALE = 2.0**24
# A sample weighs no more (paths that pass transparent surfaces may carry more than 1, seldom): so sums of 2^31 samples
# stay in 64 bits
_WEIGHT_MOST = 64.0


@wp.struct
class MatteEntry:
    """A weight that found no slot."""

    cell: int  # pixel times the number of kinds, plus the kind
    identity: int  # bits of the hash as a float
    weight: wp.int64


@wp.struct
class MatteTile:
    """Mattes of one tile; without entries where no pass asks for them."""

    identity: wp.array2d(dtype=int)  # 0: a free slot; shape [kinds * SLOTS, pixels]
    weight: wp.array2d(dtype=wp.int64)  # [1 / WEIGHT_SCALE], shape [kinds * SLOTS, pixels]
    aside: wp.array(dtype=MatteEntry)  # what found no slot since it was fetched
    aside_count: wp.array(dtype=int)  # shape [1]


@wp.func
def add_matte(mattes: MatteTile, kind: int, pixel: int, identity: int, weight: float):
    """Add `weight`, above 0, of a sample to an identity of a pixel."""
    units = wp.int64(wp.float64(wp.clamp(weight, 0.0, wp.static(_WEIGHT_MOST))) * wp.static(wp.float64(WEIGHT_SCALE)))
    placed = bool(False)
    slot = int(0)
    while slot < wp.static(SLOTS) and not placed:
        row = kind * wp.static(SLOTS) + slot
        there = wp.atomic_cas(mattes.identity, row, pixel, 0, identity)
        if there == 0 or there == identity:
            wp.atomic_add(mattes.weight, row, pixel, units)
            placed = True
        slot += 1
    if not placed:
        entry = MatteEntry()
        entry.cell = pixel * (mattes.identity.shape[0] / wp.static(SLOTS)) + kind
        entry.identity = identity
        entry.weight = units
        mattes.aside[wp.atomic_add(mattes.aside_count, 0, 1)] = entry


def _none(dtype: type) -> np.ndarray:
    return np.zeros(0, dtype)


@dataclass
class Mattes:
    """Weights by cell and identity in the host's memory: each pair once, in order."""

    cell: np.ndarray = field(default_factory=lambda: _none(np.int64))  # pixel * kinds + kind; int64, shape [n]
    identity: np.ndarray = field(default_factory=lambda: _none(np.uint32))  # shape [n]
    weight: np.ndarray = field(default_factory=lambda: _none(np.int64))  # [1 / WEIGHT_SCALE], shape [n]

    @staticmethod
    def of_device(film: MatteTile) -> Mattes:
        """What is in the slots of a tile."""
        if film.identity.size == 0:
            return Mattes()
        identity, weight = to_numpy(film.identity), to_numpy(film.weight)
        row, pixel = np.nonzero(identity)
        kinds = len(identity) // SLOTS
        return Mattes().plus(
            Mattes(pixel * kinds + row // SLOTS, identity[row, pixel].view(np.uint32), weight[row, pixel])
        )

    @staticmethod
    def of_entries(entries: np.ndarray) -> Mattes:
        """`MatteEntry`s that were set aside."""
        identity = np.ascontiguousarray(entries["identity"]).view(np.uint32)
        return Mattes().plus(Mattes(entries["cell"].astype(np.int64), identity, entries["weight"].astype(np.int64)))

    def plus(self, other: Mattes) -> Mattes:
        """The sum of both."""
        cell = np.concatenate([self.cell, other.cell])
        identity = np.concatenate([self.identity, other.identity])
        weight = np.concatenate([self.weight, other.weight])
        order = np.lexsort((identity, cell))
        cell, identity, weight = cell[order], identity[order], weight[order]
        begins = np.ones(len(cell), bool)
        begins[1:] = (cell[1:] != cell[:-1]) | (identity[1:] != identity[:-1])
        first = np.flatnonzero(begins)
        sums = np.add.reduceat(weight, first) if len(first) else weight
        return Mattes(cell[first], identity[first], sums)

    def part(self, pixels: np.ndarray, kinds: int) -> Mattes:
        """Mattes of some pixels, which are numbered by their places in `pixels`."""
        if not len(self.cell):
            return Mattes()
        place = np.full(max(int(pixels.max(initial=0)), int(self.cell.max()) // kinds) + 1, -1, np.int64)
        place[pixels] = np.arange(len(pixels))
        there = place[self.cell // kinds]
        chosen = there >= 0
        moved = Mattes(there[chosen] * kinds + self.cell[chosen] % kinds, self.identity[chosen], self.weight[chosen])
        return Mattes().plus(moved)

    def moved(self, pixels: np.ndarray, kinds: int) -> Mattes:
        """The same, with pixel i numbered `pixels[i]`."""
        if not len(self.cell):
            return Mattes()
        return Mattes().plus(Mattes(pixels[self.cell // kinds] * kinds + self.cell % kinds, self.identity, self.weight))

    def ranks(self, by_weight: bool) -> tuple[np.ndarray, np.ndarray]:
        """An order of the entries, cell by cell, in each by falling weight or as they are; and the place in its cell of
        each, in that order.
        """
        order = np.lexsort((self.identity, -self.weight, self.cell)) if by_weight else np.arange(len(self.cell))
        cell = self.cell[order]
        begins = np.ones(len(cell), bool)
        begins[1:] = cell[1:] != cell[:-1]
        first = np.flatnonzero(begins)
        return order, np.arange(len(cell)) - np.repeat(first, np.diff(np.append(first, len(cell))))

    def passes(self, pass_names: tuple[str, ...], counts: np.ndarray) -> dict[str, np.ndarray]:
        """The passes among `pass_names` that show mattes, float32, shape [pixels * 4], of `counts` samples, int64,
        shape [pixels]: two identities and their shares of the pixel each, those with most weight first.
        """
        kinds = matte_kinds(pass_names)
        names = [name for name in pass_names if name.startswith(MATTE_KINDS)]
        shown = {name: np.zeros((len(counts), 4), np.float32) for name in names}
        order, rank = self.ranks(by_weight=True)
        pixel, kind = np.divmod(self.cell[order], max(len(kinds), 1))
        share = (self.weight[order] / (WEIGHT_SCALE * np.maximum(counts, 1)[pixel])).astype(np.float32)
        identity = self.identity[order].view(np.float32)
        for name, values in shown.items():
            of_kind, level = next(each for each in MATTE_KINDS if name.startswith(each)), int(name[-2:])
            for half in (0, 1):
                here = (kind == kinds.index(of_kind)) & (rank == 2 * level + half)
                values[pixel[here], 2 * half] = identity[here]
                values[pixel[here], 2 * half + 1] = share[here]
        return {name: values.reshape(-1) for name, values in shown.items()}


def matte_tile(pixel_count: int, kinds: int, device: wp.Device) -> MatteTile:
    """Empty slots of so many pixels; the arrays of what is set aside are the worker's."""
    tile = MatteTile()
    shape = (kinds * SLOTS, pixel_count if kinds else 0)
    tile.identity = wp.zeros(shape, dtype=int, device=device)
    tile.weight = wp.zeros(shape, dtype=wp.int64, device=device)
    return tile


def mattes_on_device(mattes: Mattes, pixel_count: int, kinds: int, device: wp.Device) -> tuple[MatteTile, Mattes]:
    """A tile with `mattes` in its slots, and those that find none."""
    tile = matte_tile(pixel_count, kinds, device)
    if not kinds:
        return tile, mattes
    _, rank = mattes.ranks(by_weight=False)
    placed = rank < SLOTS
    pixel, kind = np.divmod(mattes.cell[placed], kinds)
    identity, weight = to_numpy(tile.identity), to_numpy(tile.weight)
    row = kind * SLOTS + rank[placed]
    identity[row, pixel], weight[row, pixel] = mattes.identity[placed].view(np.int32), mattes.weight[placed]
    tile.identity, tile.weight = (
        wp.array(each, dtype=dtype, device=device) for each, dtype in ((identity, int), (weight, wp.int64))
    )
    left = ~placed
    return tile, Mattes(mattes.cell[left], mattes.identity[left], mattes.weight[left])
