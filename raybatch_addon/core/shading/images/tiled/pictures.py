"""Pictures whose tiles wait in the host's memory, and what of them is on a device all the time."""

from __future__ import annotations

import contextlib
import functools
import weakref
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.locked import OWN_PAGES_LEAST, locked_empty, locked_view
from ....native.structs import to_numpy
from ....scene.description import ImageEncoding
from ....scene.frozen import is_frozen
from ..levels import FilteredImage, ImageLevels, coarser_levels, level_encoding
from ..storage import TEXEL_KINDS, Part, finite_texels, uploaded_texels, with_alpha
from ..textures import ImageEntry, Texels
from .look_up import COLUMN_SHIFT, KIND_MASK, ROW_SHIFT

# Bytes of a texel by `Texels`, as slots are divided: three take the room of four
_TEXEL_BYTES = {kind: wp.types.type_size_in_bytes(dtype) for kind, dtype in TEXEL_KINDS.values()} | {Texels.BYTE3: 4}

# The number 1, or its like, in texels of a type
_OPAQUE_BITS = {"uint8": 0xFF, "float16": 0x3C00, "float32": 0x3F800000}


@dataclass(frozen=True)
class TiledImage(FilteredImage):
    """An image whose pictures are brought to the device tile by tile, where they are larger than a slot."""

    levels: ImageLevels = ImageLevels.NONE
    slot_bytes: int = 1 << 16


