"""Tiles on their way to slots of a GPU, which reads them where the pictures lie, in locked memory of the host; those of
pictures that cannot be locked come by a buffer. Copies go on beside other kernels: few threads keep the bus busy.
"""

from __future__ import annotations

import ctypes

import numpy as np
import warp as wp

from ...device.devices import copy_stream
from ...device.kernel import KERNEL_OPTIONS
from ...native.structs import record_type, to_numpy
from ...shading.images.tiled.pictures import TileSource

# Threads that copy, a quarter of a megabyte at a time: as fast as more of them (H200: 38 to 42 GB/s; half of them 25),
# which would hold up what is traced meanwhile
_THREADS = 1 << 14
# Bytes of tiles in the buffer
_STAGED_BYTES = 64 << 20
_WORD_BYTES = 4
_AT_ONCE = 4  # words that a thread reads before it writes them


@wp.struct
class TileCopy:
    """Where a tile lies in its picture, and the slot that it is copied to."""

    source: wp.uint64  # address of its first texel
    stride: wp.int64  # bytes from a row of the picture to the next
    target: wp.uint64
    rows: int  # within the picture
    width: int  # bytes of such a row
    stored: int  # bytes of a texel of the picture
    texel: int  # bytes of a texel in the slot, a power of two; what is beyond those stored is `fill`
    row_words: int  # of a row in the slot
    fill: wp.uint32


