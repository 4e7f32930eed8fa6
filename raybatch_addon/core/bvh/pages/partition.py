"""A mesh divided into chunks of nearby triangles, each small enough to be built, stored and copied as one.

Triangles are counted in a coarse grid by the middles of their boxes. Boxes of the grid are split in two, where that is
estimated to be cheapest by surface area, until they hold few enough triangles; what is too crowded for the grid is
divided again by a finer one. Triangles that are long beside a chunk lie apart, in chunks of their own, so that the
boxes of the others stay tight.

Everything works on slices of the mesh, in threads: memory is that of the result twice, and a little. The chunks do not
depend on the number of threads.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...device.devices import worker_count
from ...errors import check_cancelled

# Triangles that a thread looks at together
_SLICE = 1 << 18
# Cells of a grid: one for each triangle, but not more than this
_CELLS_MAX, _CELLS_MIN = 1 << 21, 64
# A box of the grid whose edges are no more cells than this is too coarse to be split well: it gets a grid of its own
_COARSE_CELLS = 4
# A triangle is long whose box is larger than this share of a chunk's estimated edge, unless so many are that it tells
# nothing
_LONG_EDGE, _LONG_SHARE_MAX = 0.5, 0.25
# Long triangles of a chunk, or more, for not many more than so many chunks of them
_LONG_CHUNK, _LONG_CHUNKS = 32, 64


def partition_triangles(
    positions: np.ndarray,
    triangles: np.ndarray,
    size_max: int,
    thread_count: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[np.ndarray]:
    """The triangles of each chunk, int32 in rising order; chunks that follow each other are near each other mostly.

    Args:
        positions: float32 [v, 3], finite.
        triangles: int32 [n, 3], indices into them.
        size_max: most triangles of a chunk, at least 1.
        thread_count: 0: as many as cores.
        cancelled: may be asked on any thread.

    Raises `BuildCancelledError`.
    """
    if len(triangles) == 0:
        return []
    if len(triangles) <= size_max:
        return [np.arange(len(triangles), dtype=np.int32)]
    threads = worker_count(wp.get_device("cpu"), thread_count)
    with ThreadPoolExecutor(threads) as pool:
        return _divide(_Mesh(positions, triangles, pool, threads, cancelled), None, size_max)


@dataclass(frozen=True)
class _Mesh:
    positions: np.ndarray
    triangles: np.ndarray
    pool: ThreadPoolExecutor
    threads: int
    cancelled: Callable[[], bool]

    def boxes(self, numbers: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        """Twice the middle of each triangle's box, and the longest edge of the box."""
        check_cancelled(self.cancelled)
        triangles = self.triangles[numbers]
        a, b, c = (self.positions.take(triangles[:, k], axis=0) for k in range(3))
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        extent = high - low
        return low + high, np.maximum(
            np.maximum(extent[:, 0], extent[:, 1]), extent[:, 2]
        )  # NumPy is slow along short rows

    def share(self, count: int, work: Callable[[Iterator[slice]], object]) -> list:
        """`work` for runs of slices of 0..count, each run in a thread; its results in order."""
        ends = np.linspace(0, -(-count // _SLICE), min(self.threads, -(-count // _SLICE)) + 1).astype(int) * _SLICE
        runs = [(int(a), min(int(b), count)) for a, b in itertools.pairwise(ends)]

        def run(ends: tuple[int, int]) -> object:
            return work(slice(i, min(i + _SLICE, ends[1])) for i in range(ends[0], ends[1], _SLICE))

        return list(self.pool.map(run, runs)) if len(runs) > 1 else [run(runs[0])]


def _divide(mesh: _Mesh, numbers: np.ndarray | None, size_max: int) -> list[np.ndarray]:
    """Chunks of the triangles `numbers`, more than one chunk's; None: of all, where long ones are kept apart."""
    count = len(mesh.triangles) if numbers is None else len(numbers)

    def listed(part: slice) -> np.ndarray:
        return np.arange(part.start, part.stop, dtype=np.int32) if numbers is None else numbers[part]

    def bound(parts: Iterator[slice]) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.full(3, np.inf, np.float32), np.full(3, -np.inf, np.float32)
        for part in parts:
            middle, _ = mesh.boxes(part if numbers is None else numbers[part])
            low, high = np.minimum(low, middle.min(0)), np.maximum(high, middle.max(0))
        return low, high

    bounds = mesh.share(count, bound)
    low, high = np.min([each[0] for each in bounds], 0), np.max([each[1] for each in bounds], 0)
    grid = _Grid.over(low, high, count)
    if grid is None:
        return [listed(slice(int(a), int(b))) for a, b in _runs(count, size_max)]
    # of a surface; middles are doubled
    long_edge = (
        np.inf if numbers is not None else _LONG_EDGE * float((high - low).max()) / 2 / np.sqrt(count / size_max)
    )
    cells = np.empty(count, np.int32)

    def find_cells(parts: Iterator[slice]) -> np.ndarray:
        held = np.zeros(grid.cell_count + 1, np.int64)
        for part in parts:
            middle, edge = mesh.boxes(part if numbers is None else numbers[part])
            cells[part] = np.where(edge > long_edge, grid.cell_count, grid.cells(middle))  # noqa: F821
            held += np.bincount(cells[part], minlength=len(held))  # noqa: F821
        return held

    held = np.sum(mesh.share(count, find_cells), 0)
    if held[-1] > _LONG_SHARE_MAX * count:
        long_edge = np.inf
        held = np.sum(mesh.share(count, find_cells), 0)
    labels, leaf_count = _split(held[:-1].reshape(grid.shape), grid.edge, size_max)
    groups = _sorted(mesh, np.append(labels.ravel(), leaf_count), cells, leaf_count + 1, listed)
    del cells
    chunks = []
    # long triangles meet rays everywhere: smaller chunks of them
    sizes = [size_max] * leaf_count + [min(size_max, max(_LONG_CHUNK, len(groups[-1]) // _LONG_CHUNKS))]
    for group, most in zip(groups, sizes, strict=True):
        if len(group) > most:
            chunks += _divide(mesh, group, most)
        elif len(group):
            chunks.append(group)
    return chunks


def _runs(count: int, size_max: int) -> Iterator[tuple[int, int]]:
    """0..count in runs of about the same length."""
    ends = np.linspace(0, count, -(-count // size_max) + 1).astype(np.int64)
    return itertools.pairwise(ends)


def _sorted(
    mesh: _Mesh, labels: np.ndarray, cells: np.ndarray, label_count: int, listed: Callable[[slice], np.ndarray]
) -> list[np.ndarray]:
    """The triangles with each label of their cell: count, scan, scatter."""
    labels = labels.astype(np.uint16 if label_count <= 1 << 16 else np.int32)

    def count(parts: Iterator[slice]) -> tuple[list[slice], np.ndarray]:
        own, parts = np.zeros(label_count, np.int64), list(parts)
        for part in parts:
            own += np.bincount(labels[cells[part]], minlength=label_count)
        return parts, own

    counted = mesh.share(len(cells), count)
    own = np.array([each[1] for each in counted])
    ends = np.cumsum(own.sum(0))
    first = ends - own.sum(0) + np.cumsum(own, 0) - own
    order = np.empty(len(cells), np.int32)

    def scatter(job: tuple[list[slice], np.ndarray]) -> None:
        parts, index = job
        for part in parts:
            label = labels[cells[part]]
            sorted_by = np.argsort(label, kind="stable")
            each = np.bincount(label, minlength=label_count)
            order[np.repeat(index - np.cumsum(each) + each, each) + np.arange(len(label))] = listed(part)[sorted_by]
            index += each

    list(mesh.pool.map(scatter, [(each[0], index) for each, index in zip(counted, first)]))
    return np.split(order, ends[:-1])


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

    @property
    def cell_count(self) -> int:
        return int(np.prod(self.shape))

    def cells(self, middle: np.ndarray) -> np.ndarray:
        """Cell of each middle, int32."""
        cell = np.minimum(((middle - self.low) * self.scale).astype(np.int32), np.array(self.shape, np.int32) - 1)
        return (cell[:, 0] * np.int32(self.shape[1]) + cell[:, 1]) * np.int32(self.shape[2]) + cell[:, 2]


def _split(held: np.ndarray, edge: np.ndarray, size_max: int) -> tuple[np.ndarray, int]:
    """A label for each cell of the grid: boxes that hold at most `size_max`, or are too coarse; and how many labels
    there are.
    """
    labels = np.zeros(held.shape, np.int32)
    leaf_count = 0
    stack = [tuple(slice(0, n) for n in held.shape)]
    coarse = 1  # the whole is split wherever it can be, so that every division comes to an end
    while stack:
        box = _tight(held, stack.pop())
        part = held[box]
        if part.sum() > size_max and max(part.shape) > coarse:
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


def _tight(held: np.ndarray, box: tuple[slice, ...]) -> tuple[slice, ...]:
    """The part of a box that holds anything."""
    there = held[box] > 0
    ends = [np.flatnonzero(there.any(tuple(k for k in range(3) if k != axis))) for axis in range(3)]
    return tuple(slice(each.start + int(end[0]), each.start + int(end[-1]) + 1) for each, end in zip(box, ends))


def _best_plane(part: np.ndarray, edge: np.ndarray, size_max: int) -> tuple[int, int]:
    """Axis and first slice of the second half of the cheapest split of a tight box, of which no half is empty.

    A half costs its surface area for each chunk that it must become: half-full chunks cost like full ones, so few come
    out. What is left equal is decided by triangles.
    """
    there = part > 0
    best = (np.inf, 0, 0)
    for axis in range(3):
        if part.shape[axis] < 2:
            continue
        others = [k for k in range(3) if k != axis]
        profile = part.sum(tuple(others))
        length = np.arange(1, len(profile) + 1) * edge[axis]
        area = np.zeros((2, len(profile)))
        spans = []
        for k in others:
            across = there.any(3 - axis - k)  # of `axis` and `k`, in the order of the axes
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
