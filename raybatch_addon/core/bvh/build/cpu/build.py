"""The CPU builder: binned SAH, parallel, the same tree for any number of threads.

Large nodes are split one level of the tree after the other, all threads at once: references are cut into chunks whose
size depends on the mesh alone; chunks are binned each by itself, merged in order, and copied to where they belong in
a second buffer (count, exclusive scan, scatter). What falls below the size of a chunk is a subtree, built by one thread
alone in its own part of all arrays; subtrees are joined in order. Threads launch kernels of one thread, which run
without Python's lock.

Positions are assumed finite and indices valid: scenes are checked before (`scene/validate.py`).
"""

from __future__ import annotations

import dataclasses
import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from ....device.devices import free_memory, worker_count
from ....errors import OutOfMemoryError
from ..binary import BinaryTree, BuildOptions, BuildStatistics, expected_visits
from .stages import BINS, INDEX_BIAS, JOB, SPATIAL_BINS, TASK, BuildArrays, BuildNumbers, Split, Stage, build_kernel

# Records of a chunk, and of the largest subtree: this, or a share of all for large meshes
CHUNK_MIN = 1 << 13
CHUNKS = 64
# Two builds at once must not load the kernel twice, nor launch it half loaded
_load_lock = threading.Lock()


def build_binary(positions: np.ndarray, triangles: np.ndarray, options: BuildOptions = BuildOptions()) -> BinaryTree:
    """The tree over the triangles of a mesh: `positions` float32 [v, 3], finite, `triangles` int32 [m, 3], indices into
    them.

    Raises `SceneError` for more triangles than a tree can hold, `OutOfMemoryError` where the build does not fit.
    """
    start = time.perf_counter()
    positions = np.ascontiguousarray(positions, np.float32).reshape(-1, 3)
    triangles = np.ascontiguousarray(triangles, np.int32).reshape(-1, 3)
    if len(triangles) == 0:
        return _empty_tree(start)
    with _Build(len(triangles), options) as build:
        build.arrays.positions = _device_array(positions, float)
        build.arrays.triangles = _device_array(triangles, int)
        jobs = build.jobs(np.zeros(1, np.int64), np.array([len(triangles)]))
        build.run(Stage.RECORDS, _no_tasks(), jobs, len(jobs))
        bounds = jobs["bounds"].max(0)
        return build.tree(bounds[0], bounds[1], start)


def build_binary_from_boxes(low: np.ndarray, high: np.ndarray, options: BuildOptions = BuildOptions()) -> BinaryTree:
    """The tree over boxes with corners `low` and `high`, float32 [n, 3], finite, low <= high; boxes are never split."""
    start = time.perf_counter()
    if len(low) == 0:
        return _empty_tree(start)
    with _Build(len(low), dataclasses.replace(options, spatial_splits=False)) as build:
        records = build.records
        records[:, :3] = 0 - np.asarray(low, np.float32)
        records[:, 4:7] = np.asarray(high, np.float32) + 0
        records[:, 7] = 0
        records.view(np.int32)[:, 3] = np.arange(len(low), dtype=np.int32) + INDEX_BIAS
        middle = records[:, 4:7] - records[:, :3]
        middles = np.zeros(8, np.float32)
        middles[:3], middles[4:7] = (-middle).max(0), middle.max(0)
        return build.tree(records.max(0), middles, start)


