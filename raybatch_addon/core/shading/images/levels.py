"""Levels of an image: ever smaller pictures of it, each texel the mean light of the area that it covers.

A level has half the width and height of the one before, rounded down, until there is one texel. Where a size is odd, a
texel covers parts of three of the level before, by the areas that overlap. Means are of linear light, in float32, from
level to level, and look-ups of levels interpolate linear light: at the sRGB curve a mean of neighbours would be darker
the smaller the level is. Levels of bytes are bytes, rounded to the nearest, ties to even; of an image with the sRGB
curve they are square roots of linear light, which has finer steps in the dark and takes one product to undo.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ...device.bulk import in_slices
from ...scene.description import Image, ImageEncoding
from .textures import ROOT

_BLOCK = 32  # rows of a level that a thread makes at a time, so that no large image is whole as float32


class ImageLevels(IntEnum):
    """Whether an image has levels, and what its colours are."""

    NONE = 0
    PLAIN = 1  # its own numbers, whatever alpha is
    DIVIDED = 2  # alpha is divided out where textures look them up, so it is before means of light are taken


@dataclass(frozen=True)
class FilteredImage(Image):
    """An image with levels."""

    levels: ImageLevels = ImageLevels.PLAIN


def level_encoding(dtype: np.dtype, encoding: ImageEncoding) -> int:
    """The encoding of the levels of an image: `ROOT`, or linear."""
    return ROOT if dtype == np.uint8 and encoding is ImageEncoding.SRGB else int(ImageEncoding.LINEAR)


def level_sizes(width: int, height: int) -> list[tuple[int, int]]:
    """Widths and heights of the levels above a picture [texels]."""
    sizes = []
    while max(width, height) > 1:
        width, height = max(width // 2, 1), max(height // 2, 1)
        sizes.append((width, height))
    return sizes


def coarser_levels(pixels: np.ndarray, encoding: ImageEncoding, levels: ImageLevels) -> list[np.ndarray]:
    """The levels above `pixels` [height, width, 1, 3 or 4], of the same type and channels; texels have to be finite."""
    height, width, channels = pixels.shape
    divided = levels is ImageLevels.DIVIDED and channels == 4
    made: list[np.ndarray] = []
    before: np.ndarray | None = None
    for wide, high in level_sizes(width, height):
        linear = np.empty((high, wide, channels), np.float32)
        level = np.empty((high, wide, channels), pixels.dtype)
        _fill_level(pixels, linear, level, before, encoding, divided)
        before = linear
        made.append(level)
    return made


def _fill_level(
    pixels: np.ndarray,
    linear: np.ndarray,
    level: np.ndarray,
    before: np.ndarray | None,
    encoding: ImageEncoding,
    divided: bool,
) -> None:
    """Make a level by threads: `linear`, its light, and `level`, the same as it is stored. `before` is the light of the
    one below, None where that is the picture, `pixels`.
    """
    below = len(pixels) if before is None else len(before)

    def fill(rows: slice) -> None:
        count = rows.stop - rows.start
        first = 2 * rows.start if below > 1 else 0
        own = slice(first, first + 2 * count + 1)
        part = _light(pixels[own], encoding, divided) if before is None else before[own]
        linear[rows] = _halved_columns(_halved_rows(part, rows.start, count, below))
        level[rows] = _stored(linear[rows], pixels.dtype, encoding)

    in_slices(len(level), fill, _BLOCK)


def _halved_rows(part: np.ndarray, first: int, count: int, rows: int) -> np.ndarray:
    """`count` rows from `first` on of a picture of `rows` rows at half the height; `part` begins at row 2 `first`."""
    if rows == 1:
        return part[:1]
    upper, lower = part[0 : 2 * count : 2], part[1 : 2 * count : 2]
    if rows % 2 == 0:
        return np.float32(0.5) * (upper + lower)
    half = rows // 2
    i = np.arange(first, first + count, dtype=np.float32)[:, None, None]
    before, behind = 1 - i / np.float32(half), (i + 1) / np.float32(half)
    return (before * upper + lower + behind * part[2 : 2 * count + 1 : 2]) * np.float32(half / rows)


def _halved_columns(picture: np.ndarray) -> np.ndarray:
    turned = picture.transpose(1, 0, 2)
    return _halved_rows(turned, 0, max(len(turned) // 2, 1), len(turned)).transpose(1, 0, 2)


def _light(pixels: np.ndarray, encoding: ImageEncoding, divided: bool) -> np.ndarray:
    """Linear light of stored numbers, float32, with alpha multiplied in where it is divided out."""
    if pixels.dtype == np.uint8 and not (divided and pixels[..., 3].min(initial=255) < 255):
        own = np.empty(pixels.shape, np.float32)
        table = np.arange(256, dtype=np.float32) / np.float32(255)
        colors = _decoded(table) if encoding is ImageEncoding.SRGB else table
        if pixels.shape[2] == 1:
            return np.take(colors, pixels, mode="clip")
        np.take(colors, pixels, out=own, mode="clip")
        own[..., 3:] = table[pixels[..., 3:]]
        return own
    own = pixels / np.float32(255) if pixels.dtype == np.uint8 else pixels.astype(np.float32)
    if encoding is ImageEncoding.SRGB:
        colors = own[..., :3]
        weight = np.where(own[..., 3:] == 0, np.float32(1), own[..., 3:]) if divided else np.float32(1)
        own[..., :3] = _decoded(colors / weight) * weight
    return own


def _stored(linear: np.ndarray, dtype: np.dtype, encoding: ImageEncoding) -> np.ndarray:
    """Linear light as levels store it, by `level_encoding`."""
    if dtype != np.uint8:
        most = np.finfo(dtype).max  # what is brighter as light than half floats count
        return np.clip(linear, -most, most).astype(dtype)
    own = np.clip(linear, 0, 1)
    if encoding is ImageEncoding.SRGB:
        own[..., :3] = np.sqrt(own[..., :3])
    return np.rint(own * np.float32(255)).astype(np.uint8)


def _decoded(x: np.ndarray) -> np.ndarray:
    x = np.maximum(x, 0)
    return np.where(
        x < 0.04045, x / np.float32(12.92), ((x + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    )
