"""Triangles of a mesh by their numbers, wherever they lie: their bounds, how many each cell of a grid holds, and lists
of them by the labels of their cells.

On the CPU threads work on slices. A CUDA device reads triangles in host memory through the bus, a slice at a time, so
that it needs memory for a slice alone. Both do the same sums, so what they find is the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from ....device.devices import load_module, worker_count
from ....device.locked import locked_empty
from ....errors import check_cancelled
from ....native.structs import to_numpy
from ...build.cuda.order import run_first_kernel
from .cells import (
    CellGrid,
    MeshTriangles,
    cells_kernel,
    count_labels_kernel,
    labels_kernel,
    middle_bounds_kernel,
    scatter_kernel,
)

# Triangles that a thread looks at together, and a CUDA device
_SLICE, _SLICE_CUDA = 1 << 18, 1 << 23
# Threads of a CUDA device that find bounds
_LANES = 1 << 16


class Triangles(Protocol):
    """Triangles of a mesh, `numbers` of which are asked for: int32 [n], or None for all."""

    count: int  # of all

    def bounds(self, numbers: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest of twice the middles of boxes, float32 [3] each."""

    def held(self, numbers: np.ndarray | None, grid: CellGrid) -> np.ndarray:
        """How many triangles each cell of `grid` holds, those that are long behind, int64."""

    def with_labels(
        self, numbers: np.ndarray | None, grid: CellGrid, labels: np.ndarray, label_count: int
    ) -> list[np.ndarray]:
        """The triangles with each label of their cell, int32, in the order of `numbers`, which `held` was asked for
        last; `labels` int32, for each cell.
        """


def triangles_on(
    device: wp.Device,
    mesh: MeshTriangles,
    count: int,
    thread_count: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
) -> Triangles:
    """The first `count` triangles of `mesh`, which is on `device`.

    `thread_count`: of the CPU, 0: as many as cores. `cancelled` may be asked on any thread; then `BuildCancelledError`
    is raised.
    """
    if device.is_cuda:
        return CudaTriangles(device, mesh, count, cancelled)
    for kernel in partition_kernels(device):
        load_module(kernel, device)  # before threads launch them
    return HostTriangles(mesh, count, worker_count(device, thread_count), cancelled)


