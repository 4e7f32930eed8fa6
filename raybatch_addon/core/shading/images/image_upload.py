"""Images on their way to a device: checked, made to fit its memory, and kept for the next frame."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ...scene.description import Image, ImageEncoding
from ...scene.frozen import is_frozen
from .levels import FilteredImage, ImageLevels, coarser_levels, level_encoding, level_sizes
from .storage import TEXEL_KINDS, Part, finite_texels, uploaded_texels, with_alpha
from .textures import TILE_COLUMNS, ImageEntry, ImageTable, Texels
from .tiled.pictures import TiledImage, TiledPicture, TileSource, tiled_picture

FIRST_TILE = 1001  # number of the tile at texture coordinates 0..1 (UDIM)
LAST_TILE = 2000  # number of the last tile that Blender has
TEXELS_MAX = 2**31 - 1  # most texels of one picture: an int32 counts them
EDGE_LEAST = 16  # pictures are not made smaller than this to save memory [texels]


@dataclass(kw_only=True)
class _Picture:
    """The pixels of an image or tile on the device."""

    source: weakref.ref  # the array that it was made of
    halvings: int  # how many times it was halved in width and height
    texels: Texels
    width: int
    height: int
    array: wp.array
    replaced: int  # texels that were not finite, and became black
    # levels one after another, each smaller than the one before; None: it has none
    levels: wp.array | None
    level_encoding: int  # `ImageEncoding`, or `ROOT`

    def is_still_true(self) -> bool:
        """Whether what it was made of is there, and cannot have changed."""
        pixels = self.source()
        return pixels is not None and is_frozen(pixels)

    @property
    def bytes(self) -> int:
        """Memory of the picture on the device [bytes]."""
        texels = self.array.size + (self.levels.size if self.levels else 0)
        return texels * wp.types.type_size_in_bytes(self.array.dtype)

    @property
    def texel_bytes(self) -> int:
        """Memory of a texel [bytes]."""
        return 3 if self.texels is Texels.BYTE3 else wp.types.type_size_in_bytes(self.array.dtype)

    @property
    def level_bytes(self) -> int:
        """What of it is levels [bytes]."""
        return self.levels.size * wp.types.type_size_in_bytes(self.levels.dtype) if self.levels else 0

    @property
    def device(self) -> wp.Device:
        """Where it is."""
        return self.array.device

    @property
    def arrays(self) -> list[wp.array]:
        """Its arrays on the device."""
        return [each for each in (self.array, self.levels) if each is not None]

    def parts(self) -> list[Part]:
        """The picture, and its levels."""
        found = [Part(self.array.ptr, int(self.texels), self.width, self.height)]
        if self.levels is not None:
            address = self.levels.ptr
            for width, height in level_sizes(self.width, self.height):
                found.append(Part(address, int(self.texels), width, height))
                address += width * height * self.texel_bytes
        return found


@dataclass(frozen=True)
class _Wanted:
    """Checked pixels of an image or tile that a scene needs."""

    label: str  # name in messages
    pixels: np.ndarray  # shape [height, width, channels], not empty
    levels: ImageLevels
    encoding: ImageEncoding
    device_bytes: int
    slot_bytes: int = 0  # of a slot for its tiles; 0: it is whole

    @property
    def key(self) -> tuple[int, ...]:
        """What the picture on the device follows from, the array of pixels by its identity."""
        return (id(self.pixels), int(self.levels), int(self.encoding) if self.levels else 0, self.slot_bytes)


@dataclass
class UploadedImages:
    """The images of a scene on its device."""

    table: ImageTable
    warnings: list[str] = field(default_factory=list)  # repairs and reductions, with the images' names
    bytes: int = 0  # memory on the device
    level_bytes: int = 0  # what of it is levels
    keep: list[wp.array] = field(default_factory=list)  # arrays of the pictures: the table holds addresses alone
    tiled: TileSource | None = None  # of pictures in tiles, which are missing in `table`; None: there are none


class ImageCache:
    """The pictures of the last upload; a frozen array of pixels that was uploaded already is not uploaded again."""

    def __init__(self) -> None:
        self._pictures: dict[tuple[int, ...], _Picture | TiledPicture] = {}  # by `_Wanted.key`

    @property
    def device_bytes(self) -> int:
        """Memory that the pictures take on the device [bytes]."""
        # what a cancelled render left behind may add some meanwhile
        return sum(picture.bytes for picture in list(self._pictures.values()))

    def clear(self) -> None:
        """Drop the pictures, and their memory."""
        self._pictures = {}

    def upload(self, images: Sequence[Image], device, budget: int | None = None) -> UploadedImages:
        """The table of `images` on `device`.

        Pictures are made smaller until all of them fit in `budget` bytes (None: no limit), as far as that can go. Where
        some are in tiles, the others have half of it. Texels that are not finite become black. The warnings name the
        images of both.
        """
        device = wp.get_device(device)
        done = UploadedImages(ImageTable())
        wanted = list(_wanted(images, done.warnings))
        if budget is not None and any(each and each.slot_bytes for each in wanted):
            budget //= 2  # the other half is for tiles
        halvings = _halvings(wanted, budget)
        entries, tiles, arrays = self._entries(images, wanted, halvings, device, done)
        done.table.tiles = wp.array(tiles, dtype=int, device=device)
        if done.tiled:
            done.tiled.entries, done.tiled.table_tiles = entries, done.table.tiles
            entries = done.tiled.without_tiled()
        done.table.entries = wp.array(entries, dtype=ImageEntry, device=device)
        done.keep = arrays
        return done

    def _entries(self, images, wanted: list[_Wanted | None], halvings: list[int], device, done: UploadedImages):
        """Rows of the table, entries of tiles, and the arrays of all pictures."""
        kept = {key: each for key, each in self._pictures.items() if each.is_still_true()}
        self._pictures = {}
        pictures = [
            each and self._picture(each, count, kept.get(each.key), device, done.warnings)
            for each, count in zip(wanted, halvings)
        ]
        tiles: list[int] = []
        entries = np.zeros(len(images) + sum(len(image.tiles or ()) for image in images), ImageEntry.numpy_dtype())
        next_entry, next_picture = len(images), iter(pictures)
        placed: list[tuple[int, _Picture | TiledPicture | None]] = []  # pictures, and their entries
        for row, image in enumerate(images):
            entries[row]["encoding"] = int(image.encoding)
            if image.tiles is None:
                placed.append((row, next(next_picture)))
                continue
            pixels_by_index = {number - FIRST_TILE: pixels for number, pixels in image.tiles}
            entries[row]["tile_first"] = len(tiles)
            entries[row]["tile_count"] = _rows_of(pixels_by_index) * int(TILE_COLUMNS)
            own = [-1] * int(entries[row]["tile_count"])
            for number, _ in image.tiles:
                entries[next_entry]["encoding"] = int(image.encoding)
                placed.append((next_entry, next(next_picture)))
                if 0 <= number - FIRST_TILE < len(own):
                    own[number - FIRST_TILE] = next_entry
                next_entry += 1
            tiles += own
        there = list(self._pictures.values())
        if any(isinstance(picture, TiledPicture) for picture in there):
            done.tiled = TileSource(device)
        entries = _described(entries, placed, done.tiled)
        done.bytes = sum(picture.bytes for picture in there) + entries.nbytes + 4 * len(tiles)
        done.level_bytes = sum(picture.level_bytes for picture in there)
        arrays = [each for picture in there for each in picture.arrays]
        return entries, np.array(tiles, np.int32), arrays

    def _picture(
        self, wanted: _Wanted, halvings: int, before: _Picture | TiledPicture | None, device, warnings: list[str]
    ) -> _Picture | TiledPicture:
        own = self._pictures.get(wanted.key) or before
        if own is None or own.source() is not wanted.pixels or own.halvings != halvings or own.device != device:
            own = _upload(wanted, halvings, device)
        self._pictures[wanted.key] = own
        if own.replaced:
            warnings.append(f"{wanted.label}: {own.replaced:,} texels are infinite or not a number; they are black")
        if halvings:
            height, width = wanted.pixels.shape[:2]
            warnings.append(
                f"{wanted.label} does not fit the memory of the device: it is scaled down from {width:,} x {height:,} "
                f"to {own.width:,} x {own.height:,} texels"
            )
        return own


def device_bytes_of(images: Sequence[Image]) -> int:
    """Memory of `images` on a device if none is made smaller [bytes]."""
    return sum({each.key: each.device_bytes for each in _wanted(images, []) if each is not None}.values())


def _rows_of(pixels_by_index) -> int:
    return (
        max((index for index in pixels_by_index if 0 <= index <= LAST_TILE - FIRST_TILE), default=-1)
        // int(TILE_COLUMNS)
        + 1
    )


def _described(
    entries: np.ndarray, placed: Sequence[tuple[int, _Picture | TiledPicture | None]], tiled: TileSource | None
) -> np.ndarray:
    """`entries` with the pictures of `placed` described in theirs, and more entries behind them for levels; those in
    tiles get their place in `tiled`.
    """
    rows: list[np.ndarray] = []
    for index, picture in placed:
        entry = entries[index]
        if picture is None:
            entry["texels"] = int(Texels.MISSING)
            continue
        whole, *levels = tiled.place(picture) if isinstance(picture, TiledPicture) else picture.parts()
        _describe(entry, whole)
        entry["tile_first"] = len(entries) + len(rows) if levels else 0
        for level in levels:
            rows.append(entry.copy())
            _describe(rows[-1], level)
            rows[-1]["tile_first"], rows[-1]["encoding"] = 0, picture.level_encoding
    return np.concatenate([entries, np.array(rows, entries.dtype)])


def _describe(entry: np.ndarray, part: Part) -> None:
    for name in ("address", "texels", "width", "height"):
        entry[name] = getattr(part, name)


def _wanted(images: Sequence[Image], warnings: list[str]) -> Iterator[_Wanted | None]:
    """All pictures in the order of the table; None for a picture that is missing or cannot be used."""
    for image in images:
        levels = image.levels if isinstance(image, FilteredImage) else ImageLevels.NONE
        for number, pixels in image.tiles if image.tiles is not None else ((0, image.pixels),):
            label = f"image “{image.name}”" + (f", tile {number}" if image.tiles is not None else "")
            if image.tiles is not None and not FIRST_TILE <= number <= LAST_TILE:
                warnings.append(f"{label}: tiles are numbered {FIRST_TILE} to {LAST_TILE}; it is left out")
                yield None
            elif pixels is None:
                yield None
            elif (
                pixels.ndim != 3
                or pixels.shape[2] not in (1, 3, 4)
                or pixels.dtype.name not in ("uint8", "float16", "float32")
            ):
                kind = f"{pixels.dtype}, shape {list(pixels.shape)}"
                warnings.append(f"{label} has pixels of a kind that is not understood ({kind}); it is magenta")
                yield None
            elif pixels.size == 0:
                warnings.append(f"{label} has no pixels; it is magenta")
                yield None
            else:
                channels = 1 if pixels.shape[2] == 1 else 4  # on a CPU, where all images fit, bytes may be three
                sizes = [pixels.shape[1::-1]] + (level_sizes(pixels.shape[1], pixels.shape[0]) if levels else [])
                texels = sum(int(width) * int(height) for width, height in sizes)
                slot_bytes = image.slot_bytes if isinstance(image, TiledImage) else 0
                if pixels.shape[0] * pixels.shape[1] * channels * pixels.itemsize <= slot_bytes:
                    slot_bytes = 0  # as a part of a tile it would take as much
                yield _Wanted(label, pixels, levels, image.encoding, texels * channels * pixels.itemsize, slot_bytes)


def _halvings(wanted: Sequence[_Wanted | None], budget: int | None) -> list[int]:
    """How many times each picture is halved in width and height: the largest first, until all that are not in tiles fit
    `budget`.
    """
    wanted = [None if each is None or each.slot_bytes else each for each in wanted]
    counts = [0] * len(wanted)
    sizes = [0 if each is None else each.device_bytes for each in wanted]
    for i, each in enumerate(wanted):
        while each is not None and each.pixels.shape[0] * each.pixels.shape[1] >> 2 * counts[i] > TEXELS_MAX:
            counts[i], sizes[i] = counts[i] + 1, sizes[i] // 4
    first = {
        each.key: i for i, each in reversed(list(enumerate(wanted))) if each is not None
    }  # one array may be there twice
    while budget is not None and first:
        if sum(sizes[i] for i in first.values()) <= budget:
            break
        able = [i for i in first.values() if min(wanted[i].pixels.shape[:2]) >> counts[i] > EDGE_LEAST]
        if not able:
            break
        largest = max(able, key=lambda i: sizes[i])
        counts[largest], sizes[largest] = counts[largest] + 1, sizes[largest] // 4
    return [0 if each is None else counts[first[each.key]] for each in wanted]


def _upload(wanted: _Wanted, halvings: int, device) -> _Picture | TiledPicture:
    pixels = wanted.pixels
    if wanted.slot_bytes:
        return tiled_picture(pixels, wanted.levels, wanted.encoding, wanted.slot_bytes, device)
    own, replaced = pixels, 0
    if pixels.dtype != np.uint8:
        own, replaced = finite_texels(pixels)
    for _ in range(halvings):
        own = halved(own)
    # three bytes take a quarter less memory, and on a CPU less time, than four; a GPU loads four at once
    many = own.size > TEXELS_MAX  # bytes, which Warp counts by an int32
    if own.shape[2] == 3 and (own.dtype != np.uint8 or device.is_cuda or many):
        own = with_alpha(own)
    height, width, channels = own.shape
    texels, dtype = TEXEL_KINDS[own.dtype.name, channels]
    array = uploaded_texels(own, dtype, device)
    levels, encoding = None, level_encoding(own.dtype, wanted.encoding)
    if wanted.levels and max(width, height) > 1:
        flat = np.concatenate(
            [each.reshape(-1, channels) for each in coarser_levels(own, wanted.encoding, wanted.levels)]
        )
        levels = uploaded_texels(flat, dtype, device)
    return _Picture(
        source=weakref.ref(pixels),
        halvings=halvings,
        texels=texels,
        width=width,
        height=height,
        array=array,
        replaced=replaced,
        levels=levels,
        level_encoding=encoding,
    )


def halved(pixels: np.ndarray) -> np.ndarray:
    """`pixels` [height, width, channels] at half the width and height, rounded up.

    A texel is the mean of a square of four, of the numbers as stored.
    """
    height, width = pixels.shape[:2]
    if height % 2 or width % 2:
        pixels = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    small = np.empty(((height + 1) // 2, (width + 1) // 2, pixels.shape[2]), pixels.dtype)
    block = 1024  # rows at a time, so that a large image is never whole as float32
    for first in range(0, len(small), block):
        part = pixels[2 * first : 2 * (first + block)].astype(np.float32) * np.float32(0.25)
        mean = part[0::2, 0::2] + part[1::2, 0::2] + part[0::2, 1::2] + part[1::2, 1::2]
        small[first : first + block] = np.rint(mean) if pixels.dtype == np.uint8 else mean
    return small