class TileCarrier:
    """Carries tiles of a source to slots on its device; a CUDA device does other work meanwhile."""

    def __init__(self, source: TileSource, capacity: int):
        """All tiles of `source` are known, wherever they lie; at most `capacity` are carried together."""
        self._source, self._device = source, source.device
        self._stream = copy_stream(self._device.alias, "tiles") if self._device.is_cuda else None
        tiles = np.setdiff1d(np.arange(source.number_count), source.rows)
        located = np.zeros(len(tiles), record_type(TileCopy))
        sizes = source.locate(tiles, located)
        self._records = np.zeros(source.number_count, located.dtype)
        self._sizes = np.zeros(source.number_count, np.int64)
        self._records[tiles], self._sizes[tiles] = located, sizes
        # what is said of the tiles under way, and of those before them
        self._on_host = [_records(capacity, wp.get_device("cpu"), self._device.is_cuda) for _ in range(2)]
        self._on_device = [_records(capacity, self._device) for _ in range(2)]
        self._turn = 0

    def __del__(self):
        if getattr(self, "_stream", None):
            wp.synchronize_stream(self._stream)  # slots are given back behind this

    def carry(self, numbers: np.ndarray, addresses: np.ndarray) -> int:
        """Begin to copy the tiles `numbers` to slots at `addresses`, uint64, which nobody reads any more, behind those
        that were carried before; their bytes there. Of these only the last may still be under way.
        """
        if self._stream:  # behind what the device was told before, of slots too
            self._stream.wait_event(self._device.stream.record_event())
        records = self._records[numbers]
        records["target"] = addresses
        is_read = records["source"] != 0
        if not is_read.all():
            self._carry_staged(numbers[~is_read], records[~is_read])
        self._launch(records[is_read])
        return int(self._sizes[numbers].sum())

    def wait(self) -> None:
        """What the device is told from now on comes when all of them are there."""
        if self._stream:
            self._device.stream.wait_event(self._stream.record_event())

    def _launch(self, records: np.ndarray) -> None:
        if not len(records):
            return
        self._turn ^= 1
        on_host, on_device = (each[self._turn][: len(records)] for each in (self._on_host, self._on_device))
        ctypes.memmove(on_host.ptr, np.ascontiguousarray(records).ctypes.data, records.nbytes)
        wp.copy(on_device, on_host, stream=self._stream)
        words = self._source.slot_bytes // _WORD_BYTES
        threads = min(_THREADS, len(records) * words) if self._stream else 1
        inputs = [on_device, words.bit_length() - 1, threads]
        wp.launch(carry_tiles_kernel, threads, inputs, device=self._device, stream=self._stream)

    def _carry_staged(self, numbers: np.ndarray, records: np.ndarray) -> None:
        """Carry the tiles by a locked buffer, in which they lie as in their slots."""
        size = self._source.slot_bytes
        most = max(1, min(len(numbers), _STAGED_BYTES // size))
        buffer = wp.zeros((most, size), dtype=wp.uint8, device="cpu", pinned=self._device.is_cuda)
        tiles, texels = to_numpy(buffer), records["row_words"] * _WORD_BYTES // records["texel"]  # of a row
        records["stored"] = records["texel"]
        records["stride"] = records["width"] = texels * records["texel"]
        for first in range(0, len(numbers), most):
            part = records[first : first + most]
            for place, number in enumerate(numbers[first : first + most].tolist()):
                self._source.copy_tile(number, tiles[place])
            part["source"] = buffer.ptr + size * np.arange(len(part), dtype=np.uint64)
            self._launch(part)
            if self._stream:
                wp.synchronize_stream(self._stream)  # before the buffer is written again, or freed


def _records(count: int, device: wp.Device, pinned: bool = False) -> wp.array:
    return wp.zeros(count, dtype=TileCopy, device=device, pinned=pinned)


@wp.func
def bytes_at(address: wp.uint64, count: int) -> wp.uint32:
    """One to four bytes at an address of any alignment, the first one lowest; no word is read that has none of them."""
    shift = wp.uint32(address & wp.uint64(3)) * wp.uint32(8)
    words = wp.array(ptr=address - (address & wp.uint64(3)), shape=(2,), dtype=wp.uint32)
    value = words[0] >> shift
    if int(shift) + 8 * count > 32:
        value = value | (words[1] << (wp.uint32(32) - shift))
    if count < 4:
        value = value & ((wp.uint32(1) << wp.uint32(8 * count)) - wp.uint32(1))
    return value


@wp.func
def is_inside(c: TileCopy, word: int) -> bool:
    """Whether the picture has anything of a word of the tile."""
    row = word // c.row_words
    texel = wp.static(_WORD_BYTES) * (word - row * c.row_words) // c.texel
    return row < c.rows and texel * c.stored < c.width


@wp.func
def word_of(c: TileCopy, word: int) -> wp.uint32:
    """A word of a tile that is inside its picture."""
    row = word // c.row_words
    at = wp.static(_WORD_BYTES) * (word - row * c.row_words)
    texel = at // c.texel
    first = at - texel * c.texel  # byte within the texel
    offset = texel * c.stored + first
    address = c.source + wp.uint64(wp.int64(row) * c.stride + wp.int64(offset))
    count = wp.min(wp.static(_WORD_BYTES), c.width - offset)
    value = wp.uint32(0)
    if c.stored != c.texel:
        count = wp.clamp(c.stored - first, 0, wp.static(_WORD_BYTES))
        if count < wp.static(_WORD_BYTES):
            value = c.fill << wp.uint32(8 * count)
    if count == wp.static(_WORD_BYTES) and (address & wp.uint64(3)) == wp.uint64(0):
        there = wp.array(ptr=address, shape=(1,), dtype=wp.uint32)
        value = there[0]
    elif count > 0:
        value = value | bytes_at(address, count)
    return value


@wp.kernel(**KERNEL_OPTIONS)
def carry_tiles_kernel(copies: wp.array(dtype=TileCopy), word_bits: int, threads: int):
    """Copy tiles of 2^`word_bits` words. Neighboring threads read neighboring words, as transfers through the bus need
    it, and each some at once, since a word takes long to come.
    """
    at = wp.int64(wp.tid())
    step = wp.int64(threads)
    bits = wp.int64(word_bits)
    mask = (wp.int64(1) << bits) - wp.int64(1)
    end = wp.int64(copies.shape[0]) << bits
    while at < end:
        values = wp.vector(length=wp.static(_AT_ONCE), dtype=wp.uint32)
        for k in range(wp.static(_AT_ONCE)):
            i = at + wp.int64(k) * step
            if i < end:
                c = copies[int(i >> bits)]
                if is_inside(c, int(i & mask)):
                    values[k] = word_of(c, int(i & mask))
        for k in range(wp.static(_AT_ONCE)):
            i = at + wp.int64(k) * step
            if i < end:
                c = copies[int(i >> bits)]
                word = int(i & mask)
                if is_inside(c, word):
                    slot = wp.array(ptr=c.target, shape=(word + 1,), dtype=wp.uint32)
                    slot[word] = values[k]
        at += wp.int64(wp.static(_AT_ONCE)) * step
