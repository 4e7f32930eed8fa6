"""Blender's images as the core's, each read once and kept while it does not change.

Cycles' treatment of alpha and colour spaces was measured on Blender 5.2, and is followed to the rounding:

- Alpha is multiplied into colours where the image's alpha mode is Straight and it holds colours, at the image's own
  precision and before any conversion. Floating-point images that are packed or generated get that on top of what
  Blender itself did.
- sRGB and the scene's linear space stay as they are stored; bytes of any other space become half-precision numbers.
"""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.scene.description import Image, ImageEncoding
from ...core.scene.frozen import freeze
from .color_spaces import CannotConvertNow, SpaceKind, space_kind, to_scene_linear, working_space
from .files import frame_number, sequence_path, stored_bytes, stored_pixels, tile_path

KEPT_SECONDS = 600.0  # images that no export has used for this long are dropped
_HALF_MAX = 65504.0
_ROWS = 16  # of an image that are worked on at a time


@dataclass
class _Kept:
    """An exported image, and the properties that it was made from."""

    signature: tuple
    image: Image
    notes: tuple[str, ...]
    used: float  # time of its last use [s]


_kept: dict[tuple, _Kept] = {}


def image_key(image: bpy.types.Image | None, user: bpy.types.ImageUser | None, frame: int) -> tuple:
    """Key of an image at the scene's frame `frame`; `user` is the node's `ImageUser`."""
    if image is None:
        return (0,)
    number = frame_number(user, frame) if image.source in ("SEQUENCE", "MOVIE") else 0
    return (image.session_uid, number) if hasattr(image, "session_uid") else (image.as_pointer(), number)


def export_image(
    image: bpy.types.Image | None, user: bpy.types.ImageUser | None, frame: int
) -> tuple[Image, tuple[str, ...]]:
    """`image` at the scene's frame `frame`, and messages about its defects."""
    if image is None:
        return Image("none"), ()  # texture nodes treat a missing image themselves
    _make_pixels(image)
    key, now = image_key(image, user, frame), time.monotonic()
    signature = _signature(image, user, frame)
    kept = _kept.get(key)
    if kept is None or kept.signature != signature or image.is_dirty:
        try:
            exported, notes = _exported(image, user, frame, space_kind(image.colorspace_settings))
        except CannotConvertNow:  # not kept, since the next time may succeed
            return _exported(image, user, frame, SpaceKind.UNKNOWN)
        except MemoryError:
            exported, notes = (
                Image(image.name),
                (f"image “{image.name}” does not fit in memory: it is magenta; make it smaller",),
            )
        if kept is not None and _same(kept.image, exported):
            exported = kept.image  # the device has it already
        for pixels in [exported.pixels] if exported.tiles is None else [pixels for _, pixels in exported.tiles]:
            if pixels is not None:
                freeze(pixels)
        for old in [each for each, what in _kept.items() if now - what.used > KEPT_SECONDS]:
            del _kept[old]
        kept = _kept[key] = _Kept(signature, exported, notes, now)
    kept.used = now
    return kept.image, kept.notes


def forget_images() -> None:
    """Drop all images that are kept."""
    _kept.clear()


def divides_alpha(image: bpy.types.Image | None) -> bool:
    """Whether colours are divided by alpha where the texture's alpha is used."""
    return (
        image is not None
        and image.alpha_mode not in ("CHANNEL_PACKED", "NONE")
        and not image.colorspace_settings.is_data
    )


def _make_pixels(image: bpy.types.Image) -> None:
    """Let Blender make the pixels of an image that has none yet and no colour space: it gets one with its pixels, such
    as that which stands in for an image of a library that is gone.
    """
    if not image.colorspace_settings.name:
        _ = image.size[0]


def _signature(image: bpy.types.Image, user: bpy.types.ImageUser | None, frame: int) -> tuple:
    """Properties that the exported image depends on: while they are the same, the image is."""
    packed = tuple(
        (each.packed_file.size, zlib.crc32(each.packed_file.data)) for each in image.packed_files if each.packed_file
    )
    files = () if packed else tuple((path, _stamp(path)) for path in _paths(image, user, frame))
    generated = (
        image.generated_type,
        image.generated_width,
        image.generated_height,
        image.use_generated_float,
        *image.generated_color,
    )
    return (
        image.name,
        image.source,
        image.alpha_mode,
        image.colorspace_settings.name,
        working_space(),
        packed,
        files,
        generated if image.source == "GENERATED" else None,
        tuple(tile.number for tile in image.tiles) if image.source == "TILED" else None,
    )


