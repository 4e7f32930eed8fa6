"""The chunks of a mesh built, each a mesh tree by itself, whose triangles have their numbers in the whole mesh.

On the CPU several chunks are built at a time. A CUDA device builds one after another, from the corners of the chunk's
triangles alone, while threads get the next ones ready and finish the last: never is more than one chunk's tree on the
device.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from ...device.devices import worker_count
from ...errors import check_cancelled
from ..build.binary import BuildOptions
from ..build.collapse import collapse_mesh, collapse_quantised_kernel, fill_quantised_kernel
from ..build.cpu.build import build_binary
from ..build.cuda.build import build_mesh
from ..build.encode import place_triangles_kernel
from ..build.scene_tree import build_kernels
from ..node import TRIANGLES_MAX_QUANTISED, Layout, triangle_faces
from ..treelets.cut import CutRule, cut_nodes
from .partition import partition_triangles

# Chunks that are got ready before their turn; as many are finished behind it
_AHEAD = 4
# Bytes of a chunk's tree for each triangle, a little more than it takes mostly: chunks that come out larger are divided
# (measured: 49 and 55 for closed meshes)
CHUNK_BYTES_EACH = {Layout.BOXES: 54, Layout.QUANTISED: 58}

# As many more triangles are listed mostly where they are split
_SPLIT_SHARE = 1.25


@dataclass(frozen=True)
class Chunk:
    """The tree of some triangles of a mesh, cut into treelets (as `treelets.Cut`); units are triangles, or groups of
    them (BOXES).
    """

    faces: np.ndarray  # the triangles, numbers in the mesh, int32, rising
    centre: np.ndarray  # as `MeshTree`
    box: np.ndarray
    sah: float
    depth: int
    levels: int  # of top nodes
    top_nodes: np.ndarray  # words, shape [n, words]
    top_treelet: np.ndarray  # int32, shape [n]
    treelet_root: np.ndarray  # int32, shape [T]
    top_triangles: np.ndarray  # words of the units at opened nodes, shape [u, words]
    nodes: list[np.ndarray]  # words of each treelet's nodes
    triangles: list[np.ndarray]  # words of each treelet's units

    @property
    def page_bytes(self) -> int:
        """Bytes of the treelets' blocks."""
        return sum(block.nbytes for block in (*self.nodes, *self.triangles))


def chunk_size(layout: Layout, page_bytes: int, spatial_splits: bool) -> int:
    """Most triangles of a chunk whose treelets should take at most `page_bytes`."""
    return max(int(page_bytes / CHUNK_BYTES_EACH[layout] / (_SPLIT_SHARE if spatial_splits else 1)), 1)


