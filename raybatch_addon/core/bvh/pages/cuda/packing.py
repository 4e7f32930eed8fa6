"""Pages made of chunks that lie on a device: packed there, and copied to the store as they are."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import warp as wp

from ....native.structs import to_numpy
from ...node import Layout
from ..chunk import Chunk
from ..packing import NoStore, PackedPage, PageTarget
from ..store import HostStore, padded, page_buffer
from .chunks import retyped
from .encode import encode_on_device

# Pages that are stored while the next ones are made
_STORED_AHEAD = 3
_TRIANGLE_BYTES = 4 * Layout.QUANTISED.triangle_words


class DevicePacker:
    """A `PagePacker` of the layout QUANTISED for chunks whose triangles lie on `device`."""

    def __init__(
        self, device: wp.Device, target: HostStore | PageTarget, encoded: bool, plain: HostStore | None = None
    ):
        """Pages to `target`, with triangles packed where they are `encoded`; `plain`, if given, takes pages as the
        device has them besides.
        """
        self._device, self._target, self._encoded, self._plain = device, target, encoded, plain
        self.plain_byte: list[int] = []
        self._pages: list[PackedPage] = []
        self._storer = ThreadPoolExecutor(1)
        self._storing: deque[Future] = deque()
        self._buffer: wp.array | None = None

    def put(self, chunks: list[tuple[Chunk, np.ndarray]], treelet_end: int) -> None:
        """See `PagePacker`."""
        held = [chunk for chunk, _ in chunks]
        nodes = [_as_bytes(chunk.nodes) for chunk in held if len(chunk.nodes)]
        triangles = _joined([chunk.triangles for chunk in held], wp.vec4, self._device)
        plain = words = retyped(triangles, wp.uint8)
        packed = None
        if self._encoded:
            vertices = _joined([chunk.vertices for chunk in held], wp.int32, self._device)
            packed = encode_on_device(retyped(triangles, wp.int32), vertices)
            words = retyped(packed, wp.uint8)
        node_bytes = padded(sum(block.size for block in nodes))
        sizes, device = (node_bytes, padded(words.size)), (node_bytes, padded(plain.size))
        page = PackedPage(
            treelet_end=treelet_end,
            node_byte=0,
            triangle_byte=0,
            node_bytes=sizes[0],
            triangle_bytes=sizes[1],
            node_device_bytes=device[0],
            triangle_device_bytes=device[1],
            units=plain.size // _TRIANGLE_BYTES,
        )
        self._wait(_STORED_AHEAD - 1)
        # with the arrays that others are parts of
        self._storing.append(self._storer.submit(self._store, nodes, words, plain, page, (held, triangles, packed)))

    def finish(self) -> list[PackedPage]:
        """See `PagePacker`."""
        self._wait(0)
        wp.synchronize_device(self._device)
        return self._pages

    def close(self) -> None:
        """See `PagePacker`."""
        self._storer.shutdown(cancel_futures=True)
        wp.synchronize_device(self._device)

    def _wait(self, left: int) -> None:
        """Wait until no more than `left` pages are being stored."""
        while len(self._storing) > left:
            self._pages.append(self._storing.popleft().result())

    def _store(
        self, nodes: list[wp.array], triangles: wp.array, plain: wp.array, page: PackedPage, kept: tuple
    ) -> PackedPage:
        """Bring a page to the store, in a thread: locked memory is had, and files are written, while the device builds.
        `kept` is what the arrays are parts of: it must live until the page is stored.
        """
        if self._plain:
            size = page.node_device_bytes + page.triangle_device_bytes
            first, _ = self._plain.add(size)
            self.plain_byte.append(first)
            _bring(self._plain.at(first, size), nodes, plain, page.node_bytes)
        first, size = 0, page.node_bytes + page.triangle_bytes
        if isinstance(self._target, HostStore):
            first, _ = self._target.add(size)
            _bring(self._target.at(first, size), nodes, triangles, page.node_bytes)
        elif not isinstance(self._target, NoStore):
            if self._buffer is None or self._buffer.size < size:
                self._buffer = page_buffer(size, pinned=self._device.is_cuda)
            _bring(self._buffer, nodes, triangles, page.node_bytes)
            if self._device.is_cuda:
                wp.synchronize_event(self._device.stream.record_event())
            first = self._target.add_page(to_numpy(self._buffer)[:size], page.node_bytes)
        return page._replace(node_byte=first, triangle_byte=first + page.node_bytes)


def _as_bytes(nodes: np.ndarray | wp.array) -> wp.array:
    if isinstance(nodes, wp.array):
        return retyped(nodes, wp.uint8)
    return wp.array(nodes.view(np.uint8).reshape(-1), dtype=wp.uint8, device="cpu", copy=False)


def _joined(parts: list[wp.array], dtype: type, device: wp.Device) -> wp.array:
    """All of `parts`, one after another; of a single one it is itself."""
    if len(parts) == 1:
        return parts[0]
    out, end = wp.empty(sum(part.size for part in parts), dtype=dtype, device=device), 0
    for part in parts:
        if part.size:
            wp.copy(out, part, dest_offset=end, count=part.size)
        end += part.size
    return out


def _bring(memory: wp.array, nodes: list[wp.array], triangles: wp.array, node_bytes: int) -> None:
    """A page to `memory`, uint8, of the host: `nodes`, 0 up to `node_bytes`, `triangles`, 0 up to a multiple of
    `PAGE_ALIGNMENT`.
    """
    end = 0
    for block in nodes:
        wp.copy(memory, block, dest_offset=end, count=block.size)
        end += block.size
    host = to_numpy(memory)
    host[end:node_bytes] = 0
    if triangles.size:
        wp.copy(memory, triangles, dest_offset=node_bytes, count=triangles.size)
    host[node_bytes + triangles.size : node_bytes + padded(triangles.size)] = 0
