"""Small images for textures and worlds."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np

WIDTH, HEIGHT = 12, 8
_FOLDER = Path(tempfile.gettempdir()) / "raybatch-parity-images"


def pattern(width: int = WIDTH, height: int = HEIGHT, alpha: bool = False, seed: int = 3) -> np.ndarray:
    """Random colours, float32 [height, width, 4], in 0..1."""
    values = np.random.default_rng(seed).random((height, width, 4), np.float32)
    if not alpha:
        values[..., 3] = 1.0
    return values


def image_of(
    pixels: np.ndarray,
    name: str = "Pattern",
    float_buffer: bool = False,
    alpha: bool = False,
    colorspace: str | None = None,
) -> bpy.types.Image:
    """A generated image with these pixels, packed."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=alpha, float_buffer=float_buffer)
    if colorspace:
        image.colorspace_settings.name = colorspace
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    image.pack()
    return image


def file_of(pixels: np.ndarray, name: str, file_format: str, depth: str = "8") -> Path:
    """A file of the pixels."""
    _FOLDER.mkdir(exist_ok=True)
    path = _FOLDER / name
    scene = bpy.context.scene
    image = image_of(pixels, "Written", float_buffer=file_format in ("OPEN_EXR", "HDR"), alpha=True)
    image.filepath_raw, image.file_format = str(path), file_format
    image.save(filepath=str(path))
    bpy.data.images.remove(image)
    assert path.exists() and scene, path
    return path


def tiles(name: str = "Tiles") -> bpy.types.Image:
    """A UDIM image of three tiles."""
    for number in (1001, 1002, 1011):
        file_of(pattern(seed=number), f"{name}.{number}.png", "PNG")
    image = bpy.data.images.load(str(_FOLDER / f"{name}.1001.png"))
    image.source = "TILED"
    for number in (1002, 1011):
        if image.tiles.get(number) is None:
            image.tiles.new(number)
    image.filepath = str(_FOLDER / f"{name}.<UDIM>.png")
    return image


def sky_map(width: int = 64, sun: float = 0.0) -> np.ndarray:
    """An equirectangular picture: a blue gradient, a warm patch, and a texel of radiance `sun`.

    Float32 [width / 2, width, 4].
    """
    height = width // 2
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    pixels = np.stack([0.2 + 0.3 * v, 0.3 + 0.3 * v, 0.4 + 0.5 * v, np.ones_like(u)], -1)
    pixels[(np.abs(u - 0.3) < 0.08) & (np.abs(v - 0.65) < 0.1)] = (3.0, 2.0, 1.0, 1.0)
    if sun:
        pixels[int(0.75 * height), int(0.6 * width), :3] = (sun, 0.9 * sun, 0.7 * sun)
    return pixels.astype(np.float32)
