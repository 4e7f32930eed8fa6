"""The tables of a scene's pages: where treelets lie in them, and what stays on the device. Built once, kept
with the pages.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from ...device.devices import worker_count
from ..node import Layout, triangle_faces
from .chunks import Chunk
from .encode import encode_triangles
from .entries import ChunkInstances
from .file import PageFileWriter
from .store import HostStore, padded, page_buffer

# Pages that are packed and written while the next chunks are built
_AHEAD = 4


@dataclass(frozen=True)
class PageTables:
    """Arrays that describe the pages of a scene. A page has a segment of nodes, then one of triangles
    (`store.py`).
    """

    chunk_first: np.ndarray  # first chunk of each mesh part, then the count, int64
    chunk_node: np.ndarray  # first top node of each chunk, then their count, int64
    chunk_triangle: np.ndarray  # likewise of the units (triangles, or groups of them) at top nodes
    chunk_treelet: np.ndarray  # likewise of its treelets
    chunk_size: np.ndarray  # triangles, int64, shape [C]
    chunk_centre: np.ndarray  # float32, shape [C, 3]
    chunk_box: np.ndarray  # float32, shape [C, 2, 3]
    chunk_sah: np.ndarray  # float64, shape [C]
    chunk_depth: np.ndarray  # levels of nodes, int64, shape [C]
    chunk_levels: np.ndarray  # levels of top nodes, int64, shape [C]
    baked_first: np.ndarray  # as `ChunkInstances`
    baked_place: np.ndarray
    top_nodes: np.ndarray  # words, shape [n, words]
    top_treelet: np.ndarray  # by top node: the treelet whose root it is, or -1, int32
    treelet_root: np.ndarray  # by treelet: its root among the top nodes, int32
    top_triangles: np.ndarray  # words, shape [u, words]
    treelet_page: np.ndarray  # int32, shape [T]
    treelet_node: np.ndarray  # first byte in the segment of nodes of its page, int64, shape [T]
    treelet_triangle: np.ndarray  # likewise of triangles
    page_treelet: np.ndarray  # first treelet of each page, then their count, int64
    page_byte: np.ndarray  # first byte in the store: of the segments of nodes and of triangles, int64, shape [P, 2]
    page_bytes: np.ndarray  # bytes of these segments, likewise
    page_device: np.ndarray  # bytes of these segments on the device: more for packed triangles (`encode.py`), likewise
    page_units: np.ndarray  # triangles, or groups of them, of each page, int64, shape [P]

    @property
    def baked(self) -> ChunkInstances:
        """Which baked instances have triangles in which chunk."""
        return ChunkInstances(self.baked_first, self.baked_place)

    @staticmethod
    def from_index(index: dict[str, np.ndarray]) -> PageTables:
        """The tables of what `index` gave; raises `KeyError` for what is missing."""
        return PageTables(**{each.name: index[each.name] for each in fields(PageTables)})

    def index(self) -> dict[str, np.ndarray]:
        """The arrays by name, for a file."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


class NoStore:
    """Takes pages and keeps none: for tables alone."""

    def add(self, data: np.ndarray) -> int:
        """The byte at which `data` would begin, in a store that keeps nothing."""
        return 0


