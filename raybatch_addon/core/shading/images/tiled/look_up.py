"""Look-ups of pictures in tiles, and what tiles a look-up reads.

A picture in tiles has a row of 64-bit words: the address of its row of marks, and then of each tile, row by row from
the bottom, the address of its texels; 0: it is not on the device. Three marks of each tile say what was asked for
since the host looked last. Where a look-up of a surface finds no tile it counts that in the marks in front, and reads
black: the stage that fetches tiles has looked before (`wavefront/textures`), so that this would be a fault.

The texels of a look-up are those of `textures.py`, in the same order: the numbers are the same to the bit.
"""

import warp as wp

from ....scene.description import ImageEncoding
from ..textures import (
    ROOT,
    Extension,
    ImageEntry,
    ImageTable,
    Interpolation,
    image_place,
    level_count,
    near,
    srgb_to_linear,
    tap_weight,
    texel,
    without_alpha,
    wrapped,
)

# Bits of `ImageEntry.texels` of a picture in tiles: `Texels`, and above it how many bits of a column and of a row are
# those within a tile. Of other pictures these are 0
COLUMN_SHIFT, ROW_SHIFT, KIND_MASK = 8, 16, 255
# Marks of a tile: how often paths that wait need it, whether a path that did not wait read it, and whether the path
# that is to go on next needs it
WANTED, SEEN, PINNED, MARKS = 0, 1, 2, 3
# What is done with the tiles of a look-up: note that they are read, that a path waits for them, or that it is the next
SEE, WANT, PIN = 0, 1, 2

_CLOSEST = wp.constant(int(Interpolation.CLOSEST))
_LINEAR = wp.constant(int(Interpolation.LINEAR))
_REPEAT = wp.constant(int(Extension.REPEAT))
_SRGB = wp.constant(int(ImageEncoding.SRGB))
_MAGENTA = wp.constant(wp.vec4(1.0, 0.0, 1.0, 1.0))
_WHOLE = 31  # bits of a picture that is one tile


@wp.struct
class Taps:
    """The texels that a look-up reads, `count` along either axis, before coordinates are wrapped."""

    count: int
    column: int  # of the first
    row: int
    across: float  # how far the point is behind the last texel before it, in [0, 1)
    up: float


@wp.struct
class Tiles:
    """How a picture is divided."""

    column_bits: int
    row_bits: int
    columns: int  # tiles side by side
    count: int
    addresses: wp.array(dtype=wp.uint64)  # of its row; none where the picture is whole
    marks: wp.array(dtype=int)


@wp.func
def taps_of(image: ImageEntry, u: float, v: float, interpolation: int, extension: int) -> Taps:
    """The texels of a look-up at (u, v)."""
    taps = Taps()
    taps.count = 4
    first = int(-1)
    offset = float(0.5)
    if interpolation == _LINEAR:
        taps.count = 2
        first = 0
    elif interpolation == _CLOSEST:
        taps.count = 1
        first = 0
        offset = 0.0
    x = near(u, image.width, extension) * float(image.width) - offset
    y = near(v, image.height, extension) * float(image.height) - offset
    x_floor = wp.floor(x)
    y_floor = wp.floor(y)
    taps.column = int(x_floor) + first
    taps.row = int(y_floor) + first
    if extension == _REPEAT:
        taps.column = wrapped(taps.column, image.width, extension)
        taps.row = wrapped(taps.row, image.height, extension)
    taps.across = x - x_floor
    taps.up = y - y_floor
    return taps


@wp.func
def division_of(image: ImageEntry) -> Tiles:
    """How `image` is divided; where it is not, it is one tile without address."""
    tiles = Tiles()
    tiles.column_bits = (image.texels >> wp.static(COLUMN_SHIFT)) & wp.static(KIND_MASK)
    tiles.row_bits = image.texels >> wp.static(ROW_SHIFT)
    if tiles.column_bits == 0:
        tiles.column_bits = wp.static(_WHOLE)
        tiles.row_bits = wp.static(_WHOLE)
        tiles.columns = 1
        return tiles
    tiles.columns = ((image.width - 1) >> tiles.column_bits) + 1
    tiles.count = tiles.columns * (((image.height - 1) >> tiles.row_bits) + 1)
    tiles.addresses = wp.array(ptr=image.address, shape=(tiles.count + 1,), dtype=wp.uint64)
    tiles.marks = wp.array(ptr=tiles.addresses[0], shape=(wp.static(MARKS) * (tiles.count + 1),), dtype=int)
    return tiles