class ChunkBuilder:
    """Builds the chunks of meshes."""

    def __init__(
        self,
        layout: Layout,
        device: wp.Device,
        rule: CutRule,
        triangle_count: int,
        page_bytes: int,
        spatial_splits: bool = False,
        on_device: bool | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ):
        """Chunks whose treelets take at most `page_bytes`, those of single triangles excepted. `on_device` as for
        `MeshTrees`. `cancelled` may be asked on any thread, and ends `build`.

        `rule` cuts the tree of each chunk, but its `top_bytes_max` is shared by all `triangle_count` triangles of the
        scene.
        """
        self.layout, self._device, self._rule, self._page_bytes = layout, device, rule, page_bytes
        self._top_bytes_each = rule.top_bytes_max / max(triangle_count, 1)
        self.on_device = device.is_cuda and not spatial_splits if on_device is None else on_device
        leaves = {"leaf_group": 1, "leaf_max": TRIANGLES_MAX_QUANTISED} if layout is Layout.QUANTISED else {}
        self._options = BuildOptions(**leaves, spatial_splits=spatial_splits)
        self.size_max = chunk_size(layout, page_bytes, spatial_splits)
        cpu = wp.get_device("cpu")
        if not self.on_device:
            # before threads launch them
            kernels = [*build_kernels(cpu), collapse_quantised_kernel, fill_quantised_kernel, place_triangles_kernel]
            for kernel in kernels:
                kernel.module.load(cpu, 1)
        self._threads = worker_count(cpu, 0)
        self._cancelled = cancelled
        self._numbers: wp.array | None = None  # 0, 1, 2; 3, 4, 5; ...: corners that no triangles share

    @property
    def choices(self) -> tuple:
        """Everything that the trees of chunks depend on beside their triangles, the rule and the size of a page."""
        return self.on_device, self._options, self.size_max

    def build(self, positions: np.ndarray, triangles: np.ndarray) -> Iterator[Chunk]:
        """The chunks of a mesh, one after another.

        Args:
            positions: float32 [v, 3], finite.
            triangles: int32 [n, 3], indices into them.

        Raises as `build_binary` and `build_mesh`, and `BuildCancelledError`.
        """
        faces = partition_triangles(positions, triangles, self.size_max, cancelled=self._cancelled)
        with ThreadPoolExecutor(min(self._threads, _AHEAD)) as pool:
            for chunk in self._built(pool, positions, triangles, faces):
                yield from self._fitting(pool, positions, triangles, chunk)

    def _fitting(
        self, pool: ThreadPoolExecutor, positions: np.ndarray, triangles: np.ndarray, chunk: Chunk
    ) -> Iterator[Chunk]:
        """`chunk`, or what it is divided into where it is too large for a page."""
        count = len(chunk.faces)
        if chunk.page_bytes <= self._page_bytes or count == 1:
            yield chunk
            return
        faces = chunk.faces
        del chunk
        parts = partition_triangles(positions, triangles[faces], -(-count // 2), cancelled=self._cancelled)
        for part in self._built(pool, positions, triangles, [faces[part] for part in parts]):
            yield from self._fitting(pool, positions, triangles, part)

    def _built(
        self, pool: ThreadPoolExecutor, positions: np.ndarray, triangles: np.ndarray, chunks: Iterable[np.ndarray]
    ) -> Iterator[Chunk]:
        if not self.on_device:
            yield from _in_order(pool, lambda faces: self._build_on_host(positions, triangles, faces), chunks)
            return
        ready = _in_order(pool, lambda faces: (faces, positions.take(triangles[faces].ravel(), axis=0)), chunks)
        yield from _in_order(pool, lambda made: self._finished(*made), (self._build_on_device(*each) for each in ready))

    def _build_on_host(self, positions: np.ndarray, triangles: np.ndarray, faces: np.ndarray) -> Chunk:
        check_cancelled(self._cancelled)
        own = triangles[faces]
        binary = build_binary(positions, own, self._options)
        check_cancelled(self._cancelled)
        wide = collapse_mesh(binary, positions, own, self.layout)
        del binary
        return self._finished(
            faces,
            wide.nodes,
            wide.triangles,
            {"centre": wide.centre, "box": wide.box, "sah": wide.sah, "depth": wide.depth},
        )

    def _build_on_device(
        self, faces: np.ndarray, corners: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        check_cancelled(self._cancelled)
        count = len(faces)
        positions = wp.array(corners, dtype=wp.vec3, device=self._device)
        if self._numbers is None or self._numbers.size < count:
            self._numbers = wp.array(
                np.arange(3 * count, dtype=np.int32).reshape(-1, 3), dtype=wp.vec3i, device=self._device
            )
        made = build_mesh(positions, self._numbers, 0, count)
        nodes = made.nodes.numpy().view(self.layout.node_type).reshape(-1, self.layout.node_words)
        blocks = made.triangles.numpy().reshape(-1, self.layout.triangle_words)
        return faces, nodes, blocks, {"centre": made.centre, "box": made.box, "sah": made.sah, "depth": made.depth}

    def _finished(self, faces: np.ndarray, nodes: np.ndarray, triangles: np.ndarray, known: dict[str, Any]) -> Chunk:
        """The chunk of a tree that calls its triangles 0, 1, ..."""
        check_cancelled(self._cancelled)
        listed = triangle_faces(self.layout, triangles)
        listed[:] = np.where(listed >= 0, faces[listed], -1)
        rule = self._rule
        if rule.top_bytes_max:
            rule = replace(rule, top_bytes_max=max(int(self._top_bytes_each * len(faces)), 1))
        cut = cut_nodes(self.layout, nodes, rule)
        if not np.array_equal(cut.triangle_order, np.arange(len(triangles))):
            triangles = triangles[cut.triangle_order]
        ends = cut.triangle_first
        return Chunk(
            faces=faces,
            **known,
            levels=cut.levels,
            top_nodes=cut.top_nodes,
            top_treelet=cut.top_treelet,
            treelet_root=cut.treelet_root,
            top_triangles=triangles[: ends[0]],
            nodes=[cut.nodes[a:b] for a, b in zip(cut.node_first[:-1], cut.node_first[1:])],
            triangles=[triangles[a:b] for a, b in itertools.pairwise(ends)],
        )


def _in_order(pool: ThreadPoolExecutor, work: Callable, items: Iterable) -> Iterator:
    """Results of `work` in the order of `items`, a few at a time under way."""
    waiting: deque[Future] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            del item
            if len(waiting) > _AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
