"""The request of a live render, and the pictures that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..denoise.library import DenoiseLibrary
from ..denoise.picture import COMBINED
from ..observers import Tile
from ..scene.description import Frame, Scene
from ..settings.settings import RenderSettings


@dataclass(frozen=True)
class LiveRequest:
    """A scene as it is after an edit, and how it is to be shown."""

    number: int  # ascending
    scene: Scene
    settings: RenderSettings
    pixel_side: int = 1  # of the finest pixels, in pixels of the scene's frame
    denoiser: DenoiseLibrary | None = None  # of pictures at 1, 2, 4, ... samples


@dataclass(frozen=True)
class LivePicture:
    """A picture that can be shown."""

    request: LiveRequest
    pixels: np.ndarray  # linear RGBA, float32, shape [height, width, 4], bottom row first
    side: int  # of its pixels, in pixels of the request's frame
    origin: tuple[int, int]  # of its bottom left pixel in its frame, counted in its own pixels
    samples: int  # of every pixel

    @property
    def box(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of what it covers of the request's frame [pixels]; it may reach beyond."""
        (x, y), (height, width) = self.origin, self.pixels.shape[:2]
        return x * self.side, y * self.side, (x + width) * self.side, (y + height) * self.side


class TileCanvas:
    """The tiles of a render, put together: all passes of its region."""

    def __init__(self, frame: Frame) -> None:
        x0, y0, x1, y1 = frame.region
        self.origin, self._shape = (x0, y0), (y1 - y0, x1 - x0)
        self.passes: dict[str, np.ndarray] = {}

    def add(self, tile: Tile) -> None:
        """Put `tile` where it belongs."""
        x, y = tile.x - self.origin[0], tile.y - self.origin[1]
        for name, pixels in tile.passes.items():
            if name not in self.passes:
                self.passes[name] = np.zeros((*self._shape, pixels.shape[-1]), np.float32)
            self.passes[name][y : y + tile.height, x : x + tile.width] = pixels

    def picture(self) -> np.ndarray:
        """A copy of the picture itself."""
        return self.passes[COMBINED].copy()
