"""Images on the device and their look-up, as in Cycles: texel centres are at half-integer coordinates.

Interpolation works on the numbers as they are stored. Alpha is divided out before the sRGB transfer function is undone.
No look-up gives a number that is not finite, whatever the coordinates.
"""

from enum import IntEnum

import warp as wp

from ...scene.description import ImageEncoding


class Interpolation(IntEnum):
    """Interpolation between texels."""

    CLOSEST = 0
    LINEAR = 1
    CUBIC = 2  # uniform cubic B-spline, which also blurs


class Extension(IntEnum):
    """Look-up beyond the image's edges."""

    REPEAT = 0
    EXTEND = 1  # the outermost texels
    CLIP = 2  # transparent black
    MIRROR = 3


class Texels(IntEnum):
    """Storage of an image's texels: one or four numbers each, or three bytes, which are opaque."""

    MISSING = 0
    BYTE = 1
    BYTE4 = 2
    HALF = 3
    HALF4 = 4
    FLOAT = 5
    FLOAT4 = 6
    BYTE3 = 7


# Encoding of levels: square roots of linear light, undone before texels are interpolated
ROOT = len(ImageEncoding)


@wp.struct
class ImageEntry:
    """One picture, or the tiles of one."""

    address: wp.uint64  # address of the texels, row by row from the bottom
    width: int  # [texels]
    height: int
    texels: int  # `Texels`
    encoding: int  # `ImageEncoding`; of levels also `ROOT`
    # index of tile 1001 in `ImageTable.tiles`; of one picture the entry of its first level, 0: it has no levels
    tile_first: int
    tile_count: int  # entries in `ImageTable.tiles`, 10 a row of UDIM; 0: the image has no tiles


@wp.struct
class ImageTable:
    """All images of a scene."""

    entries: wp.array(dtype=ImageEntry)  # images in the scene's order, their tiles, and levels of pictures
    tiles: wp.array(dtype=int)  # entry of a tile; -1: there is none


_CLOSEST = wp.constant(int(Interpolation.CLOSEST))
_LINEAR = wp.constant(int(Interpolation.LINEAR))
_REPEAT = wp.constant(int(Extension.REPEAT))
_EXTEND = wp.constant(int(Extension.EXTEND))
_CLIP = wp.constant(int(Extension.CLIP))
_MISSING = wp.constant(int(Texels.MISSING))
_BYTE = wp.constant(int(Texels.BYTE))
_BYTE3 = wp.constant(int(Texels.BYTE3))
_BYTE4 = wp.constant(int(Texels.BYTE4))
_HALF = wp.constant(int(Texels.HALF))
_HALF4 = wp.constant(int(Texels.HALF4))
_FLOAT = wp.constant(int(Texels.FLOAT))
_SRGB = wp.constant(int(ImageEncoding.SRGB))

# Tiles of one row of UDIM
TILE_COLUMNS = wp.constant(10)
# From this many texels on a count may not fit an int32
_FAR = wp.constant(2.0**30)
_MAGENTA = wp.constant(wp.vec4(1.0, 0.0, 1.0, 1.0))  # Blender's colour of a missing image


@wp.func
def srgb_to_linear(x: float) -> float:
    """The number of which `x` is the sRGB encoding (IEC 61966-2-1); 0 for x below 0."""
    if x < 0.04045:
        return wp.max(x, 0.0) / 12.92
    return wp.pow((x + 0.055) / 1.055, 2.4)


@wp.func
def _half(bits: wp.uint64) -> float:
    """The half-precision number of the lowest 16 bits."""
    return float(wp.cast(wp.uint16(bits & wp.uint64(65535)), wp.float16))


@wp.func
def _texel(image: ImageEntry, x: int, y: int) -> wp.vec4:
    """The texel of column `x` and row `y`, as stored; a single number is in all three colours."""
    count = image.width * image.height
    at = y * image.width + x
    if image.texels == _BYTE4:
        word = wp.array(ptr=image.address, shape=(count,), dtype=wp.uint32)[at]  # one load for four numbers
        scale = wp.static(1.0 / 255.0)
        mask = wp.uint32(255)
        return wp.vec4(
            float(word & mask) * scale,
            float((word >> wp.uint32(8)) & mask) * scale,
            float((word >> wp.uint32(16)) & mask) * scale,
            float(word >> wp.uint32(24)) * scale,
        )
    if image.texels == _BYTE3:
        # addressed by the texel, since the bytes of a picture may be more than an int32 counts
        first = image.address + wp.uint64(at) * wp.uint64(3)
        parts = wp.array(ptr=first, shape=(3,), dtype=wp.uint8)
        scale = wp.static(1.0 / 255.0)
        return wp.vec4(float(parts[0]) * scale, float(parts[1]) * scale, float(parts[2]) * scale, 1.0)
    if image.texels == _HALF4:
        pairs = wp.array(ptr=image.address, shape=(count,), dtype=wp.uint64)[at]
        return wp.vec4(
            _half(pairs), _half(pairs >> wp.uint64(16)), _half(pairs >> wp.uint64(32)), _half(pairs >> wp.uint64(48))
        )
    grey = float(0.0)
    if image.texels == _BYTE:
        grey = float(wp.array(ptr=image.address, shape=(count,), dtype=wp.uint8)[at]) * wp.static(1.0 / 255.0)
    elif image.texels == _HALF:
        grey = float(wp.array(ptr=image.address, shape=(count,), dtype=wp.float16)[at])
    elif image.texels == _FLOAT:
        grey = wp.array(ptr=image.address, shape=(count,), dtype=float)[at]
    else:
        return wp.array(ptr=image.address, shape=(count,), dtype=wp.vec4)[at]
    return wp.vec4(grey, grey, grey, 1.0)


