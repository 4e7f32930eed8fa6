"""Colour spaces of images by name, through Blender's own colour management.

Python has no access to Blender's OpenColorIO, but image datablocks convert: pixels of a floating-point file come out in
the scene's linear space. So colours are packed, as such a file, into a datablock of their space.
"""

from __future__ import annotations

import struct
from enum import Enum

import bpy
import numpy as np

DEFAULT_WORKING_SPACE = "Linear Rec.709"
# A space farther from the sRGB curve, or from identity, than colour management rounds is neither
_SAME = 1e-4


class CannotConvertNow(ValueError):
    """Error while Blender does not let its data be changed; the same conversion may succeed later."""


class SpaceKind(Enum):
    """Treatment of an image's numbers."""

    DATA = "data"  # no colours: unchanged
    LINEAR = "linear"  # the scene's own space
    SRGB = "sRGB"  # sRGB of the scene's primaries: decoded at look-ups
    OTHER = "other"  # converted here
    UNKNOWN = "unknown"  # unknown to colour management


_known: dict[tuple[str, str], SpaceKind] = {}  # kinds by name and working space


def working_space() -> str:
    """Name of the scene's linear space."""
    settings = getattr(bpy.data, "colorspace", None)  # from 5.0 on
    return getattr(settings, "working_space", DEFAULT_WORKING_SPACE)


def space_kind(settings: bpy.types.ColorManagedInputColorspaceSettings) -> SpaceKind:
    """The kind of an image's colour space.

    Raises `CannotConvertNow` if it takes a conversion to find out; no kind is remembered then.
    """
    if settings.is_data:
        return SpaceKind.DATA
    name, working = settings.name, working_space()
    if working == DEFAULT_WORKING_SPACE and name in (working, "sRGB"):
        return SpaceKind.SRGB if name == "sRGB" else SpaceKind.LINEAR  # nearly all images: no conversion is needed
    if (name, working) not in _known:
        _known[name, working] = _measured_kind(name)
    return _known[name, working]


def to_scene_linear(colors: np.ndarray, name: str) -> np.ndarray:
    """`colors` [height, width, 4] of the space `name` in the scene's linear space, float32; alpha is unchanged.

    Raises `ValueError` if colour management does not know `name`; `CannotConvertNow` while Blender lets nothing be
    converted.
    """
    height, width = colors.shape[:2]
    file = _exr(colors)
    try:
        image = bpy.data.images.new("RayBatch conversion", 1, 1)
    except (AttributeError, RuntimeError) as error:
        raise CannotConvertNow(f"colours cannot be converted now ({error})") from error
    try:
        image.alpha_mode = "CHANNEL_PACKED"  # alpha leaves colours alone
        image.pack(data=file, data_len=len(file))
        image.source = "FILE"
        image.colorspace_settings.name = name
        values = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(values)
    except (TypeError, RuntimeError) as error:
        raise ValueError(f"the colour space “{name}” is not known") from error
    finally:
        bpy.data.images.remove(image)
    return values.reshape(height, width, 4)


def _exr(colors: np.ndarray) -> bytes:
    """An uncompressed OpenEXR file, float32, of `colors` [height, width, 4], bottom row first.

    "OpenEXR File Layout", openexr.com: magic number, attributes, offsets of rows, rows with one plane for each channel.
    """
    height, width = colors.shape[:2]
    channels = b"".join(name + struct.pack("<BiIii", 0, 2, 0, 1, 1) for name in (b"A", b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        (b"channels", b"chlist", channels),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    )
    header = struct.pack("<II", 20000630, 2)
    for name, kind, value in attributes:
        header += name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
    header += b"\0"
    rows = np.empty(height, np.dtype([("y", "<i4"), ("size", "<i4"), ("planes", "<f4", (4, width))]))
    rows["y"], rows["size"] = np.arange(height), 16 * width
    rows["planes"] = np.moveaxis(colors[::-1, :, ::-1], 2, 1)
    offsets = len(header) + 8 * height + np.arange(height, dtype="<u8") * rows.itemsize
    return header + offsets.tobytes() + rows.tobytes()


def linear_colors(x: np.ndarray) -> np.ndarray:
    """Linear numbers of sRGB-encoded ones."""
    return np.where(x < 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def _measured_kind(name: str) -> SpaceKind:
    steps = np.linspace(0, 1, 5, dtype=np.float32)
    colors = np.stack([*np.meshgrid(steps, steps, steps), np.ones((5, 5, 5))], -1).reshape(5, 25, 4)
    try:
        converted = to_scene_linear(colors, name)
    except CannotConvertNow:
        raise
    except ValueError:
        return SpaceKind.UNKNOWN
    if np.abs(converted - colors)[..., :3].max() < _SAME:
        return SpaceKind.LINEAR
    if np.abs(converted - linear_colors(colors))[..., :3].max() < _SAME:
        return SpaceKind.SRGB
    return SpaceKind.OTHER
