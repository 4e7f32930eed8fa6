"""Tiles on their way to slots of a GPU, which reads them where the pictures lie, in locked memory of the host; those of
pictures that cannot be locked come by a buffer.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...native.structs import record_type, upload_records
from ...shading.images.tiled.pictures import TileSource

# Tiles of one launch: what is uploaded for them takes 2 MB
_LAUNCHED = 1 << 15
# Bytes of tiles in the buffer
_STAGED_BYTES = 64 << 20
_WORD_BYTES = 4  # a thread writes so many


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


def carry_tiles(source: TileSource, numbers: np.ndarray, addresses: np.ndarray) -> int:
    """Copy the tiles `numbers` of `source` to slots at `addresses`, uint64; their bytes there."""
    records = np.zeros(len(numbers), record_type(TileCopy))
    carried = source.locate(numbers, records)
    records["target"] = addresses
    _launch(source, records[records["source"] != 0])
    if not records["source"].all():
        _carry_staged(source, numbers[records["source"] == 0], records[records["source"] == 0])
    return carried


def _launch(source: TileSource, records: np.ndarray) -> None:
    words = source.slot_bytes // _WORD_BYTES
    for first in range(0, len(records), _LAUNCHED):
        copies = upload_records(records[first : first + _LAUNCHED], TileCopy, source.device)
        wp.launch(carry_tiles_kernel, (len(copies), words), [copies], device=source.device)


def _carry_staged(source: TileSource, numbers: np.ndarray, records: np.ndarray) -> None:
    """Carry the tiles by a locked buffer, in which they lie as in their slots."""
    device, size = source.device, source.slot_bytes
    most = max(1, min(len(numbers), _STAGED_BYTES // size))
    buffer = wp.zeros((most, size), dtype=wp.uint8, device="cpu", pinned=device.is_cuda)
    tiles, texels = buffer.numpy(), records["row_words"] * _WORD_BYTES // records["texel"]  # of a row
    records["stored"] = records["texel"]
    records["stride"] = records["width"] = texels * records["texel"]
    for first in range(0, len(numbers), most):
        part = records[first : first + most]
        for place, number in enumerate(numbers[first : first + most].tolist()):
            source.copy_tile(number, tiles[place])
        part["source"] = buffer.ptr + size * np.arange(len(part), dtype=np.uint64)
        _launch(source, part)
        if device.is_cuda:
            wp.synchronize_stream(device.stream)  # before the buffer is written again, or freed


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


@wp.kernel(**KERNEL_OPTIONS)
def carry_tiles_kernel(copies: wp.array(dtype=TileCopy)):
    """Copy tiles word by word. Neighboring threads read neighboring words, as transfers through the bus need it."""
    i, word = wp.tid()
    c = copies[i]
    row = word // c.row_words
    at = wp.static(_WORD_BYTES) * (word - row * c.row_words)
    texel = at // c.texel
    if row < c.rows and texel * c.stored < c.width:
        first = at - texel * c.texel  # byte within the texel
        offset = texel * c.stored + first
        count = wp.min(wp.static(_WORD_BYTES), c.width - offset)
        value = wp.uint32(0)
        if c.stored != c.texel:
            count = wp.clamp(c.stored - first, 0, wp.static(_WORD_BYTES))
            if count < wp.static(_WORD_BYTES):
                value = c.fill << wp.uint32(8 * count)
        if count > 0:
            value = value | bytes_at(c.source + wp.uint64(wp.int64(row) * c.stride + wp.int64(offset)), count)
        slot = wp.array(ptr=c.target, shape=(word + 1,), dtype=wp.uint32)
        slot[word] = value
