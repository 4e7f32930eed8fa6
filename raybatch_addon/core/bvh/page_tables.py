"""What is known of a scene's pages beside the pages: places of treelets, what stays on the device. Built once, kept with the pages."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np

from .node import Layout
from .page_chunks import Chunk
from .page_entries import ChunkInstances
from .page_file import PageFileWriter
from .page_store import HostStore, padded, page_buffer


@dataclass(frozen=True)
class PageTables:
    """Arrays that describe the pages of a scene. A page has a segment of nodes, then one of triangles (`page_store.py`)."""

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

    @property
    def baked(self) -> ChunkInstances:
        """Which baked instances have triangles in which chunk."""
        return ChunkInstances(self.baked_first, self.baked_place)

    @staticmethod
    def from_index(index: dict[str, np.ndarray]) -> PageTables:
        """Of what `index` gives back; raises `KeyError` for what is missing."""
        return PageTables(**{each.name: index[each.name] for each in fields(PageTables)})

    def index(self) -> dict[str, np.ndarray]:
        """The arrays by name, for a file."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


class PageBuilder:
    """Puts chunks into pages as they come, and pages into a store; a thread does the copying."""

    def __init__(self, layout: Layout, page_bytes: int, target: HostStore | PageFileWriter):
        """Pages of at most `page_bytes`, but for single chunks that are larger, to `target`."""
        self._layout, self._page_bytes, self._target = layout, page_bytes, target
        self._pool = ThreadPoolExecutor(1)
        self._writing: Future | None = None
        self._buffer: np.ndarray | None = None
        self._parts: list[int] = [0]
        self._chunks: list[dict] = []
        self._baked: list[np.ndarray] = []
        self._top: dict[str, list[np.ndarray]] = {"nodes": [], "treelet": [], "root": [], "triangles": []}
        self._treelets: list[np.ndarray] = []  # page, first byte of nodes, of triangles
        self._pages: list[tuple] = []  # treelet after the last, bytes in the store and first bytes
        self._blocks: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])  # of the page in hand
        self._sizes = [0, 0]
        self._treelet_count = self._node_count = 0

    def __enter__(self) -> PageBuilder:
        return self

    def __exit__(self, *_) -> None:
        self._pool.shutdown(cancel_futures=True)

    def add(self, chunk: Chunk, places: np.ndarray) -> None:
        """Behind the others; `places` as of `ChunkInstances`."""
        blocks = (chunk.nodes, chunk.triangles)
        sizes = [np.array([block.nbytes for block in each], np.int64) for each in blocks]
        if self._blocks[1] and sum(padded(self._sizes[k] + int(sizes[k].sum())) for k in range(2)) > self._page_bytes:
            self._flush()
        starts = [self._sizes[k] + np.cumsum(sizes[k]) - sizes[k] for k in range(2)]
        self._treelets.append(np.stack([np.full(len(sizes[0]), len(self._pages)), *starts]))
        self._top["nodes"].append(chunk.top_nodes)
        self._top["treelet"].append(np.where(chunk.top_treelet < 0, -1, chunk.top_treelet + self._treelet_count).astype(np.int32))
        self._top["root"].append((chunk.treelet_root + self._node_count).astype(np.int32))
        self._top["triangles"].append(chunk.top_triangles.copy())  # not all that it is a part of
        for k in range(2):
            self._blocks[k].extend(blocks[k])
            self._sizes[k] += int(sizes[k].sum())
        self._treelet_count += len(chunk.nodes)
        self._node_count += len(chunk.top_nodes)
        self._baked.append(places)
        self._chunks.append(
            {
                "node": len(chunk.top_nodes), "triangle": len(chunk.top_triangles), "treelet": len(chunk.nodes), "size": len(chunk.faces),
                "centre": chunk.centre, "box": chunk.box, "sah": chunk.sah, "depth": chunk.depth, "levels": chunk.levels,
            }
        )  # fmt: skip

    def end_part(self) -> None:
        """No more chunks of this mesh."""
        self._parts.append(len(self._chunks))

    def finish(self) -> PageTables:
        """Write what is left; raises what writing raised."""
        if self._blocks[1]:
            self._flush()
        self._wait()

        def column(name: str) -> np.ndarray:
            return np.array([chunk[name] for chunk in self._chunks])

        def firsts(name: str) -> np.ndarray:
            return np.cumsum([0, *column(name).tolist()], dtype=np.int64)

        def joined(name: str, words: int, dtype: type) -> np.ndarray:
            return np.concatenate([np.zeros((0, words), dtype), *self._top[name]])

        baked = ChunkInstances.of(self._baked)
        treelets = np.concatenate([np.zeros((3, 0), np.int64), *self._treelets], 1)
        pages = np.array(self._pages, np.int64).reshape(-1, 5)
        return PageTables(
            chunk_first=np.array(self._parts, np.int64),
            chunk_node=firsts("node"), chunk_triangle=firsts("triangle"), chunk_treelet=firsts("treelet"), chunk_size=column("size"),
            chunk_centre=column("centre"), chunk_box=column("box"), chunk_sah=column("sah"), chunk_depth=column("depth"),
            chunk_levels=column("levels"), baked_first=baked.first, baked_place=baked.place,
            top_nodes=joined("nodes", self._layout.node_words, self._layout.node_type),
            top_treelet=np.concatenate([np.zeros(0, np.int32), *self._top["treelet"]]),
            treelet_root=np.concatenate([np.zeros(0, np.int32), *self._top["root"]]),
            top_triangles=joined("triangles", self._layout.triangle_words, np.float32),
            treelet_page=treelets[0].astype(np.int32), treelet_node=treelets[1], treelet_triangle=treelets[2],
            page_treelet=np.concatenate([[0], pages[:, 0]]), page_byte=pages[:, 1:3], page_bytes=pages[:, 3:5],
        )  # fmt: skip

    def _flush(self) -> None:
        """The page in hand to the store."""
        self._wait()
        self._writing = self._pool.submit(self._write, self._blocks, tuple(padded(size) for size in self._sizes), self._treelet_count)
        self._pages.append(())  # comes when it is written
        self._blocks, self._sizes = ([], []), [0, 0]

    def _wait(self) -> None:
        if self._writing is not None:
            self._pages[-1] = self._writing.result()
            self._writing = None

    def _write(self, blocks: tuple[list[np.ndarray], list[np.ndarray]], sizes: tuple[int, int], treelet_end: int) -> tuple:
        total = sum(sizes)
        if isinstance(self._target, HostStore):
            first, memory = self._target.add(total)
        else:
            if self._buffer is None or len(self._buffer) < total:
                self._buffer = page_buffer(total).numpy()
            memory = self._buffer[:total]
        place = 0
        for part, size in zip(blocks, sizes):
            start, end = place, place + size
            for block in part:
                memory[place : place + block.nbytes] = block.view(np.uint8).reshape(-1)
                place += block.nbytes
            memory[place:end] = 0
            if not isinstance(self._target, HostStore):
                at = self._target.add(memory[start:end])
                first = at if start == 0 else first
            place = end
        return treelet_end, first, first + sizes[0], *sizes
