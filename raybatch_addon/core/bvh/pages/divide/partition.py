"""A mesh divided into chunks of nearby triangles, each small enough to be built, stored and copied as one.

Triangles are counted in a coarse grid by the middles of their boxes. Boxes of the grid are split in two, where that is
estimated to be cheapest by surface area, until they hold few enough triangles; what is too crowded for the grid is
divided again by a finer one. Triangles that are long beside a chunk lie apart, in chunks of their own, so that the
boxes of the others stay tight.

What is proportional to triangles is done by whatever builds their trees (`listed.py`). The chunks do not depend on what
that is, nor on the number of threads.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp

from .cells import CellGrid
from .listed import Triangles

# Cells of a grid: one for each triangle, but not more than this
_CELLS_MAX, _CELLS_MIN = 1 << 21, 64
# A box of the grid whose edges are no more cells than this is too coarse to be split well: it gets a grid of its own
_COARSE_CELLS = 4
# A triangle is long whose box is larger than this share of a chunk's estimated edge, unless so many are that it shows
# nothing
_LONG_EDGE, _LONG_SHARE_MAX = 0.5, 0.25
# Long triangles of a chunk, or more, for not many more than so many chunks of them
_LONG_CHUNK, _LONG_CHUNKS = 32, 64


def partition_triangles(triangles: Triangles, size_max: int, numbers: np.ndarray | None = None) -> list[np.ndarray]:
    """The triangles of each chunk, int32; chunks that follow each other are near each other mostly.

    Args:
        triangles: of finite corners.
        size_max: most triangles of a chunk, at least 1.
        numbers: those that are divided, int32 in rising order; None: all. Those of a chunk rise too.

    Raises `BuildCancelledError`.
    """
    count = triangles.count if numbers is None else len(numbers)
    if count == 0:
        return []
    if count <= size_max:
        return [np.arange(count, dtype=np.int32) if numbers is None else numbers]
    return _divide(triangles, numbers, size_max, apart=True)


def _divide(triangles: Triangles, numbers: np.ndarray | None, size_max: int, apart: bool = False) -> list[np.ndarray]:
    """Chunks of the triangles `numbers`, more than one chunk's; None: of all. `apart`: long ones are kept apart."""
    count = triangles.count if numbers is None else len(numbers)
    low, high = triangles.bounds(numbers)
    grid = _Grid.over(low, high, count)
    if grid is None:
        listed = np.arange(count, dtype=np.int32) if numbers is None else numbers
        return [listed[int(a) : int(b)] for a, b in _runs(count, size_max)]
    # the edge of a chunk is estimated as that of a part of a surface; middles are doubled
    long_edge = _LONG_EDGE * float((high - low).max()) / 2 / np.sqrt(count / size_max) if apart else np.inf
    cells = grid.cells(long_edge)
    held = triangles.held(numbers, cells)
    if held[-1] > _LONG_SHARE_MAX * count:
        cells = grid.cells(np.inf)
        held = triangles.held(numbers, cells)
    labels, leaf_count = _split(held[:-1].reshape(grid.shape), grid.edge, size_max)
    groups = triangles.with_labels(numbers, cells, np.append(labels.ravel(), np.int32(leaf_count)), leaf_count + 1)
    chunks = []
    # long triangles meet rays everywhere: smaller chunks of them
    sizes = [size_max] * leaf_count + [min(size_max, max(_LONG_CHUNK, len(groups[-1]) // _LONG_CHUNKS))]
    for group, most in zip(groups, sizes, strict=True):
        if len(group) > most:
            chunks += _divide(triangles, group, most)
        elif len(group):
            chunks.append(group)
    return chunks


def _runs(count: int, size_max: int) -> Iterator[tuple[int, int]]:
    """0..count in runs of about the same length."""
    ends = np.linspace(0, count, -(-count // size_max) + 1).astype(np.int64)
    return itertools.pairwise(ends)


@dataclass(frozen=True)
class _Grid:
    """Equal cells over the middles of triangles."""

    low: np.ndarray  # float32 [3]
    scale: np.ndarray  # cells per metre, float32 [3]; 0 where there is one cell
    shape: tuple[int, int, int]
    edge: np.ndarray  # of a cell, float64 [3]

    @staticmethod
    def over(low: np.ndarray, high: np.ndarray, count: int) -> _Grid | None:
        """A grid of cells that are nearly cubes; None where all middles are equal."""
        extent = high.astype(np.float64) - low
        shape = np.ones(3, np.int64)
        flat = extent <= 1e-6 * extent.max() if extent.max() > 1e-36 else np.ones(3, bool)
        if flat.all():
            return None
        cells = float(np.clip(count, _CELLS_MIN, _CELLS_MAX))
        while True:
            # thin axes that would get less than two cells get one, and the others what is left
            edge = (np.prod(extent[~flat]) / cells) ** (1 / (~flat).sum())
            thin = ~flat & (extent < edge)
            if not thin.any():
                break
            flat = flat | thin
        shape[~flat] = np.clip(extent[~flat] / edge, 2, _CELLS_MAX).astype(np.int64)
        scale = np.where(flat, 0, shape / np.where(flat, 1, extent))
        return _Grid(low, scale.astype(np.float32), tuple(shape.tolist()), extent / shape)

    def cells(self, long_edge: float) -> CellGrid:
        """The grid as devices take it; triangles of longer edges have a cell behind all others."""
        cells = CellGrid()
        cells.low, cells.scale = wp.vec3(*self.low.tolist()), wp.vec3(*self.scale.tolist())
        # edges are float32: the largest of them that is no greater divides them alike
        edge = np.float32(long_edge)
        edge = np.nextafter(edge, np.float32(0)) if edge > long_edge else edge
        cells.shape, cells.long_edge = wp.vec3i(*self.shape), float(edge)
        return cells


def _split(held: np.ndarray, edge: np.ndarray, size_max: int) -> tuple[np.ndarray, int]:
    """A label for each cell of the grid: boxes that hold at most `size_max`, or are too coarse; and how many labels
    there are.
    """
    labels = np.zeros(held.shape, np.int32)
    leaf_count = 0
    stack = [tuple(slice(0, n) for n in held.shape)]
    coarse = 1  # the whole is split wherever it can be, so that every division comes to an end
    while stack:
        box, part = _tight(held, stack.pop())
        if part.count > size_max and max(part.shape) > coarse:
            axis, plane = _best_plane(part, edge, size_max)
            middle = box[axis].start + plane
            # the first is on top
            stack.append((*box[:axis], slice(middle, box[axis].stop), *box[axis + 1 :]))
            stack.append((*box[:axis], slice(box[axis].start, middle), *box[axis + 1 :]))
        else:
            labels[box] = leaf_count
            leaf_count += 1
        coarse = _COARSE_CELLS
    return labels, leaf_count


class _Part(NamedTuple):
    """The content of a box of the grid, seen along each axis."""

    there: list[np.ndarray]  # whether there is anything along this axis, bool, by the cells of the other two
    profiles: list[np.ndarray]  # triangles of each slice across this axis, int64

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return tuple(len(profile) for profile in self.profiles)

    @property
    def count(self) -> int:
        """Number of triangles."""
        return int(self.profiles[0].sum())


def _tight(held: np.ndarray, box: tuple[slice, ...]) -> tuple[tuple[slice, ...], _Part]:
    """The part of a box that holds anything, and what that is."""
    part = held[box]
    filled = part > 0
    there = [filled.any(axis) for axis in range(3)]
    level = part.sum(2)
    profiles = [level.sum(1), level.sum(0), part.sum(0).sum(0)]
    ends = [np.flatnonzero(profile)[[0, -1]].tolist() for profile in profiles]
    inside = [slice(first, last + 1) for first, last in ends]
    others = [[inside[k] for k in range(3) if k != axis] for axis in range(3)]
    return (
        tuple(slice(each.start + first, each.start + last + 1) for each, (first, last) in zip(box, ends)),
        _Part([there[axis][tuple(others[axis])] for axis in range(3)], [profiles[k][inside[k]] for k in range(3)]),
    )


def _best_plane(part: _Part, edge: np.ndarray, size_max: int) -> tuple[int, int]:
    """Axis and first slice of the second half of the cheapest split of a tight box, of which no half is empty.

    A half costs its surface area for each chunk that it must become: half-full chunks cost like full ones, so few come
    out. What is left equal is decided by triangles.
    """
    best = (np.inf, 0, 0)
    for axis in range(3):
        if part.shape[axis] < 2:
            continue
        others = [k for k in range(3) if k != axis]
        profile = part.profiles[axis]
        length = np.arange(1, len(profile) + 1) * edge[axis]
        area = np.zeros((2, len(profile)))
        spans = []
        for k in others:
            across = part.there[3 - axis - k]  # of `axis` and `k`, in the order of the axes
            across = across if axis < k else across.T
            first, last = across.argmax(1), across.shape[1] - across[:, ::-1].argmax(1)
            empty = ~across.any(1)
            first[empty], last[empty] = across.shape[1], 0
            up = np.maximum.accumulate(last) - np.minimum.accumulate(first)
            down = (np.maximum.accumulate(last[::-1]) - np.minimum.accumulate(first[::-1]))[::-1]
            spans.append((up * edge[k], down * edge[k]))
        for side, along in ((0, length), (1, length[::-1])):
            area[side] = along * (spans[0][side] + spans[1][side]) + spans[0][side] * spans[1][side]
        left = np.cumsum(profile)[:-1]
        right = profile.sum() - left
        chunks_left, chunks_right = (-(-n // size_max) + 0.01 * n / size_max for n in (left, right))
        cost = area[0, :-1] * chunks_left + area[1, 1:] * chunks_right
        i = int(cost.argmin())
        if cost[i] < best[0]:
            best = (float(cost[i]), axis, i + 1)
    return best[1], best[2]