def tile_bits(kind: Texels, slot_bytes: int) -> tuple[int, int]:
    """Bits of a column and of a row within a tile that fills a slot of `slot_bytes`, a power of two."""
    bits = (slot_bytes // _TEXEL_BYTES[kind]).bit_length() - 1
    return bits - bits // 2, bits // 2


@dataclass(kw_only=True)
class TiledPicture:
    """A picture in tiles, and its levels, as they lie in the host's memory; levels that are no larger than a slot are
    whole, on the device.
    """

    source: weakref.ref  # the array that it was made of
    device: wp.Device
    texels: Texels
    slot_bytes: int
    tiled: list[np.ndarray]  # the picture and its large levels, each [height, width, channels]
    # the same where a GPU reads them, uint8, [height, bytes of a row]; None: it does not
    read: list[wp.array | None]
    small: list[np.ndarray]  # the levels above them
    array: wp.array | None  # the same on the device, one after another
    level_encoding: int  # `ImageEncoding`, or `ROOT`
    replaced: int  # texels that were not finite, and became black
    halvings: int = 0  # it keeps its size

    def is_still_true(self) -> bool:
        """Whether what it was made of is there, and cannot have changed."""
        pixels = self.source()
        return pixels is not None and is_frozen(pixels)

    @property
    def width(self) -> int:
        """Of the picture [texels]."""
        return self.tiled[0].shape[1]

    @property
    def height(self) -> int:
        """Of the picture [texels]."""
        return self.tiled[0].shape[0]

    @property
    def arrays(self) -> list[wp.array]:
        """Its arrays on the device."""
        return [] if self.array is None else [self.array]

    @property
    def bytes(self) -> int:
        """Memory on the device, tiles apart [bytes]."""
        return sum(each.size * wp.types.type_size_in_bytes(each.dtype) for each in self.arrays)

    @property
    def level_bytes(self) -> int:
        """What of it is levels [bytes]."""
        return self.bytes


def tiled_picture(
    pixels: np.ndarray, levels: ImageLevels, encoding: ImageEncoding, slot_bytes: int, device: wp.Device
) -> TiledPicture:
    """`pixels` [height, width, 1, 3 or 4] in tiles that fill slots of `slot_bytes`."""
    own, replaced = pixels, 0
    if pixels.dtype != np.uint8:
        own, replaced = finite_texels(pixels)
    # as pictures that are whole are stored, but that what gets an opaque alpha gets it tile by tile
    channels = own.shape[2] if own.shape[2] != 3 or (own.dtype == np.uint8 and not device.is_cuda) else 4
    kind, dtype = TEXEL_KINDS[own.dtype.name, channels]
    tiled, small = [own], []
    for level in coarser_levels(own, encoding, levels) if levels else ():
        is_large = level.shape[0] * level.shape[1] * _TEXEL_BYTES[kind] > slot_bytes
        (tiled if is_large else small).append(level)
    array = None
    if small:
        whole = [with_alpha(each) if each.shape[2] != channels else each for each in small]
        array = uploaded_texels(np.concatenate([each.reshape(-1, channels) for each in whole]), dtype, device)
    return TiledPicture(
        source=weakref.ref(pixels),
        device=device,
        texels=kind,
        slot_bytes=slot_bytes,
        tiled=tiled,
        read=[read_by(each, device) if device.is_cuda else None for each in tiled],
        small=small,
        array=array,
        level_encoding=level_encoding(own.dtype, encoding),
        replaced=replaced,
    )


def read_by(pixels: np.ndarray, device: wp.Device) -> wp.array | None:
    """`pixels` [height, ...] as rows of bytes that the CUDA device reads through the bus: where they lie, or, if they
    are few, a locked copy. None where they cannot be locked.
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    there = locked_view(rows, wp.uint8, device)
    if there is None and rows.nbytes < OWN_PAGES_LEAST:
        with contextlib.suppress(MemoryError, RuntimeError):
            there = locked_empty(rows.shape, wp.uint8)
            to_numpy(there)[:] = rows
    return there


@dataclass(frozen=True)
class _Grid:
    """A picture or a level, divided in tiles."""

    pixels: np.ndarray
    read: wp.array | None  # the same where a GPU reads it; None: it does not
    channels: int  # that are stored
    column_bits: int
    row_bits: int
    columns: int  # tiles side by side


class TileSource:
    """All pictures in tiles of a scene. Tiles have numbers: those of a picture follow each other, row by row from the
    bottom, behind a number that is none of a tile.
    """

    def __init__(self, device: wp.Device):
        self.device = device
        self.slot_bytes = 0
        self.number_count = 0  # of tiles, and of what is in front of each picture's
        self.tile_count = 0
        self.bytes = 0  # of all tiles, as they would be on the device
        self.entries = np.zeros(
            0, ImageEntry.numpy_dtype()
        )  # addresses of pictures in tiles: 8 times their first number
        self.table_tiles: wp.array | None = None  # `ImageTable.tiles`
        self._grids: list[_Grid] = []
        self._first: list[int] = []  # numbers in front of the tiles of each grid

    def place(self, picture: TiledPicture) -> list[Part]:
        """Give numbers to the tiles of `picture`; returns it and its levels as the table has them."""
        self.slot_bytes, kind = picture.slot_bytes, int(picture.texels)
        column_bits, row_bits = tile_bits(picture.texels, picture.slot_bytes)
        word = kind | column_bits << COLUMN_SHIFT | row_bits << ROW_SHIFT
        channels = next(shape[1] for shape, known in TEXEL_KINDS.items() if known[0] is picture.texels)
        parts = []
        for place, pixels in enumerate(picture.tiled):
            height, width = pixels.shape[:2]
            columns, rows = ((width - 1) >> column_bits) + 1, ((height - 1) >> row_bits) + 1
            self._first.append(self.number_count)
            self._grids.append(_Grid(pixels, picture.read[place], channels, column_bits, row_bits, columns))
            parts.append(Part(8 * self.number_count, word, width, height))
            self.number_count += 1 + columns * rows
            self.tile_count += columns * rows
            self.bytes += width * height * channels * pixels.itemsize
        address = picture.array.ptr if picture.array is not None else 0
        for pixels in picture.small:
            height, width = pixels.shape[:2]
            parts.append(Part(address, kind, width, height))
            address += width * height * channels * pixels.itemsize
        return parts

    @property
    def _is_tiled(self) -> np.ndarray:
        """Which entries are of pictures in tiles."""
        return self.entries["texels"] > KIND_MASK

    def without_tiled(self) -> np.ndarray:
        """`entries` for who cannot wait: pictures in tiles are missing."""
        entries = self.entries.copy()
        entries["texels"][self._is_tiled] = int(Texels.MISSING)
        return entries

    def entries_at(self, address: int) -> np.ndarray:
        """`entries` of which all rows of tiles lie at `address`."""
        entries = self.entries.copy()
        entries["address"][self._is_tiled] += np.uint64(address)
        return entries

    @property
    def rows(self) -> np.ndarray:
        """Numbers in front of the tiles of each picture or level, int64."""
        return np.array(self._first, np.int64)

    def locate(self, numbers: np.ndarray, records: np.ndarray) -> np.ndarray:
        """Say in `records` of `TileCopy`, one for each of the tiles `numbers`, where they lie; bytes of each in a slot.
        `source` is 0 for those that a GPU does not read.
        """
        at = np.searchsorted(self._table["first"], numbers, side="right") - 1
        grid = {name: values[at] for name, values in self._table.items()}
        row, column = np.divmod(numbers - grid["first"] - 1, grid["columns"])
        x, y = column << grid["column_bits"], row << grid["row_bits"]
        rows = np.minimum(1 << grid["row_bits"], grid["height"] - y)
        across = np.minimum(1 << grid["column_bits"], grid["width"] - x)
        records["stride"] = grid["width"] * grid["stored"]
        offset = (y * records["stride"] + x * grid["stored"]).astype(np.uint64)
        records["source"] = np.where(grid["address"] != 0, grid["address"] + offset, 0)
        records["rows"], records["width"] = rows, across * grid["stored"]
        records["row_words"] = (grid["texel"] << grid["column_bits"]) // 4
        for name in ("stored", "texel", "fill"):
            records[name] = grid[name]
        return rows * across * grid["texel"]

    @functools.cached_property
    def _table(self) -> dict[str, np.ndarray]:
        """Of each grid what `locate` asks for; all pictures are placed before."""

        def column(of: Callable[[_Grid], int], dtype: type = np.int64) -> np.ndarray:
            return np.array([of(each) for each in self._grids], dtype)

        return {
            "first": self.rows,
            "address": column(lambda grid: 0 if grid.read is None else grid.read.ptr, np.uint64),
            "height": column(lambda grid: grid.pixels.shape[0]),
            "width": column(lambda grid: grid.pixels.shape[1]),
            "columns": column(lambda grid: grid.columns),
            "column_bits": column(lambda grid: grid.column_bits),
            "row_bits": column(lambda grid: grid.row_bits),
            "stored": column(lambda grid: grid.pixels.shape[2] * grid.pixels.itemsize),
            "texel": column(lambda grid: grid.channels * grid.pixels.itemsize),
            "fill": column(lambda grid: _OPAQUE_BITS[grid.pixels.dtype.name], np.uint32),
        }

    def copy_tile(self, number: int, slot: np.ndarray) -> int:
        """Copy the tile `number` to `slot`, uint8, shape [slot_bytes]; its bytes. What of a tile is beyond its picture
        is left as it was.
        """
        at = bisect_right(self._first, number) - 1
        grid, index = self._grids[at], number - self._first[at] - 1
        row, column = divmod(index, grid.columns)
        x, y = column << grid.column_bits, row << grid.row_bits
        part = grid.pixels[y : y + (1 << grid.row_bits), x : x + (1 << grid.column_bits)]
        height, width, stored = part.shape
        shape = (1 << grid.row_bits, 1 << grid.column_bits, grid.channels)
        size = shape[0] * shape[1] * shape[2] * part.itemsize
        target = slot[:size].view(part.dtype).reshape(shape)[:height, :width]
        target[..., :stored] = part
        if stored < grid.channels:
            target[..., stored:] = 255 if part.dtype == np.uint8 else 1
        return height * width * grid.channels * part.itemsize
