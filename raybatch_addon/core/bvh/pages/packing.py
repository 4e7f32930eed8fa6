"""Pages put together of chunks, packed where that is asked for, and brought to a store."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, Protocol

import numpy as np
import warp as wp

from ...device.devices import worker_count
from ...native.structs import to_numpy
from ..node import Layout, triangle_faces
from .chunk import Chunk
from .encode import encode_triangles
from .store import HostStore, padded, page_buffer

# Pages that are packed and written while the next chunks are built
_PACKED_AHEAD = 4


class PageTarget(Protocol):
    """Takes pages, each from memory that is written anew afterwards."""

    def add_page(self, memory: np.ndarray, node_bytes: int) -> int:
        """Append a page, uint8, whose segments of nodes, of `node_bytes`, and of triangles are whole
        `PAGE_ALIGNMENT`; returns its first byte.
        """


class NoStore:
    """Takes pages and keeps none: for tables alone."""

    def add_page(self, memory: np.ndarray, node_bytes: int) -> int:
        """See `PageTarget`: all begin at 0."""
        return 0


class PackedPage(NamedTuple):
    """Sizes and position of a page that is stored."""

    treelet_end: int  # treelets of this page and of all before
    node_byte: int  # first byte in the store: of the segment of nodes
    triangle_byte: int  # likewise of triangles
    node_bytes: int  # bytes of these segments
    triangle_bytes: int
    node_device_bytes: int  # likewise on the device
    triangle_device_bytes: int
    units: int  # triangles, or groups of them


class PagePacker(Protocol):
    """Makes pages of chunks, as they come."""

    plain_byte: list[int]  # first byte of each page as the device has it, where it is stored so besides

    def put(self, chunks: list[tuple[Chunk, np.ndarray]], treelet_end: int) -> None:
        """Make a page of `chunks`, each with the triangles of its mesh, int32 [n, 3]; raises what writing raised."""

    def finish(self) -> list[PackedPage]:
        """All pages, once they are stored; raises what writing raised."""

    def close(self) -> None:
        """Give up what is under way."""


class HostPacker:
    """Packs chunks that lie in host memory: threads do the packing, and one the writing."""

    def __init__(
        self,
        layout: Layout,
        target: HostStore | PageTarget,
        positions: np.ndarray | None,
        plain: HostStore | None = None,
    ):
        """Pages to `target`. With the mesh's `positions`, float32 [v, 3], triangles are packed; `plain`, if given,
        takes pages as the device has them besides.
        """
        self._layout, self._target, self._positions, self._plain = layout, target, positions, plain
        self.plain_byte: list[int] = []
        self._pool = ThreadPoolExecutor(min(worker_count(wp.get_device("cpu"), 0), _PACKED_AHEAD))
        self._writer = ThreadPoolExecutor(1)
        self._writing: deque[Future] = deque()
        self._buffer: np.ndarray | None = None
        self._pages: list[PackedPage] = []

    def put(self, chunks: list[tuple[Chunk, np.ndarray]], treelet_end: int) -> None:
        """See `PagePacker`."""
        self._wait(_PACKED_AHEAD - 1)
        page = self._pool.submit(self._segments, chunks)
        self._writing.append(self._writer.submit(self._write, page, treelet_end))

    def finish(self) -> list[PackedPage]:
        """See `PagePacker`."""
        self._wait(0)
        return self._pages

    def close(self) -> None:
        """See `PagePacker`."""
        self._writer.shutdown(cancel_futures=True)
        self._pool.shutdown(cancel_futures=True)

    def _wait(self, left: int) -> None:
        """Wait until no more than `left` pages are on their way."""
        while len(self._writing) > left:
            self._pages.append(self._writing.popleft().result())

    def _segments(self, chunks: list[tuple[Chunk, np.ndarray]]) -> tuple:
        """Blocks of nodes and of triangles as the store has them, and as the device has them."""
        plain = [chunk.nodes for chunk, _ in chunks], [chunk.triangles for chunk, _ in chunks]
        if self._positions is None:
            return plain, plain
        vertices = [
            mesh[triangle_faces(self._layout, chunk.triangles)] if chunk.vertices is None else chunk.vertices
            for chunk, mesh in chunks
        ]
        packed = encode_triangles(np.concatenate(plain[1]), np.concatenate(vertices), self._positions)
        return (plain[0], [packed]), plain

    def _write(self, page: Future, treelet_end: int) -> PackedPage:
        blocks, plain = page.result()
        device = [padded(sum(block.nbytes for block in each)) for each in plain]
        units = sum(map(len, plain[1]))
        if self._plain:
            first, memory = self._plain.add(sum(device))
            self.plain_byte.append(first)
            _fill(memory, plain, device)
        sizes = [padded(sum(block.nbytes for block in each)) for each in blocks]
        total = sum(sizes)
        if isinstance(self._target, HostStore):
            first, memory = self._target.add(total)
        else:
            if self._buffer is None or len(self._buffer) < total:
                self._buffer = to_numpy(page_buffer(total))
            memory = self._buffer[:total]
        _fill(memory, blocks, sizes)
        if not isinstance(self._target, HostStore):
            first = self._target.add_page(memory, sizes[0])
        node_bytes, triangle_bytes = sizes
        node_device_bytes, triangle_device_bytes = device
        return PackedPage(
            treelet_end=treelet_end,
            node_byte=first,
            triangle_byte=first + node_bytes,
            node_bytes=node_bytes,
            triangle_bytes=triangle_bytes,
            node_device_bytes=node_device_bytes,
            triangle_device_bytes=triangle_device_bytes,
            units=units,
        )


def _fill(memory: np.ndarray, segments: tuple[list[np.ndarray], list[np.ndarray]], sizes: list[int]) -> None:
    """Blocks of each segment into `memory`, uint8, and 0 up to its size [bytes]."""
    end = 0
    for blocks, size in zip(segments, sizes, strict=True):
        byte, end = end, end + size
        for block in blocks:
            memory[byte : byte + block.nbytes] = block.view(np.uint8).reshape(-1)
            byte += block.nbytes
        memory[byte:end] = 0
