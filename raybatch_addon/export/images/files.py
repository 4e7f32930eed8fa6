"""Files and pixels of image datablocks: frames of sequences, tiles, and numbers as a file stores them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePath

import bpy
import imbuf
import numpy as np

_HEAD_LENGTH = 32  # bytes of a file that show its kind


def frame_number(user: bpy.types.ImageUser | None, frame: int) -> int:
    """The frame of a sequence or movie that `user`, an `ImageUser`, shows at the scene's frame `frame`."""
    if user is None or user.frame_duration <= 0:
        return 0
    length = user.frame_duration
    shown = frame - user.frame_start + 1
    if user.use_cyclic:
        shown = shown % length or length
    return min(max(shown, 0), length) + user.frame_offset


def sequence_path(image: bpy.types.Image, number: int) -> str:
    """The file of frame `number`: it replaces the last digits of the image's own file name."""
    path = bpy.path.abspath(image.filepath, library=image.library)
    name = PurePath(path).name
    digits = list(re.finditer(r"\d+", PurePath(name).stem))
    if not digits:
        return path
    first, last = digits[-1].span()
    return path[: len(path) - len(name)] + name[:first] + str(number).zfill(last - first) + name[last:]


def tile_path(image: bpy.types.Image, tile: int) -> str:
    """The file of a UDIM tile; "" if the image has none."""
    return _tile_name(bpy.path.abspath(image.filepath, library=image.library), tile)


def _tile_name(name: str, tile: int) -> str:
    index = tile - 1001
    return name.replace("<UDIM>", str(tile)).replace("<UVTILE>", f"u{index % 10 + 1}_v{index // 10 + 1}")


def stored_pixels(image: bpy.types.Image, path: str | None, tile: int, raw: bool) -> tuple[np.ndarray | None, bool]:
    """Pixels, float32 [height, width, channels] from the bottom, and whether they are floating-point ones.

    The pixels are None if there are none.

    Args:
        path: a file to read with the image's settings, instead of what the image itself shows.
        tile: number of the tile if the image is a UDIM; 0: it is not.
        raw: pixels as the file stores them, neither converted to linear nor multiplied or divided by alpha.
    """
    packed = _packed_tile(image, tile) if tile else None
    if (path is None and not raw) or (tile and not path and packed is None and tile == image.tiles[0].number):
        return _pixels_of(image)
    try:
        with _temporary(path or bpy.path.abspath(image.filepath, library=image.library), packed) as copy:
            if raw:
                copy.colorspace_settings.is_data = True
                copy.alpha_mode = "CHANNEL_PACKED"
            else:
                copy.colorspace_settings.name = image.colorspace_settings.name
                copy.alpha_mode = image.alpha_mode
            return _pixels_of(copy)
    except (AttributeError, RuntimeError):  # no such file; or Blender does not let its data be changed now
        return None, False


def stored_bytes(image: bpy.types.Image) -> np.ndarray | None:
    """Pixels of a file or packed file of 8-bit numbers, as it stores them, uint8 [height, width, channels] from the
    bottom; None where it is another or cannot be read, where Blender has read it before, or gives no bytes.

    Blender gives numbers of an image datablock as float32 alone: of a large file that takes longer than to read it.
    """
    if not hasattr(imbuf.types.ImBuf, "with_buffer"):  # before Blender 5.2
        return None
    own = image.source == "FILE" and image.type == "IMAGE" and len(image.packed_files) <= 1
    if not own or image.use_multiview or image.use_deinterlace or image.has_data:
        return None
    path = bpy.path.abspath(image.filepath, library=image.library)
    try:
        packed = image.packed_files[0].packed_file.data if image.packed_files else None
        if packed is None:
            with open(path, "rb") as file:
                head = file.read(_HEAD_LENGTH)
        if not _is_of_bytes(head if packed is None else packed[:_HEAD_LENGTH]):
            return None
        read = imbuf.load(path) if packed is None else imbuf.load_from_buffer(packed)
    except (AttributeError, OSError, ValueError, RuntimeError):  # whoever reads it in another way says why
        return None
    if read is None:
        return None
    try:
        if read.buffer_type != "BYTE":
            return None
        with read.with_buffer() as pixels:
            return np.array(pixels)
    finally:
        read.free()


def _is_of_bytes(head: bytes) -> bool:
    """Whether a file that begins so is a JPEG, or a PNG of 8 bits a channel or less."""
    return head.startswith(b"\xff\xd8\xff") or (head.startswith(b"\x89PNG\r\n\x1a\n") and b"" < head[24:25] <= b"\x08")


def _packed_tile(image: bpy.types.Image, tile: int) -> bytes | None:
    name = PurePath(_tile_name(image.filepath, tile)).name
    for each in image.packed_files:
        if each.packed_file and PurePath(each.filepath).name == name:
            return each.packed_file.data
    return None


@contextmanager
def _temporary(path: str, packed: bytes | None) -> Iterator[bpy.types.Image]:
    """A temporary image datablock of a file, or of packed bytes."""
    if packed is None:
        image = bpy.data.images.load(path, check_existing=False)
    else:
        image = bpy.data.images.new("RayBatch tile", 1, 1)
    try:
        if packed is not None:
            image.pack(data=packed, data_len=len(packed))
            image.source = "FILE"
        yield image
    finally:
        bpy.data.images.remove(image)


def _pixels_of(image: bpy.types.Image) -> tuple[np.ndarray | None, bool]:
    width, height = image.size  # reads the file, if it is not read yet
    channels = image.channels
    if not (width and height and channels) or len(image.pixels) != width * height * channels:
        return None, False
    values = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, channels), bool(image.is_float)
