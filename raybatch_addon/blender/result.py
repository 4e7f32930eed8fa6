"""Writing finished tiles into Blender's render result; the only room that writes Blender's pixels."""

from __future__ import annotations

import itertools

import bpy
import numpy as np

from ..core.denoise.picture import NOISY_CATCHER, NOISY_IMAGE
from ..core.errors import OutOfMemoryError
from ..core.host_memory import host_memory_free, size_text
from ..core.observers import Tile
from ..core.scene.cryptomatte import matte_fields
from ..core.scene.description import Scene
from ..core.scene.passes import letters_of
from ..export.passes import (
    LIGHT_GROUP,
    LIGHT_PASS_PROPERTIES,
    SAMPLE_SHARE,
    VOLUME_PASS_PROPERTIES,
    blender_name,
    made_passes,
    wanted_passes,
)

# Passes of light, which the exposure brightens; not those of colours, values and mattes
_LIGHT_PASSES = (*LIGHT_PASS_PROPERTIES.values(), *VOLUME_PASS_PROPERTIES.values())
LIT_PASSES = frozenset(["Combined", NOISY_IMAGE, *(name for name in _LIGHT_PASSES if not name.endswith("Color"))])

# Channels of passes that are made of a film
_MADE_LETTERS = {NOISY_IMAGE: "RGBA", NOISY_CATCHER: "RGB", SAMPLE_SHARE: "X"}


def register_passes(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Name to Blender the passes that the render of `view_layer` will fill."""
    for name in (*wanted_passes(view_layer), *made_passes(scene, view_layer)):
        engine.register_pass(scene, view_layer, blender_name(name), *_about(name))


def _about(name: str) -> tuple[int, str, str]:
    """Channels, letters and kind of the film's pass `name`."""
    letters = _MADE_LETTERS.get(name) or letters_of(name)
    kind = "COLOR" if letters.lower().startswith("rgb") else "VALUE" if len(letters) == 1 else "VECTOR"
    return len(letters), letters, kind


def check_result_fits(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Raises `OutOfMemoryError` where Blender's pictures of the whole frame, those of `view_layer` and of the layers
    behind it, do not fit in memory, also where a border is rendered that they are not cropped to: Blender would go on
    without them, and save black. Those of layers before it are in memory already.
    """
    render = scene.render
    if render.use_border and render.use_crop_to_border:
        return  # the film is checked
    width, height = (size * render.resolution_percentage // 100 for size in (render.resolution_x, render.resolution_y))
    layers = [view_layer]
    if not render.use_single_layer:
        behind = itertools.dropwhile(lambda layer: layer.name != view_layer.name, scene.view_layers)
        layers += [layer for layer in itertools.islice(behind, 1, None) if layer.use]
    names = [name for layer in layers for name in (*wanted_passes(layer), *made_passes(scene, layer))]
    needed = width * height * 4 * sum(_about(name)[0] for name in names) * _view_count(render)
    if needed > (free := host_memory_free()):
        crop = ", or turn on Crop to Render Region" if render.use_border else ""
        raise OutOfMemoryError(
            f"Blender's picture of {width:,} x {height:,} pixels with its passes takes {size_text(needed)} of memory, "
            f"and {size_text(free)} are free; lower the resolution, ask for fewer passes{crop}"
        )


def _view_count(render: bpy.types.RenderSettings) -> int:
    if not render.use_multiview:
        return 1
    views = render.stereo_views if render.views_format == "STEREO_3D" else render.views
    return max(1, sum(view.use for view in views))


def stamp_mattes(engine: bpy.types.RenderEngine, layer_name: str, scene: Scene) -> None:
    """Write into the result's metadata which name each identity of a matte stands for: files keep it, and other
    programs find objects by it (Friedman and Jones, "Cryptomatte specification").
    """
    for field, value in matte_fields(layer_name, scene).items():
        engine.get_result().stamp_data_add_field(field, value)


def view_names(engine: bpy.types.RenderEngine, layer_name: str, scene: bpy.types.Scene) -> list[str]:
    """The views that the render result wants; one without name where it is no stereoscopy."""
    if not scene.render.use_multiview:
        return [""]
    result = engine.begin_result(0, 0, 1, 1, layer=layer_name)
    names = [view.name for view in result.views]
    engine.end_result(result, cancel=True)
    return names or [""]


class ResultWriter:
    """Writes tiles of one view layer; `origin` is the bottom left pixel of the rendered region in the frame. `view` is
    one of stereoscopy's, or no name.
    """

    def __init__(
        self,
        engine: bpy.types.RenderEngine,
        layer_name: str,
        origin: tuple[int, int],
        view: str = "",
        exposure: float = 1.0,
    ) -> None:
        """Passes of light are shown `exposure` times as bright."""
        self._engine, self._exposure = engine, exposure
        self._layer_name = layer_name
        self._origin = origin
        self._view = view

    def write(self, tile: Tile) -> None:
        """Show `tile`. Blender counts its pixels from the corner of the render border."""
        x, y = tile.x - self._origin[0], tile.y - self._origin[1]
        result = self._engine.begin_result(x, y, tile.width, tile.height, layer=self._layer_name, view=self._view)
        try:
            # without a layer the view layer was renamed or removed meanwhile: there is nowhere to write
            named = {blender_name(name): self._exposed(name, pixels) for name, pixels in tile.passes.items()}
            for layer in result.layers:
                for target in layer.passes:
                    pixels = named.get(target.name)
                    if pixels is not None:
                        target.rect.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
        except BaseException:
            self._engine.end_result(result, cancel=True)
            raise
        self._engine.end_result(result)

    def _exposed(self, name: str, pixels: np.ndarray) -> np.ndarray:
        """The pass `name` as bright as it is shown; alpha stays."""
        if self._exposure == 1 or not (name in LIT_PASSES or name.startswith(LIGHT_GROUP)):
            return pixels
        return pixels * np.array([self._exposure] * 3 + [1], np.float32)[: pixels.shape[-1]]


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