@wp.func
def _near(x: float, size: int, extension: int) -> float:
    """A coordinate at which the image is the same as at `x`, near enough to count `size` texels in an int32.

    0 where `x` is not finite.
    """
    near = float(x)
    if extension == _EXTEND or extension == _CLIP:
        # cubic interpolation reads two texels to each side, and an image has at least one
        near = wp.clamp(x, -4.0, 5.0)
    elif wp.abs(x) * float(size) > _FAR:
        near = x - 2.0 * wp.floor(0.5 * x)  # mirrored images repeat after two
    if not wp.isfinite(x) or not wp.isfinite(near):
        near = 0.0
    return near


@wp.func
def _wrapped(i: int, size: int, extension: int) -> int:
    """Index of the texel that is seen at index `i` of `size`; -1: none."""
    if i >= 0 and i < size:
        return i
    if extension == _CLIP:
        return -1
    if extension == _EXTEND:
        return wp.clamp(i, 0, size - 1)
    if extension == _REPEAT:
        rest = i % size
        if rest < 0:
            rest += size
        return rest
    up = i
    if i < 0:
        up = -1 - i
    rest = up % (2 * size)
    if rest >= size:
        rest = 2 * size - 1 - rest
    return rest


@wp.func
def _tap_weight(k: int, t: float, interpolation: int) -> float:
    """Weight of the k-th texel, at `t` in [0, 1) behind the last one before the point."""
    if interpolation == _CLOSEST:
        return 1.0
    if interpolation == _LINEAR:
        if k == 0:
            return 1.0 - t
        return t
    s = 1.0 - t
    if k == 0:
        return s * s * s / 6.0
    if k == 1:
        return (0.5 * t - 1.0) * t * t + wp.static(2.0 / 3.0)
    if k == 2:
        return (0.5 * s - 1.0) * s * s + wp.static(2.0 / 3.0)
    return t * t * t / 6.0


@wp.func
def _without_alpha(value: wp.vec4) -> wp.vec4:
    """Colours divided by alpha, where that is neither 0 nor 1."""
    alpha = value[3]
    if alpha == 0.0 or alpha == 1.0:
        return value
    divided = wp.vec4(value[0] / alpha, value[1] / alpha, value[2] / alpha, alpha)
    if wp.isfinite(divided[0]) and wp.isfinite(divided[1]) and wp.isfinite(divided[2]):
        return divided
    return value


def _picture_functions(levels: bool) -> wp.Function:
    """Function (image, u, v, interpolation, extension, divide) -> vec4 of pictures, or of pictures and levels."""

    def interpolated(image: ImageEntry, u: float, v: float, interpolation: int, extension: int) -> wp.vec4:
        """The image's numbers at (u, v), as stored.

        One loop instead of a branch for each interpolation keeps the code small.
        """
        count = int(4)
        first = int(-1)
        offset = float(0.5)
        if interpolation == _LINEAR:
            count = 2
            first = 0
        elif interpolation == _CLOSEST:
            count = 1
            first = 0
            offset = 0.0
        x = _near(u, image.width, extension) * float(image.width) - offset
        y = _near(v, image.height, extension) * float(image.height) - offset
        x_floor = wp.floor(x)
        y_floor = wp.floor(y)
        column = int(x_floor) + first
        row = int(y_floor) + first
        if extension == _REPEAT:
            column = _wrapped(column, image.width, extension)
            row = _wrapped(row, image.height, extension)
        total = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for j in range(count):
            at_y = _wrapped(row + j, image.height, extension)
            if at_y >= 0:
                weight = _tap_weight(j, y - y_floor, interpolation)
                for i in range(count):
                    at_x = _wrapped(column + i, image.width, extension)
                    if at_x >= 0:
                        texel = _texel(image, at_x, at_y)
                        if wp.static(levels):
                            if image.encoding == wp.static(ROOT):
                                texel = wp.vec4(texel[0] * texel[0], texel[1] * texel[1], texel[2] * texel[2], texel[3])
                        total += (weight * _tap_weight(i, x - x_floor, interpolation)) * texel
        return total

    # Warp takes functions of one name for the same
    interpolated.__name__ = interpolated.__qualname__ = "interpolated_level" if levels else "interpolated"
    interpolated = wp.func(interpolated)

    def sample(image: ImageEntry, u: float, v: float, interpolation: int, extension: int, divide: int) -> wp.vec4:
        """Linear RGB and alpha of a picture. `divide`: 1 if alpha is to be divided out of the colours."""
        value = interpolated(image, u, v, interpolation, extension)
        if divide != 0:
            value = _without_alpha(value)
        if image.encoding == _SRGB:
            value = wp.vec4(srgb_to_linear(value[0]), srgb_to_linear(value[1]), srgb_to_linear(value[2]), value[3])
        return value

    sample.__name__ = sample.__qualname__ = "sampled_level" if levels else "sampled"
    return wp.func(sample)


