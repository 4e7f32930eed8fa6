"""Writing finished tiles into Blender's render result; the only room that writes Blender's pixels."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.observers import Tile
from ..export.passes import OWN_PASS_PROPERTIES, wanted_passes

# channels, their letters and Blender's kind of value, by pass
PASSES = {
    "Combined": (4, "RGBA", "COLOR"),
    "Depth": (1, "Z", "VALUE"),
    "Position": (3, "XYZ", "VECTOR"),
    "Normal": (3, "XYZ", "VECTOR"),
    **dict.fromkeys(OWN_PASS_PROPERTIES.values(), (1, "X", "VALUE")),
}


def register_passes(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Tell Blender which passes the render of `view_layer` will fill."""
    for name in wanted_passes(view_layer):
        engine.register_pass(scene, view_layer, name, *PASSES[name])


class ResultWriter:
    """Writes tiles of one view layer; `origin` is the bottom left pixel of the rendered region in the frame."""

    def __init__(self, engine: bpy.types.RenderEngine, layer_name: str, origin: tuple[int, int]) -> None:
        self._engine = engine
        self._layer_name = layer_name
        self._origin = origin

    def write(self, tile: Tile) -> None:
        """Show `tile`. Blender counts its pixels from the corner of the render border."""
        x, y = tile.x - self._origin[0], tile.y - self._origin[1]
        result = self._engine.begin_result(x, y, tile.width, tile.height, layer=self._layer_name)
        try:
            # without a layer the view layer was renamed or removed meanwhile: there is nowhere to write
            for layer in result.layers:
                for target in layer.passes:
                    pixels = tile.passes.get(target.name)
                    if pixels is not None:
                        target.rect.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
        except BaseException:
            self._engine.end_result(result, cancel=True)
            raise
        self._engine.end_result(result)


def write_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Put `pixels` into Blender's image `name`, which is made or resized; for the main thread alone.

    Args:
        pixels: RGBA as shown on a screen, 0 to 1, float32, shape [height, width, 4], bottom row first.
    """
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.new(name, width, height)
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
    image.update()
    return image


def write_preview(preview: bpy.types.ImagePreview, pixels: np.ndarray) -> None:
    """Put `pixels`, as those of `write_image`, into what a panel shows as an icon."""
    height, width = pixels.shape[:2]
    if tuple(preview.image_size) != (width, height):
        preview.image_size = (width, height)
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