def _paths(image: bpy.types.Image, user: bpy.types.ImageUser | None, frame: int) -> list[str]:
    if image.source == "SEQUENCE":
        return [sequence_path(image, frame_number(user, frame))]
    if image.source == "TILED":
        return [tile_path(image, tile.number) for tile in image.tiles]
    return [bpy.path.abspath(image.filepath, library=image.library)] if image.filepath else []


def _stamp(path: str) -> tuple[int, int]:
    try:
        state = Path(path).stat()
    except OSError:
        return (0, 0)
    return (state.st_mtime_ns, state.st_size)


def _same(a: Image, b: Image) -> bool:
    if (a.name, a.encoding, a.tiles is None) != (b.name, b.encoding, b.tiles is None):
        return False
    if a.tiles is None or b.tiles is None:
        return _same_pixels(a.pixels, b.pixels)
    return len(a.tiles) == len(b.tiles) and all(
        m == n and _same_pixels(p, q) for (m, p), (n, q) in zip(a.tiles, b.tiles)
    )


def _same_pixels(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype != np.uint8)


# --- pixels


def _exported(
    image: bpy.types.Image, user: bpy.types.ImageUser | None, frame: int, kind: SpaceKind
) -> tuple[Image, tuple[str, ...]]:
    notes: list[str] = []
    label = f"image “{image.name}”"
    unknown = kind is SpaceKind.UNKNOWN
    if unknown:
        kind = SpaceKind.LINEAR
    if image.source == "MOVIE":
        notes.append(
            f"{label} is a movie: only the frame that Blender has read is rendered; save its frames as an image "
            "sequence"
        )
    if image.source == "TILED":
        tiles, encoding = [], ImageEncoding.LINEAR
        for tile in image.tiles:
            file = tile_path(image, tile.number)
            pixels, encoding = _picture(image, kind, file, tile.number)
            if pixels is None:
                notes.append(
                    f"{label}, tile {tile.number}, has no pixels"
                    + (f", or {file} cannot be read" if file else "")
                    + ": it is magenta"
                )
            tiles.append((tile.number, pixels))
        if unknown and any(pixels is not None for _, pixels in tiles):
            notes.append(_unknown_space(image))
        return Image(image.name, None, encoding, tuple(tiles)), tuple(notes)
    path = sequence_path(image, frame_number(user, frame)) if image.source == "SEQUENCE" else None
    pixels, encoding = _picture(image, kind, path)
    if pixels is None:
        where = path or bpy.path.abspath(image.filepath, library=image.library)
        notes.append(f"{label} has no pixels" + (f", or {where} cannot be read" if where else "") + ": it is magenta")
    elif unknown:
        notes.append(_unknown_space(image))
    return Image(image.name, pixels, encoding), tuple(notes)


def _unknown_space(image: bpy.types.Image) -> str:
    name = image.colorspace_settings.name
    return f"image “{image.name}”: its colour space “{name}” cannot be converted; it is taken as linear"


def _picture(
    image: bpy.types.Image, kind: SpaceKind, path: str | None, tile: int = 0
) -> tuple[np.ndarray | None, ImageEncoding]:
    """Pixels and encoding of the image, or of the file at `path` that is part of it; None if there are no pixels."""
    straight = image.alpha_mode == "STRAIGHT" and kind is not SpaceKind.DATA
    from_file = image.source in ("FILE", "SEQUENCE", "TILED") and not image.packed_files and not image.is_dirty
    encoding = ImageEncoding.SRGB if kind is SpaceKind.SRGB else ImageEncoding.LINEAR

    def read(raw: bool) -> tuple[np.ndarray | None, bool]:
        return stored_pixels(image, path, tile, raw)

    # the colours of others are divided by alpha as Blender reads them
    own = stored_bytes(image) if path is None and not tile and image.alpha_mode != "PREMUL" else None
    pixels, is_float = read(raw=False) if own is None else (None, False)
    if own is None and pixels is None:
        return None, encoding
    if not is_float:
        if own is None:
            assert pixels is not None
            if image.alpha_mode == "PREMUL" and from_file and kind is not SpaceKind.DATA:
                raw, _ = read(raw=True)  # with the colours that Blender has divided out
                pixels = pixels if raw is None else raw
            own = _as_bytes(pixels)
        if kind is SpaceKind.OTHER:
            return _compact(_converted(own, image), image), ImageEncoding.LINEAR
        if straight:
            _multiply_bytes(own)
        return _compact(own, image), encoding
    assert pixels is not None  # floats were read
    if not from_file:
        if straight and pixels.shape[2] == 4:
            pixels[..., :3] *= pixels[..., 3:]
        return _compact(pixels, image), ImageEncoding.LINEAR
    if kind is SpaceKind.SRGB or (kind is SpaceKind.LINEAR and straight):
        raw, _ = read(raw=True)
        if raw is not None:
            if straight and raw.shape[2] == 4:
                raw = _multiplied(raw, image.file_format == "PNG")
            return _compact(raw, image), encoding
    return _compact(pixels, image), ImageEncoding.LINEAR