_sample_picture = _picture_functions(levels=False)
_sample_level = _picture_functions(levels=True)


@wp.struct
class ImagePlace:
    """Where a picture is looked up."""

    entry: int  # of the picture; -1: there is none
    u: float  # coordinates in the picture
    v: float


@wp.func
def image_place(table: ImageTable, index: int, uv: wp.vec2) -> ImagePlace:
    """The picture of image `index` at `uv`: a tile, where it has tiles."""
    place = ImagePlace()
    place.entry = -1
    place.u = uv[0]
    place.v = uv[1]
    if index < 0 or index >= table.entries.shape[0]:
        return place
    at = int(index)
    tile_count = table.entries[index].tile_count
    if tile_count > 0:
        # truncated, not rounded down: a coordinate a little below 0 belongs to the first tile, as in Cycles
        if not (place.u > -1.0 and place.u < float(TILE_COLUMNS) and place.v > -1.0 and place.v < float(tile_count)):
            return place
        column = int(place.u)
        row = int(place.v)
        tile = row * TILE_COLUMNS + column
        if tile >= tile_count:
            return place
        at = table.tiles[table.entries[index].tile_first + tile]
        place.u -= float(column)
        place.v -= float(row)
    if at >= 0:
        if table.entries[at].texels == _MISSING:
            at = -1
    place.entry = at
    return place


@wp.func
def sample_image(
    table: ImageTable, index: int, uv: wp.vec2, interpolation: int, extension: int, divide: int
) -> wp.vec4:
    """Linear RGB and alpha of image `index` at `uv`, (0, 0) being its bottom left corner; magenta where it is missing.

    `divide`: 1 if alpha is to be divided out of the colours.
    """
    place = image_place(table, index, uv)
    if place.entry < 0:
        return _MAGENTA
    return _sample_picture(table.entries[place.entry], place.u, place.v, interpolation, extension, divide)


@wp.func
def level_count(width: int, height: int) -> int:
    """How many levels a picture of this size has."""
    rest = wp.max(width, height)
    count = int(0)
    while rest > 1:
        rest = rest >> 1
        count += 1
    return count


@wp.func
def footprint_level(table: ImageTable, index: int, uv: wp.vec2, area: float, chance: float) -> int:
    """The level of image `index` for a footprint of `area` at `uv`, in squares of image coordinates.

    A texel of the level has the area of the footprint. Between two levels `chance`, random in [0, 1), decides by how
    near they are.
    """
    place = image_place(table, index, uv)
    if place.entry < 0:
        return 0
    image = table.entries[place.entry]
    texels = area * float(image.width) * float(image.height)
    if image.tile_first <= 0 or not texels > 1.0:  # also where it is no number
        return 0
    top = level_count(image.width, image.height)
    return int(wp.min(0.5 * wp.log2(texels) + chance, float(top)))


@wp.func
def sample_level(
    table: ImageTable, index: int, level: int, uv: wp.vec2, interpolation: int, extension: int, divide: int
) -> wp.vec4:
    """`sample_image` of a level of the image; its last one where it has fewer."""
    place = image_place(table, index, uv)
    if place.entry < 0:
        return _MAGENTA
    image = table.entries[place.entry]
    if level > 0 and image.tile_first > 0:
        above = wp.min(level, level_count(image.width, image.height))
        image = table.entries[image.tile_first + above - 1]
    return _sample_level(image, place.u, place.v, interpolation, extension, divide)


# What look-ups of tiles share (`tiled/look_up.py`): renamed, the code of all kernels with images would be another
texel, near, wrapped, tap_weight, without_alpha = _texel, _near, _wrapped, _tap_weight, _without_alpha
