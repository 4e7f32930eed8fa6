"""The chunks of a mesh built, each a mesh tree by itself, whose triangles have their numbers in the whole mesh.

On the CPU several chunks are built at a time. A CUDA device builds one after another, from the corners of the chunk's
triangles alone, which it reads where they lie; where trees are cut, threads do that meanwhile.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import warp as wp

from ...device.devices import worker_count
from ...errors import check_cancelled
from ...native.structs import to_numpy
from ..build.binary import BuildOptions
from ..build.collapse import collapse_mesh, collapse_quantised_kernel, fill_quantised_kernel
from ..build.cpu.build import build_binary
from ..build.encode import place_groups_kernel, place_triangles_kernel
from ..build.scene_tree import build_kernels
from ..memory import COPY_BYTES
from ..node import TRIANGLES_MAX_QUANTISED, Layout, triangle_faces
from ..treelets.cut import Cut, CutRule, cut_nodes
from .chunk import Chunk, TreeFacts
from .cuda.chunks import ChunkTree, build_chunk, in_treelets, one_treelet, own_in_place
from .divide.cells import MeshTriangles
from .divide.listed import Triangles, triangles_on
from .divide.partition import partition_triangles
from .divide.primitives import OwnPrimitives

# Chunks that are built at a time on the CPU, and whose trees are cut while a CUDA device builds the next
_BUILT_AHEAD, _CUT_AHEAD = 4, 2
# Bytes of a chunk's tree for each triangle, a little more than it takes mostly: chunks that come out larger are divided
# (measured: 49 and 55 for closed meshes)
CHUNK_BYTES_EACH = {Layout.BOXES: 54, Layout.QUANTISED: 58}

# As many more triangles are listed mostly where they are split
_SPLIT_SHARE = 1.25


def chunk_size(layout: Layout, page_bytes: int, spatial_splits: bool, steps: int = 1) -> int:
    """Most triangles, of so many `steps`, of a chunk whose treelets should take at most `page_bytes`."""
    bytes_each = CHUNK_BYTES_EACH[layout] + (steps - 1) * COPY_BYTES[layout]
    return max(int(page_bytes / bytes_each / (_SPLIT_SHARE if spatial_splits else 1)), 1)


# What builds trees of chunks on a CPU, beside `build_kernels`
CHUNK_TREE_KERNELS = (collapse_quantised_kernel, fill_quantised_kernel, place_groups_kernel, place_triangles_kernel)


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
            for kernel in [*build_kernels(cpu), *CHUNK_TREE_KERNELS]:
                kernel.module.load(cpu, 1)
        self.where = device if self.on_device else cpu  # what divides meshes
        self._threads = worker_count(cpu, 0)
        self._cancelled = cancelled
        self._numbers: wp.array | None = None  # 0, 1, 2; 3, 4, 5; ...: corners that no triangles share

    @property
    def choices(self) -> tuple:
        """Everything that the trees of chunks depend on beside their triangles, the rule and the size of a page."""
        return self.on_device, self._options, self.size_max

    def build(
        self,
        mesh: MeshTriangles,
        positions: np.ndarray,
        triangles: np.ndarray,
        own: OwnPrimitives | None = None,
        own_mesh: MeshTriangles | None = None,
    ) -> Iterator[Chunk]:
        """The chunks of a mesh, one after another.

        Args:
            mesh: on `where`.
            positions: float32 [v, 3], finite.
            triangles: int32 [n, 3], those of the mesh, indices into them.
            own: what comes into the leaves where the others stand in.
            own_mesh: the same on `where`, at the first step.

        Raises as `build_binary` and `build_mesh`, and `BuildCancelledError`.
        """
        listed = triangles_on(self.where, mesh, len(triangles), cancelled=self._cancelled)
        source = _Source(mesh, listed, positions, triangles, own, own_mesh)
        faces = partition_triangles(listed, self._size_max(own.steps) if own else self.size_max)
        with ThreadPoolExecutor(min(self._threads, _BUILT_AHEAD)) as pool:
            for chunk in self._built(pool, source, faces):
                yield from self._fitting(pool, source, chunk)

    def _size_max(self, steps: int) -> int:
        return chunk_size(self.layout, self._page_bytes, self._options.spatial_splits, steps)

    def _fitting(self, pool: ThreadPoolExecutor, source: _Source, chunk: Chunk) -> Iterator[Chunk]:
        """`chunk`, or what it is divided into where it is too large for a page."""
        count = len(chunk.faces)
        if count == 1 or sum(int(sizes.sum()) for sizes in chunk.treelet_bytes(self.layout)) <= self._page_bytes:
            yield chunk
            return
        faces = chunk.faces
        del chunk
        for part in self._built(pool, source, partition_triangles(source.listed, -(-count // 2), faces)):
            yield from self._fitting(pool, source, part)

    def _built(self, pool: ThreadPoolExecutor, source: _Source, chunks: Iterable[np.ndarray]) -> Iterator[Chunk]:
        if not self.on_device:
            yield from _in_order(pool, _BUILT_AHEAD, lambda faces: self._build_on_host(source, faces), chunks)
            return
        trees = (self._build_on_device(source, faces) for faces in chunks)
        if self._rule.cuts_nothing:
            yield from map(one_treelet, trees)
            return
        cut = _in_order(
            pool, _CUT_AHEAD, lambda tree: (tree, self._cut(to_numpy(tree.nodes), len(tree.faces), tree.steps)), trees
        )
        yield from (in_treelets(tree, cut) for tree, cut in cut)

    def _build_on_device(self, source: _Source, faces: np.ndarray) -> ChunkTree:
        check_cancelled(self._cancelled)
        count = len(faces)
        if self._numbers is None or self._numbers.size < count:
            self._numbers = wp.array(
                np.arange(3 * count, dtype=np.int32).reshape(-1, 3), dtype=wp.vec3i, device=self._device
            )
        tree = build_chunk(source.mesh, faces, self._numbers)
        return own_in_place(tree, source.own_mesh, source.own.shifts) if source.own else tree

    def _build_on_host(self, source: _Source, faces: np.ndarray) -> Chunk:
        check_cancelled(self._cancelled)
        own = source.triangles[faces]
        binary = build_binary(source.positions, own, self._options)
        check_cancelled(self._cancelled)
        wide = collapse_mesh(binary, source.positions, own, self.layout)
        del binary
        facts = TreeFacts(wide.centre, wide.box, wide.sah, wide.depth)
        return self._finished(source.own, faces, wide.nodes, wide.triangles, facts)

    def _finished(
        self,
        primitives: OwnPrimitives | None,
        faces: np.ndarray,
        nodes: np.ndarray,
        triangles: np.ndarray,
        facts: TreeFacts,
    ) -> Chunk:
        """The chunk of a tree that calls its triangles 0, 1, ...; `primitives` come in their place."""
        check_cancelled(self._cancelled)
        vertices, steps = None, primitives.steps if primitives else 1
        if primitives:
            triangles, vertices = primitives.placed(self.layout, triangles, faces)
        listed = triangle_faces(self.layout, triangles)
        listed[:] = np.where(listed >= 0, faces[listed], -1)
        cut = self._cut(nodes, len(faces), steps)
        if not np.array_equal(cut.triangle_order, np.arange(len(triangles))):
            triangles = triangles[cut.triangle_order]
            vertices = None if vertices is None else vertices[cut.triangle_order]
        return Chunk(
            faces=faces,
            facts=facts,
            levels=cut.levels,
            top_nodes=cut.top_nodes,
            top_treelet=cut.top_treelet,
            treelet_root=cut.treelet_root,
            top_triangles=triangles[: cut.top_triangle_count],
            nodes=cut.nodes,
            node_first=cut.node_first,
            triangles=triangles[cut.top_triangle_count :],
            triangle_first=cut.triangle_first - cut.top_triangle_count,
            vertices=None if vertices is None else vertices[cut.top_triangle_count :],
        )

    def _cut(self, nodes: np.ndarray, triangle_count: int, steps: int) -> Cut:
        """The tree over so many triangles of the scene, cut."""
        rule = self._rule
        if rule.top_bytes_max:
            rule = replace(rule, top_bytes_max=max(int(self._top_bytes_each * triangle_count), 1))
        words = nodes.view(self.layout.node_type).reshape(-1, self.layout.node_words)
        return cut_nodes(self.layout, words, rule, steps)


class _Source(NamedTuple):
    """A mesh that is divided."""

    mesh: MeshTriangles
    listed: Triangles
    positions: np.ndarray
    triangles: np.ndarray
    own: OwnPrimitives | None
    own_mesh: MeshTriangles | None


def _in_order(pool: ThreadPoolExecutor, ahead: int, work: Callable, items: Iterable) -> Iterator:
    """Results of `work` in the order of `items`, `ahead` at a time under way."""
    waiting: deque[Future] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            del item
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
