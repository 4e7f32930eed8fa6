"""The tables of a scene's pages: where treelets lie in them, and what stays on the device. Built once, kept
with the pages.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..node import Layout
from ..tree import Tree
from .chunk import Chunk
from .entries import ChunkInstances
from .packing import PagePacker
from .store import PAGE_ALIGNMENT, padded


@dataclass(frozen=True, kw_only=True)
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

    def page_sizes(self, nodes_resident: bool) -> tuple[np.ndarray, np.ndarray]:
        """Bytes of each page on the device, and in the store, int64, shape [P]; without nodes where these stay on the
        device.
        """
        device, stored = (
            (each[:, 1] if nodes_resident else each.sum(1)) for each in (self.page_device, self.page_bytes)
        )
        return device, stored

    def needed_bytes(self, resident: int, nodes_resident: bool, staged: bool) -> int:
        """Bytes of what stays, `resident` and perhaps all nodes, and of one page, which may have a buffer beside it."""
        sizes, stored = self.page_sizes(nodes_resident)
        nodes = max(int(self.page_bytes[:, 0].sum()), PAGE_ALIGNMENT) if nodes_resident else 0
        return resident + nodes + int(sizes.max()) + staged * int(stored.max())

    def index(self) -> dict[str, np.ndarray]:
        """The arrays by name, for a file."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


class PageBuilder:
    """Puts chunks into pages as they come, and their tables together; a `PagePacker` does the copying."""

    def __init__(self, layout: Layout, page_bytes: int, packer: PagePacker):
        """Pages of at most `page_bytes` on the device, but for single chunks that are larger."""
        self._layout, self._page_bytes, self._packer = layout, page_bytes, packer
        self._parts: list[int] = [0]
        self._chunks: list[dict] = []
        self._baked: list[np.ndarray] = []
        self._top: dict[str, list[np.ndarray]] = {"nodes": [], "treelet": [], "root": [], "triangles": []}
        self._treelets: list[np.ndarray] = []  # page, first byte of nodes, of triangles
        self._page_count = 0
        self._chunks_in_hand: list[tuple[Chunk, np.ndarray]] = []  # of the page in hand, with the triangles of the mesh
        self._sizes = [0, 0]
        self._treelet_count = self._node_count = 0

    def add(self, chunk: Chunk, instances: np.ndarray, triangles: np.ndarray) -> None:
        """Append a chunk; `instances` are those of `ChunkInstances`, `triangles` those of the mesh, int32 [n, 3]."""
        sizes = chunk.treelet_bytes(self._layout)
        if self._chunks_in_hand and sum(padded(self._sizes[k] + int(sizes[k].sum())) for k in range(2)) > (
            self._page_bytes
        ):
            self._flush()
        starts = [self._sizes[k] + np.cumsum(sizes[k]) - sizes[k] for k in range(2)]
        self._treelets.append(np.stack([np.full(len(sizes[0]), self._page_count), *starts]))
        self._top["nodes"].append(chunk.top_nodes)
        self._top["treelet"].append(
            np.where(chunk.top_treelet < 0, -1, chunk.top_treelet + self._treelet_count).astype(np.int32)
        )
        self._top["root"].append((chunk.treelet_root + self._node_count).astype(np.int32))
        self._top["triangles"].append(chunk.top_triangles.copy())  # not all that it is a part of
        self._sizes = [self._sizes[k] + int(sizes[k].sum()) for k in range(2)]
        self._chunks_in_hand.append((chunk, triangles))
        self._treelet_count += len(chunk.treelet_root)
        self._node_count += len(chunk.top_nodes)
        self._baked.append(instances)
        self._chunks.append(
            {
                "node": len(chunk.top_nodes),
                "triangle": len(chunk.top_triangles),
                "treelet": len(chunk.treelet_root),
                "size": len(chunk.faces),
                "centre": chunk.facts.centre,
                "box": chunk.facts.box,
                "sah": chunk.facts.sah,
                "depth": chunk.facts.depth,
                "levels": chunk.levels,
            }
        )

    def end_part(self) -> None:
        """Note that no more chunks of this mesh come."""
        self._parts.append(len(self._chunks))

    def finish(self) -> PageTables:
        """Write what is left; raises what writing raised."""
        if self._chunks_in_hand:
            self._flush()

        def column(name: str) -> np.ndarray:
            return np.array([chunk[name] for chunk in self._chunks])

        def firsts(name: str) -> np.ndarray:
            return np.cumsum([0, *column(name).tolist()], dtype=np.int64)

        def joined(name: str, words: int, dtype: type) -> np.ndarray:
            return np.concatenate([np.zeros((0, words), dtype), *self._top[name]])

        baked = ChunkInstances.of(self._baked)
        treelets = np.concatenate([np.zeros((3, 0), np.int64), *self._treelets], 1)
        pages = np.array(self._packer.finish(), np.int64).reshape(-1, 8)
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
        self._packer.put(self._chunks_in_hand, self._treelet_count)
        self._page_count += 1
        self._chunks_in_hand, self._sizes = [], [0, 0]


def page_statistics(
    tables: PageTables, layout: Layout, tree: Tree, levels: int, nodes_resident: bool
) -> dict[str, Any]:
    """Figures of the pages for statistics; `tree`, of so many `levels` at most, stays on the device."""
    node_bytes, triangle_bytes = (int(each) for each in tables.page_device.sum(0))
    return {
        "layout": layout.value,
        "trees": len(tables.chunk_first) - 1,
        "chunks": len(tables.chunk_size),
        "entries": tree.entry_count,
        "triangles": int(tables.chunk_size.sum()),
        "treelets": len(tables.treelet_root),
        "pages": len(tables.page_bytes),
        "page_fill": round(float(tables.page_device.sum(1).mean() / max(tables.page_device.sum(1).max(), 1)), 4),
        "bytes": node_bytes + triangle_bytes + tables.top_nodes.nbytes + tables.top_triangles.nbytes,
        "node_bytes": node_bytes,
        "triangle_bytes": triangle_bytes,
        "stored_bytes": int(tables.page_bytes.sum()),
        "nodes_resident": bool(nodes_resident),
        "depth": int(tables.chunk_depth.max()),
        "levels": levels,
        "sah": round(float(tables.chunk_sah.max()), 4),
        **({"time_ranges": tree.top_ranges} if tree.motion_steps else {}),
    }