class PageBuilder:
    """Puts chunks into pages as they come, and pages into a store; a thread does the copying."""

    def __init__(
        self,
        layout: Layout,
        page_bytes: int,
        target: HostStore | PageFileWriter | NoStore,
        positions: np.ndarray | None,
        plain: HostStore | None = None,
    ):
        """Pages of at most `page_bytes` on the device, but for single chunks that are larger, to `target`.

        With the mesh's `positions`, float32 [v, 3], triangles are packed; `plain`, if given, takes pages as the device
        has them besides.
        """
        self._plain = plain
        self.plain_byte: list[int] = []  # first byte of each page in `plain`
        self._layout, self._page_bytes, self._target, self._positions = layout, page_bytes, target, positions
        self._pool = ThreadPoolExecutor(min(worker_count(wp.get_device("cpu"), 0), _AHEAD))
        self._writer = ThreadPoolExecutor(1)
        self._writing: deque[Future] = deque()
        self._buffer: np.ndarray | None = None
        self._parts: list[int] = [0]
        self._chunks: list[dict] = []
        self._baked: list[np.ndarray] = []
        self._top: dict[str, list[np.ndarray]] = {"nodes": [], "treelet": [], "root": [], "triangles": []}
        self._treelets: list[np.ndarray] = []  # page, first byte of nodes, of triangles
        self._pages: list[tuple] = []  # what is known of those that are written
        self._page_count = 0
        self._blocks: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])  # of the page in hand
        self._corners: list[tuple[int, np.ndarray]] = []  # likewise: so many triangles, of this mesh
        self._sizes = [0, 0]
        self._treelet_count = self._node_count = 0

    def __enter__(self) -> PageBuilder:
        return self

    def __exit__(self, *_) -> None:
        self._writer.shutdown(cancel_futures=True)
        self._pool.shutdown(cancel_futures=True)

    def add(self, chunk: Chunk, instances: np.ndarray, triangles: np.ndarray) -> None:
        """Append a chunk; `instances` are those of `ChunkInstances`, `triangles` those of the mesh, int32 [n, 3]."""
        blocks = (chunk.nodes, chunk.triangles)
        sizes = [np.array([block.nbytes for block in each], np.int64) for each in blocks]
        if self._blocks[1] and sum(padded(self._sizes[k] + int(sizes[k].sum())) for k in range(2)) > self._page_bytes:
            self._flush()
        starts = [self._sizes[k] + np.cumsum(sizes[k]) - sizes[k] for k in range(2)]
        self._treelets.append(np.stack([np.full(len(sizes[0]), self._page_count), *starts]))
        self._top["nodes"].append(chunk.top_nodes)
        self._top["treelet"].append(
            np.where(chunk.top_treelet < 0, -1, chunk.top_treelet + self._treelet_count).astype(np.int32)
        )
        self._top["root"].append((chunk.treelet_root + self._node_count).astype(np.int32))
        self._top["triangles"].append(chunk.top_triangles.copy())  # not all that it is a part of
        for k in range(2):
            self._blocks[k].extend(blocks[k])
            self._sizes[k] += int(sizes[k].sum())
        self._corners.append((sum(len(block) for block in chunk.triangles), triangles))
        self._treelet_count += len(chunk.nodes)
        self._node_count += len(chunk.top_nodes)
        self._baked.append(instances)
        self._chunks.append(
            {
                "node": len(chunk.top_nodes),
                "triangle": len(chunk.top_triangles),
                "treelet": len(chunk.nodes),
                "size": len(chunk.faces),
                "centre": chunk.centre,
                "box": chunk.box,
                "sah": chunk.sah,
                "depth": chunk.depth,
                "levels": chunk.levels,
            }
        )

    def end_part(self) -> None:
        """Note that no more chunks of this mesh come."""
        self._parts.append(len(self._chunks))

    def finish(self) -> PageTables:
        """Write what is left; raises what writing raised."""
        if self._blocks[1]:
            self._flush()
        self._wait(0)

        def column(name: str) -> np.ndarray:
            return np.array([chunk[name] for chunk in self._chunks])

        def firsts(name: str) -> np.ndarray:
            return np.cumsum([0, *column(name).tolist()], dtype=np.int64)

        def joined(name: str, words: int, dtype: type) -> np.ndarray:
            return np.concatenate([np.zeros((0, words), dtype), *self._top[name]])

        baked = ChunkInstances.of(self._baked)
        treelets = np.concatenate([np.zeros((3, 0), np.int64), *self._treelets], 1)
        pages = np.array(self._pages, np.int64).reshape(-1, 8)
        return PageTables(
            chunk_first=np.array(self._parts, np.int64),
            chunk_node=firsts("node"),
            chunk_triangle=firsts("triangle"),
            chunk_treelet=firsts("treelet"),
            chunk_size=column("size"),
            chunk_centre=column("centre"),
            chunk_box=column("box"),
            chunk_sah=column("sah"),
            chunk_depth=column("depth"),
            chunk_levels=column("levels"),
            baked_first=baked.first,
            baked_place=baked.place,
            top_nodes=joined("nodes", self._layout.node_words, self._layout.node_type),
            top_treelet=np.concatenate([np.zeros(0, np.int32), *self._top["treelet"]]),
            treelet_root=np.concatenate([np.zeros(0, np.int32), *self._top["root"]]),
            top_triangles=joined("triangles", self._layout.triangle_words, np.float32),
            treelet_page=treelets[0].astype(np.int32),
            treelet_node=treelets[1],
            treelet_triangle=treelets[2],
            page_treelet=np.concatenate([[0], pages[:, 0]]),
            page_byte=pages[:, 1:3],
            page_bytes=pages[:, 3:5],
            page_device=pages[:, 5:7],
            page_units=pages[:, 7],
        )

    def _flush(self) -> None:
        """The page in hand to the store."""
        self._wait(_AHEAD - 1)
        page = self._pool.submit(self._segments, self._blocks, self._corners)
        self._writing.append(self._writer.submit(self._write, page, self._treelet_count))
        self._page_count += 1
        self._blocks, self._corners, self._sizes = ([], []), [], [0, 0]

    def _wait(self, left: int) -> None:
        """Wait until no more than `left` pages are on their way."""
        while len(self._writing) > left:
            self._pages.append(self._writing.popleft().result())

    def _segments(
        self, blocks: tuple[list[np.ndarray], list[np.ndarray]], corners: list[tuple[int, np.ndarray]]
    ) -> tuple:
        """Blocks of nodes and of triangles as the store has them, their bytes on the device, and the number of
        units.
        """
        device = [sum(block.nbytes for block in each) for each in blocks]
        units = device[1] // (4 * self._layout.triangle_words)
        if self._positions is None:
            return *blocks, device, units, blocks
        triangles = np.concatenate(blocks[1])
        faces, ends = triangle_faces(self._layout, triangles), np.cumsum([0, *(count for count, _ in corners)])
        vertices = [mesh[faces[a:b]] for (_, mesh), a, b in zip(corners, ends[:-1], ends[1:])]
        return (
            blocks[0],
            [encode_triangles(triangles, np.concatenate(vertices), self._positions)],
            device,
            units,
            blocks,
        )

    def _write(self, page: Future, treelet_end: int) -> tuple:
        nodes, triangles, device, units, plain = page.result()
        blocks = (nodes, triangles)
        if self._plain:
            first, memory = self._plain.add(sum(padded(size) for size in device))
            self.plain_byte.append(first)
            _fill(memory, plain, [padded(size) for size in device])
        sizes = [padded(sum(block.nbytes for block in each)) for each in blocks]
        total = sum(sizes)
        if isinstance(self._target, HostStore):
            first, memory = self._target.add(total)
        else:
            if self._buffer is None or len(self._buffer) < total:
                self._buffer = page_buffer(total).numpy()
            memory = self._buffer[:total]
        _fill(memory, blocks, sizes)
        if not isinstance(self._target, HostStore):
            first = self._target.add(memory[: sizes[0]])
            self._target.add(memory[sizes[0] : total])
        return treelet_end, first, first + sizes[0], *sizes, *(padded(size) for size in device), units


def _fill(memory: np.ndarray, segments: tuple[list[np.ndarray], list[np.ndarray]], sizes: list[int]) -> None:
    """Blocks of each segment into `memory`, uint8, and 0 up to its size [bytes]."""
    end = 0
    for blocks, size in zip(segments, sizes, strict=True):
        byte, end = end, end + size
        for block in blocks:
            memory[byte : byte + block.nbytes] = block.view(np.uint8).reshape(-1)
            byte += block.nbytes
        memory[byte:end] = 0
