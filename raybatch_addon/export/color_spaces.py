"""Colour spaces of images by name, through Blender's own colour management.

Python is not given Blender's OpenColorIO, but an image datablock converts: floating-point pixels that are packed as they are come
back in the scene's linear space once the datablock is said to be in another one.
"""

from __future__ import annotations

from enum import Enum

import bpy
import numpy as np

DEFAULT_WORKING_SPACE = "Linear Rec.709"
# Farther from the sRGB curve or from identity than colour management rounds is another space
_SAME = 1e-4



class SpaceKind(Enum):
    """What becomes of the numbers of an image."""

    DATA = "data"  # no colours: as they are
    LINEAR = "linear"  # the scene's own space
    SRGB = "sRGB"  # of the scene's primaries: decoded at look-ups
    OTHER = "other"  # converted here
    UNKNOWN = "unknown"  # to colour management


_known: dict[tuple[str, str], SpaceKind] = {}  # by name and working space


def working_space() -> str:
    """Name of the scene's linear space."""
    settings = getattr(bpy.data, "colorspace", None)  # from 5.0 on
    return getattr(settings, "working_space", DEFAULT_WORKING_SPACE)


def space_kind(settings: bpy.types.ColorManagedInputColorspaceSettings) -> SpaceKind:
    """The kind of an image's colour space."""
    if settings.is_data:
        return SpaceKind.DATA
    name, working = settings.name, working_space()
    if working == DEFAULT_WORKING_SPACE and name in (working, "sRGB"):
        return SpaceKind.SRGB if name == "sRGB" else SpaceKind.LINEAR  # nearly all images; nothing need be asked
    if (name, working) not in _known:
        _known[name, working] = _measured_kind(name)
    return _known[name, working]


def to_scene_linear(colors: np.ndarray, name: str) -> np.ndarray:
    """`colors` [height, width, 4] of the space `name` in the scene's linear space, float32; alpha is nothing but handed on.

    Raises `ValueError` where colour management does not know `name`, or lets nothing be converted now.
    """
    height, width = colors.shape[:2]
    values = np.array(colors, np.float32, order="C")
    try:
        image = bpy.data.images.new("RayBatch conversion", width, height, alpha=True, float_buffer=True, is_data=True)
    except (AttributeError, RuntimeError) as error:  # Blender does not let its data be changed at times
        raise ValueError(f"colours cannot be converted now ({error})") from error
    try:
        image.alpha_mode = "CHANNEL_PACKED"  # colours are left alone by alpha
        image.pixels.foreach_set(values.ravel())
        image.pack()
        image.source = "FILE"
        image.colorspace_settings.name = name  # read again, from what was packed
        image.pixels.foreach_get(values.ravel())
    except (TypeError, RuntimeError) as error:
        raise ValueError(f"the colour space “{name}” is not known") from error
    finally:
        bpy.data.images.remove(image)
    return values


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """The sRGB transfer function undone."""
    return np.where(x < 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def _measured_kind(name: str) -> SpaceKind:
    steps = np.linspace(0, 1, 5, dtype=np.float32)
    colors = np.stack([*np.meshgrid(steps, steps, steps), np.ones((5, 5, 5))], -1).reshape(5, 25, 4)
    try:
        converted = to_scene_linear(colors, name)
    except ValueError:
        return SpaceKind.UNKNOWN
    if np.abs(converted - colors)[..., :3].max() < _SAME:
        return SpaceKind.LINEAR
    if np.abs(converted - srgb_to_linear(colors))[..., :3].max() < _SAME:
        return SpaceKind.SRGB
    return SpaceKind.OTHER