@wp.func
def entry_at(table: ImageTable, entry: int, level: int) -> ImageEntry:
    """The picture at `entry`, or a level of it; its last one where it has fewer."""
    image = table.entries[entry]
    if level > 0 and image.tile_first > 0:
        above = wp.min(level, level_count(image.width, image.height))
        image = table.entries[image.tile_first + above - 1]
    return image


@wp.func
def _interpolated(image: ImageEntry, u: float, v: float, interpolation: int, extension: int, sure: int) -> wp.vec4:
    """The picture's numbers at (u, v), as stored."""
    taps = taps_of(image, u, v, interpolation, extension)
    tiles = division_of(image)
    tile = ImageEntry()  # the one that was read last
    tile.address = image.address
    tile.width = image.width
    tile.height = image.height
    tile.texels = image.texels & wp.static(KIND_MASK)
    last = int(1)
    column_mask = int(-1)
    row_mask = int(-1)
    if tiles.count > 0:
        last = 0
        tile.width = 1 << tiles.column_bits
        tile.height = 1 << tiles.row_bits
        column_mask = tile.width - 1
        row_mask = tile.height - 1
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for j in range(taps.count):
        at_y = wrapped(taps.row + j, image.height, extension)
        if at_y >= 0:
            weight = tap_weight(j, taps.up, interpolation)
            for i in range(taps.count):
                at_x = wrapped(taps.column + i, image.width, extension)
                if at_x >= 0:
                    number = 1 + (at_y >> tiles.row_bits) * tiles.columns + (at_x >> tiles.column_bits)
                    if number != last:
                        last = number
                        tile.address = tiles.addresses[number]
                        if tile.address == wp.uint64(0) and sure != 0:
                            wp.atomic_add(tiles.marks, wp.static(WANTED), 1)
                    value = wp.vec4(0.0, 0.0, 0.0, 0.0)
                    if tile.address != wp.uint64(0):
                        value = texel(tile, at_x & column_mask, at_y & row_mask)
                    if image.encoding == wp.static(ROOT):
                        value = wp.vec4(value[0] * value[0], value[1] * value[1], value[2] * value[2], value[3])
                    total += (weight * tap_weight(i, taps.across, interpolation)) * value
    return total


@wp.func
def sample_tiled(
    table: ImageTable, index: int, level: int, uv: wp.vec2, interpolation: int, extension: int, divide: int, sure: int
) -> wp.vec4:
    """`sample_level` of an image that may have pictures in tiles. `sure`: 1 where its tiles were fetched before."""
    place = image_place(table, index, uv)
    if place.entry < 0:
        return _MAGENTA
    image = entry_at(table, place.entry, level)
    value = _interpolated(image, place.u, place.v, interpolation, extension, sure)
    if divide != 0:
        value = without_alpha(value)
    if image.encoding == _SRGB:
        value = wp.vec4(srgb_to_linear(value[0]), srgb_to_linear(value[1]), srgb_to_linear(value[2]), value[3])
    return value


@wp.func
def want_tiles(
    table: ImageTable, index: int, level: int, uv: wp.vec2, interpolation: int, extension: int, action: int
) -> int:
    """How many tiles that `sample_tiled` would read are not there. `action`, one of SEE, WANT and PIN, is noted in the
    marks of those that are there; WANT and PIN also of the others.
    """
    place = image_place(table, index, uv)
    if place.entry < 0:
        return 0
    image = entry_at(table, place.entry, level)
    tiles = division_of(image)
    if tiles.count == 0:
        return 0
    taps = taps_of(image, place.u, place.v, interpolation, extension)
    missing = int(0)
    last_row = int(-1)
    for j in range(taps.count):
        at_y = wrapped(taps.row + j, image.height, extension)
        row = at_y >> tiles.row_bits
        if at_y >= 0 and row != last_row:
            last_row = row
            last_column = int(-1)
            for i in range(taps.count):
                at_x = wrapped(taps.column + i, image.width, extension)
                column = at_x >> tiles.column_bits
                if at_x >= 0 and column != last_column:
                    last_column = column
                    number = 1 + row * tiles.columns + column
                    if tiles.addresses[number] == wp.uint64(0):
                        missing += 1
                    if action == wp.static(SEE):
                        tiles.marks[wp.static(MARKS) * number + wp.static(SEEN)] = 1
                    else:
                        wp.atomic_add(tiles.marks, wp.static(MARKS) * number + wp.static(WANTED), 1)
                    if action == wp.static(PIN):
                        tiles.marks[wp.static(MARKS) * number + wp.static(PINNED)] = 1
    return missing