def _as_bytes(pixels: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1 as bytes; overwrites `pixels`, block by block, so that they are in the cache meanwhile."""
    own = np.empty(pixels.shape, np.uint8)
    for first in range(0, len(pixels), _ROWS):
        block = pixels[first : first + _ROWS]
        np.multiply(block, np.float32(255.0), out=block)
        np.rint(block, out=block)
        own[first : first + _ROWS] = block
    return own


def _multiply_bytes(pixels: np.ndarray) -> None:
    """Multiply alpha into the colours of bytes, rounded down; opaque rows stay as they are."""
    for first in range(0, len(pixels), _ROWS):
        block = pixels[first : first + _ROWS]
        alpha = block[..., 3:]
        if alpha.min(initial=255) == 255:
            continue
        product = block[..., :3] * alpha.astype(np.uint16)
        # product // 255 for products of two bytes, without a division
        block[..., :3] = (product + np.uint16(1) + (product >> np.uint16(8))) >> np.uint16(8)


def _multiplied(pixels: np.ndarray, sixteen_bit: bool) -> np.ndarray:
    """`pixels` with alpha multiplied into colours, in whole numbers where files have such."""
    if not sixteen_bit:
        return np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], 2)
    whole = np.rint(pixels * 65535.0).astype(np.uint64)
    whole[..., :3] = whole[..., :3] * whole[..., 3:] // 65535
    return (whole / np.float32(65535.0)).astype(np.float32)


def _converted(pixels: np.ndarray, image: bpy.types.Image) -> np.ndarray:
    """Bytes of another colour space as half-precision numbers of the scene's, rounded where Cycles rounds.

    Alpha is divided out of the colours meanwhile. It goes through the conversion with them, and gets its rounding too.
    """
    values = (pixels / np.float32(255.0)).astype(np.float16).astype(np.float32)
    colors, alpha = values[..., :3], values[..., 3:]
    if image.alpha_mode == "STRAIGHT":
        colors[:] = (colors * alpha).astype(np.float16)
    divides = divides_alpha(image)
    if divides:
        colors *= np.float32(1.0) / np.where(alpha == 0, np.float32(1.0), alpha)
    values = to_scene_linear(values, image.colorspace_settings.name)
    if divides:
        values[..., :3] *= np.where(values[..., 3:] == 0, np.float32(1.0), values[..., 3:])
    return np.clip(values, -_HALF_MAX, _HALF_MAX).astype(np.float16)


def _is_grey(pixels: np.ndarray) -> bool:
    return np.array_equal(pixels[..., 0], pixels[..., 1]) and np.array_equal(pixels[..., 0], pixels[..., 2])


def _compact(pixels: np.ndarray, image: bpy.types.Image) -> np.ndarray:
    """`pixels` in as few bytes as hold them exactly.

    Grey images get one channel, opaque bytes three, and numbers that half precision holds become half-precision
    numbers.
    """
    channels = pixels.shape[2]
    one = 255 if pixels.dtype == np.uint8 else 1
    if channels == 2:
        pixels = np.concatenate([pixels, np.zeros_like(pixels[..., :1]), np.full_like(pixels[..., :1], one)], 2)
    if channels == 4 and image.alpha_mode == "NONE":
        pixels[..., 3] = one
    if pixels.shape[2] > 1 and _is_grey(pixels[::_ROWS]) and _is_grey(pixels):
        if pixels.shape[2] == 3 or np.all(pixels[..., 3] == one):
            pixels = pixels[..., :1]
    if pixels.dtype == np.uint8 and pixels.shape[2] == 4 and np.all(pixels[..., 3] == one):
        pixels = pixels[..., :3]
    if pixels.dtype == np.float32:
        with np.errstate(over="ignore"):
            half = pixels.astype(np.float16)
        if np.array_equal(half.astype(np.float32), pixels, equal_nan=True):
            pixels = half
    return np.ascontiguousarray(pixels)
