"""Drawing a picture into the region of the 3D view, through the shader with which Blender manages colors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.live.picture import LivePicture

if TYPE_CHECKING:
    import bpy
    import gpu


class PictureTexture:
    """The newest picture as a texture, made anew for each."""

    def __init__(self) -> None:
        self._picture: LivePicture | None = None
        self._exposure = 1.0
        self._texture: gpu.types.GPUTexture | None = None

    def draw(
        self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene, picture: LivePicture, exposure: float
    ) -> None:
        """Draw `picture`, `exposure` times as bright, where it belongs in the region."""
        import gpu  # Blender without a window has none
        from gpu_extras.batch import batch_for_shader

        if self._texture is None or picture is not self._picture or exposure != self._exposure:
            self._texture = _texture_of(picture.pixels, exposure)
            self._picture, self._exposure = picture, exposure
        x0, y0, x1, y1 = picture.box
        corners = {"pos": ((x0, y0), (x1, y0), (x1, y1), (x0, y1)), "texCoord": ((0, 0), (1, 0), (1, 1), (0, 1))}
        gpu.state.blend_set("ALPHA_PREMULT")
        try:
            engine.bind_display_space_shader(scene)
            try:
                shader = gpu.shader.from_builtin("IMAGE")
                batch = batch_for_shader(shader, "TRI_FAN", corners)
                shader.bind()
                shader.uniform_sampler("image", self._texture)
                batch.draw(shader)
            finally:
                engine.unbind_display_space_shader()
        finally:
            gpu.state.blend_set("NONE")


def _texture_of(pixels: np.ndarray, exposure: float) -> gpu.types.GPUTexture:
    import gpu

    height, width = pixels.shape[:2]
    if exposure != 1.0:
        pixels = pixels * np.array([exposure, exposure, exposure, 1.0], np.float32)
    flat = np.ascontiguousarray(pixels, np.float32).reshape(-1)
    return gpu.types.GPUTexture((width, height), format="RGBA32F", data=gpu.types.Buffer("FLOAT", flat.size, flat))