@dataclass
class HostTriangles:
    """`Triangles` of the CPU, which threads look at."""

    mesh: MeshTriangles
    count: int
    threads: int
    cancelled: Callable[[], bool]
    _cells: wp.array | None = None

    def bounds(self, numbers: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        listed, count = self._listed(numbers)

        def run(parts: Iterator[tuple[int, int]]) -> list[np.ndarray]:
            found, rows = [], wp.empty((1, 2), dtype=wp.vec3, device="cpu")
            for start, size in parts:
                wp.launch(middle_bounds_kernel, 1, [self.mesh, listed, start, size, 1, rows], device="cpu")
                found.append(to_numpy(rows)[0].copy())
            return found

        found = np.array([row for rows in self._share(count, run) for row in rows])
        return found[:, 0].min(0), found[:, 1].max(0)

    def held(self, numbers: np.ndarray | None, grid: CellGrid) -> np.ndarray:
        listed, count = self._listed(numbers)
        cells = self._cells = wp.empty(count, dtype=int, device="cpu")

        def run(parts: Iterator[tuple[int, int]]) -> np.ndarray:
            held = wp.zeros(_cell_count(grid) + 1, dtype=int, device="cpu")
            for start, size in parts:
                wp.launch(cells_kernel, size, [self.mesh, grid, listed, start, cells, held], device="cpu")
            return to_numpy(held)

        return np.sum(self._share(count, run), 0, dtype=np.int64)

    def with_labels(
        self, numbers: np.ndarray | None, grid: CellGrid, labels: np.ndarray, label_count: int
    ) -> list[np.ndarray]:
        listed, count = self._listed(numbers)
        own, order = wp.array(labels, dtype=int, device="cpu"), wp.empty(count, dtype=int, device="cpu")
        cells, self._cells = self._cells, None

        def counted(parts: Iterator[tuple[int, int]]) -> np.ndarray:
            counts = wp.zeros(label_count, dtype=int, device="cpu")
            for start, size in parts:
                wp.launch(count_labels_kernel, size, [own, cells, start, counts], device="cpu")
            return to_numpy(counts)

        counts = np.array(self._share(count, counted), np.int64)
        ends = np.cumsum(counts.sum(0))
        firsts = iter((ends - counts.sum(0) + np.cumsum(counts, 0) - counts).astype(np.int32))

        def scatter(parts: Iterator[tuple[int, int]], index: np.ndarray) -> None:
            index = wp.array(index, dtype=int, device="cpu")
            for start, size in parts:
                wp.launch(scatter_kernel, size, [own, cells, listed, start, index, order], device="cpu")

        self._share(count, scatter, firsts)
        return np.split(to_numpy(order), ends[:-1])

    def _listed(self, numbers: np.ndarray | None) -> tuple[wp.array, int]:
        if numbers is None:
            return wp.empty(0, dtype=int, device="cpu"), self.count
        return wp.array(numbers, dtype=int, device="cpu", copy=False), len(numbers)

    def _share(self, count: int, work: Callable, *more: Iterator) -> list:
        """`work` for runs of slices (start, size) of 0..count, each run in a thread; its results in order."""
        slices = -(-count // _SLICE)
        ends = np.linspace(0, slices, min(self.threads, slices) + 1).astype(int) * _SLICE

        def parts(first: int, end: int) -> Iterator[tuple[int, int]]:
            for start in range(first, end, _SLICE):
                check_cancelled(self.cancelled)
                yield start, min(_SLICE, end - start)

        runs = [parts(int(a), min(int(b), count)) for a, b in itertools.pairwise(ends)]
        if len(runs) == 1:
            return [work(runs[0], *(next(each) for each in more))]
        with ThreadPoolExecutor(len(runs)) as pool:
            return list(pool.map(work, runs, *more))


@dataclass
class CudaTriangles:
    """`Triangles` of a device that does all at once, in slices; on the CPU for tests."""

    device: wp.Device
    mesh: MeshTriangles
    count: int
    cancelled: Callable[[], bool]
    _held: np.ndarray | None = None

    def bounds(self, numbers: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        found = []
        for listed, start, size in self._slices(numbers):
            lanes = min(_LANES, size)
            rows = wp.empty((lanes, 2), dtype=wp.vec3, device=self.device)
            wp.launch(middle_bounds_kernel, lanes, [self.mesh, listed, start, size, lanes, rows], device=self.device)
            found.append(to_numpy(rows))
        return np.min([rows[:, 0].min(0) for rows in found], 0), np.max([rows[:, 1].max(0) for rows in found], 0)

    def held(self, numbers: np.ndarray | None, grid: CellGrid) -> np.ndarray:
        none = wp.empty(0, dtype=int, device=self.device)
        held = wp.zeros(_cell_count(grid) + 1, dtype=int, device=self.device)
        for listed, start, size in self._slices(numbers):
            wp.launch(cells_kernel, size, [self.mesh, grid, listed, start, none, held], device=self.device)
        self._held = to_numpy(held).astype(np.int64)
        return self._held

    def with_labels(
        self, numbers: np.ndarray | None, grid: CellGrid, labels: np.ndarray, label_count: int
    ) -> list[np.ndarray]:
        device, size_max = self.device, min(_SLICE_CUDA, self.count if numbers is None else len(numbers))
        own = wp.array(labels, dtype=int, device=device)
        keys, order = (wp.empty(2 * size_max, dtype=int, device=device) for _ in range(2))
        on_host = locked_empty(size_max, wp.int32) if device.is_cuda else wp.empty(size_max, dtype=int, device=device)
        counts = np.bincount(labels, self._held, label_count).astype(np.int64)
        ends = np.cumsum(counts)
        out, place = np.empty(ends[-1], np.int32), ends - counts
        with ThreadPoolExecutor(worker_count(wp.get_device("cpu"), 0)) as pool:
            for listed, start, size in self._slices(numbers):
                wp.launch(labels_kernel, size, [self.mesh, grid, own, listed, start, keys, order], device=device)
                wp.utils.radix_sort_pairs(keys, order, size, 0, max(label_count - 1, 1).bit_length())
                first = wp.full(label_count, -1, dtype=int, device=device)
                wp.launch(run_first_kernel, size, [keys, first], device=device)
                wp.copy(on_host, order, count=size)
                starts = to_numpy(first)
                there = np.flatnonzero(starts >= 0)
                parts = np.split(to_numpy(on_host)[:size], starts[there][1:])
                targets = [out[place[label] : place[label] + len(part)] for label, part in zip(there, parts)]
                list(pool.map(np.copyto, targets, parts))
                place[there] += [len(part) for part in parts]
        return np.split(out, ends[:-1])

    def _slices(self, numbers: np.ndarray | None) -> Iterator[tuple[wp.array, int, int]]:
        """Slices: numbers on the device, or none; first triangle or number; how many."""
        count = self.count if numbers is None else len(numbers)
        none = wp.empty(0, dtype=int, device=self.device)
        for first in range(0, count, _SLICE_CUDA):
            check_cancelled(self.cancelled)
            size = min(_SLICE_CUDA, count - first)
            if numbers is None:
                yield none, first, size
            else:
                yield wp.array(numbers[first : first + size], dtype=int, device=self.device), 0, size


def _cell_count(grid: CellGrid) -> int:
    return grid.shape[0] * grid.shape[1] * grid.shape[2]


def partition_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """What `triangles_on` launches on `device`."""
    if device.is_cuda:
        return middle_bounds_kernel, cells_kernel, labels_kernel, run_first_kernel
    return middle_bounds_kernel, cells_kernel, count_labels_kernel, scatter_kernel