class _Build:
    """The arrays and threads of one build."""

    def __init__(self, count: int, options: BuildOptions) -> None:
        self.count, self.options = count, options
        self.capacity = options.capacity(count)
        self.chunk = max(CHUNK_MIN, -(-count // CHUNKS))
        self.threads = worker_count(wp.get_device("cpu"), options.thread_count)
        self.memory = 0
        self._check_memory()
        self.records = self._allocate((self.capacity, 8), np.float32)
        self.arrays = BuildArrays()
        self.arrays.records_0 = _device_array(self.records, float)
        self.arrays.records_1 = _device_array(self._allocate((self.capacity, 8), np.float32), float)
        self.arrays.nodes = _device_array(self._allocate((2 * self.capacity, 8), np.float32), float)
        self.arrays.references = _device_array(self._allocate((self.capacity,), np.int32), int)
        self.numbers = BuildNumbers()
        self.numbers.leaf_group, self.numbers.leaf_max = options.leaf_group, options.leaf_max
        self.numbers.traversal_cost = options.step_cost
        self.numbers.group_inverse = float(np.nextafter(np.float32(1 / options.leaf_group), np.float32(2)))
        self.numbers.split_overlap = options.split_overlap
        with _load_lock:
            build_kernel.module.load(wp.get_device("cpu"), 1)
        large = self.threads > 1 and count > self.chunk
        self.pool = ThreadPoolExecutor(self.threads) if large else None

    def __enter__(self) -> _Build:
        return self

    def __exit__(self, *_) -> None:
        if self.pool is not None:
            self.pool.shutdown(cancel_futures=True)

    def _check_memory(self) -> None:
        """Memory is handed out before it exists: a build that cannot fit is refused here."""
        # two records, two lists, and nodes of half-full leaves twice
        needed = int(self.capacity * (64 + 8 + 2 * 64 / (self.options.leaf_max / 2 + 0.5)))
        free = free_memory(wp.get_device("cpu"))
        if needed > free:
            raise OutOfMemoryError(
                f"the tree over {self.count:,} triangles takes about {needed:,} bytes to build and {free:,} are free; "
                "close other programs, "
                "render a smaller scene, or turn spatial splits off"
            )

    def _allocate(self, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        try:
            array = np.empty(shape, dtype)
        except MemoryError as error:
            size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
            raise OutOfMemoryError(
                f"the tree over {self.count:,} triangles could not get {size:,} bytes beside {self.memory:,} that it "
                "has; close other "
                "programs, or render a smaller scene"
            ) from error
        self.memory += array.nbytes
        return array

    def jobs(self, first: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Chunks of the ranges `first`, `count`, in order; their `task` is the range."""
        chunks = -(-count // self.chunk)
        jobs = np.zeros(int(chunks.sum()), JOB)
        jobs["task"] = np.repeat(np.arange(len(first)), chunks)
        offset = (np.arange(len(jobs)) - np.repeat(np.cumsum(chunks) - chunks, chunks)) * self.chunk
        jobs["first"] = first[jobs["task"]] + offset
        jobs["count"] = np.minimum(count[jobs["task"]] - offset, self.chunk)
        return jobs

    def run(
        self, stage: Stage, tasks: np.ndarray, jobs: np.ndarray, count: int, order: np.ndarray | None = None
    ) -> None:
        """Do `stage` for the `count` jobs or tasks that it is about: in slices, or one by one in `order`."""
        inputs = [
            self.arrays,
            self.numbers,
            _device_array(_as_bytes(tasks), wp.uint8),
            _device_array(_as_bytes(jobs), wp.uint8),
            int(stage),
        ]

        def launch(part: tuple[int, int]) -> None:
            wp.launch(build_kernel, dim=1, inputs=[*inputs, *part], device="cpu", block_dim=1)

        if self.pool is None:
            launch((0, count))
            return
        if order is None:
            ends = np.linspace(0, count, min(count, 4 * self.threads) + 1).astype(int).tolist()
            parts = list(itertools.pairwise(ends))
        else:
            parts = [(i, i + 1) for i in order.tolist()]
        list(self.pool.map(launch, parts))

    def tree(self, box: np.ndarray, middles: np.ndarray, start: float) -> BinaryTree:
        """The tree over `records`, whose bounds are these; `start` is when the build began."""
        x, y, z = box[4:7].astype(np.float64) + box[:3]
        self.numbers.root_area = x * y + y * z + z * x
        frontier = np.zeros(1, TASK)
        frontier["count"], frontier["capacity"], frontier["box"], frontier["middle"] = (
            self.count,
            self.capacity,
            box,
            middles,
        )
        node_count = 1
        above: list[np.ndarray] = []  # tasks that were split here, by level
        below: list[np.ndarray] = []  # subtrees
        while len(frontier):
            large = frontier["count"] > self.chunk
            below.append(frontier[~large])
            tasks = frontier[large]
            if len(tasks) == 0:
                break
            frontier = self._split(tasks)
            frontier["node"] = node_count + np.arange(len(frontier))
            tasks["node_first"] = frontier["node"][::2]
            above.append(tasks)
            node_count += len(frontier)
        subtrees = np.concatenate(below)
        self.run(Stage.SUBTREE, subtrees, _no_jobs(), len(subtrees), np.argsort(-subtrees["count"], kind="stable"))
        return self._joined(np.concatenate([np.zeros(0, TASK), *above]), subtrees, node_count, start)

    def _split(self, tasks: np.ndarray) -> np.ndarray:
        """The children of `tasks`, left and right in turn."""
        jobs, first = self._job_table(tasks, BINS.itemsize)
        self.run(Stage.BIN, tasks, jobs, len(jobs))
        self.run(Stage.CHOOSE, tasks, jobs, len(tasks))
        if tasks["spatial"].any():
            self._try_spatial(tasks, jobs)
        left, right = tasks["left_count"], tasks["right_count"]
        children = np.zeros(2 * len(tasks), TASK)
        slack = tasks["capacity"] - left - right
        a, b = children[::2], children[1::2]
        a["first"], a["count"], a["capacity"] = tasks["first"], left, left + slack * left // (left + right)
        b["first"], b["count"], b["capacity"] = tasks["first"] + a["capacity"], right, tasks["capacity"] - a["capacity"]
        for child, side, count in ((a, "left", "left_count"), (b, "right", "right_count")):
            scan = np.cumsum(jobs[count]) - jobs[count]
            jobs[side] = (child["first"] - scan[first])[jobs["task"]] + scan
            child["depth"], child["buffer"] = tasks["depth"] + 1, 1 - tasks["buffer"]
        self.run(Stage.PARTITION, tasks, jobs, len(jobs))
        bounds = np.maximum.reduceat(jobs["bounds"], first, axis=0)
        a["box"], a["middle"], b["box"], b["middle"] = bounds[:, 0], bounds[:, 1], bounds[:, 2], bounds[:, 3]
        return children

    def _job_table(self, tasks: np.ndarray, bins_bytes: int) -> tuple[np.ndarray, np.ndarray]:
        """Jobs of `tasks`, with room for the bins of each, and the first job of each task."""
        jobs = self.jobs(tasks["first"], tasks["count"])
        first = np.flatnonzero(np.diff(jobs["task"], prepend=-1))
        tasks["job_first"], tasks["job_end"] = first, np.append(first[1:], len(jobs))
        self.arrays.bins = _device_array(np.empty(len(jobs) * bins_bytes // 4, np.float32), float)
        return jobs, first

    def _try_spatial(self, tasks: np.ndarray, jobs: np.ndarray) -> None:
        """Spatial splits instead of those chosen, for the tasks where they cost less."""
        tried = np.flatnonzero(tasks["spatial"])
        trial = tasks[tried]
        trial_jobs, first = self._job_table(trial, SPATIAL_BINS.itemsize)
        self.run(Stage.SPATIAL_BIN, trial, trial_jobs, len(trial_jobs))
        self.run(Stage.SPATIAL_CHOOSE, trial, trial_jobs, len(trial))
        self.run(Stage.SPATIAL_COUNT, trial, trial_jobs, len(trial_jobs))
        left, right = (np.add.reduceat(trial_jobs[name], first) for name in ("left_count", "right_count"))
        better = (trial["kind"] == Split.SPATIAL) & (left > 0) & (right > 0) & (left + right <= trial["capacity"])
        trial["left_count"], trial["right_count"] = left, right
        trial["job_first"], trial["job_end"] = tasks["job_first"][tried], tasks["job_end"][tried]
        tasks[tried[better]] = trial[better]
        changed = np.isin(jobs["task"], tried[better])
        for name in ("left_count", "right_count"):
            jobs[name][changed] = trial_jobs[name][better[trial_jobs["task"]]]

    def _joined(self, above: np.ndarray, subtrees: np.ndarray, node_count: int, start: float) -> BinaryTree:
        """One tree of the nodes above and the subtrees, whose roots are already numbered among them."""
        inner = subtrees["node_count"] - 1
        subtrees["node_first"] = node_count + np.cumsum(inner) - inner
        subtrees["reference_first"] = np.cumsum(subtrees["reference_count"]) - subtrees["reference_count"]
        nodes = self._allocate((node_count + int(inner.sum()), 8), np.float32)
        references = self._allocate((int(subtrees["reference_count"].sum()),), np.int32)
        bits = nodes.view(np.int32)
        nodes[above["node"], :3] = 0 - above["box"][:, :3]
        nodes[above["node"], 4:7] = above["box"][:, 4:7]
        bits[above["node"], 3], bits[above["node"], 7] = above["node_first"], 0
        self.arrays.tree_nodes, self.arrays.tree_references = (
            _device_array(nodes, float),
            _device_array(references, int),
        )
        self.run(Stage.GATHER, subtrees, _no_jobs(), len(subtrees))
        steps, groups = expected_visits(nodes, self.options.leaf_group)
        statistics = BuildStatistics(
            triangle_count=self.count,
            node_count=len(nodes),
            leaf_count=int(subtrees["leaf_count"].sum()),
            reference_count=len(references),
            duplicate_count=len(references) - self.count,
            depth=int(subtrees["depth_max"].max()),
            leaf_largest=int(subtrees["leaf_largest"].max()),
            node_steps=steps,
            group_tests=groups,
            sah_cost=steps * self.options.step_cost + groups,
            seconds=time.perf_counter() - start,
            memory_peak=self.memory,
        )
        return BinaryTree(nodes, references, statistics)


def _empty_tree(start: float) -> BinaryTree:
    statistics = BuildStatistics(
        triangle_count=0,
        node_count=0,
        leaf_count=0,
        reference_count=0,
        duplicate_count=0,
        depth=0,
        leaf_largest=0,
        node_steps=0.0,
        group_tests=0.0,
        sah_cost=0.0,
        seconds=time.perf_counter() - start,
        memory_peak=0,
    )
    return BinaryTree(np.zeros((0, 8), np.float32), np.zeros(0, np.int32), statistics)


def _no_tasks() -> np.ndarray:
    return np.zeros(0, TASK)


def _no_jobs() -> np.ndarray:
    return np.zeros(0, JOB)


def _as_bytes(table: np.ndarray) -> np.ndarray:
    return table.view(np.uint8).reshape(-1)


def _device_array(array: np.ndarray, dtype: type) -> wp.array:
    """`array` as Warp sees it, not copied."""
    return wp.array(array, dtype=dtype, device="cpu", copy=False)
