"""Recorded renders, and the picture of their plot."""

import bpy
import numpy as np

from raybatch_addon.convergence.records import store
from raybatch_addon.ui.convergence import shown


def render():
    """Render, and return the record of the render."""
    assert bpy.ops.render.render() == {"FINISHED"}
    return store.last()


def plot():
    """The plot as the user sees it: float32 [height, width, 4], top row first."""
    assert bpy.ops.raybatch.convergence_plot() == {"FINISHED"}
    image = bpy.data.images[shown.IMAGE_NAME]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def has_color(pixels, color):
    """Number of pixels with this colour, to the precision of 8 bits."""
    return int((np.abs(pixels[..., :3] - np.float32(color)) < 0.01).all(axis=-1).sum())
