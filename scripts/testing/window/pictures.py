"""Pictures of parts of Blender's window, as JPEG files that are small enough for the manual."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

PROGRAM = "import"  # of ImageMagick
BYTES_MOST = 150_000  # of a picture of the manual
_QUALITIES = (90, 85, 80, 75, 70, 60, 50)
_FREE = 8  # pixels below what is shown, in pictures that end there
_SCROLLBAR = 20  # pixels


@dataclass(frozen=True)
class Box:
    """A part of the window [pixels from its bottom left]."""

    x0: int
    y0: int
    x1: int
    y1: int


def box_of(*parts: bpy.types.Area | bpy.types.Region) -> Box:
    """The smallest box around areas or regions."""
    return Box(
        min(each.x for each in parts),
        min(each.y for each in parts),
        max(each.x + each.width for each in parts),
        max(each.y + each.height for each in parts),
    )


class Pictures:
    """Pictures that are taken into a folder; all are cut at the end, as images are data that a viewport may look at."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._taken: list[tuple[str, Box, int, Box | None]] = []

    def take(self, name: str, box: Box, width: int = 0, ends_with: bpy.types.Region | None = None) -> None:
        """Take a picture of `box` for NAME.jpg, `width` pixels wide if given. With `ends_with` it ends a little below
        the lowest that is in that region.
        """
        _shoot(self._raw(name))
        self._taken.append((name, box, width, box_of(ends_with) if ends_with else None))
        print(f"took {name}", flush=True)

    def lowest(self, region: bpy.types.Region) -> int:
        """Where what the region shows ends [pixels from the window's bottom]."""
        path = self._raw("lowest")
        _shoot(path)
        found = _lowest(_pixels(path), box_of(region))
        path.unlink()
        return found

    def save(self) -> None:
        """Write the files. A picture that is cut off, or larger than `BYTES_MOST`, is an error."""
        for name, box, width, region in self._taken:
            path = self._raw(name)
            pixels, y0 = _pixels(path), box.y0
            if region is not None:
                y0 = _lowest(pixels, region) - _FREE
                if y0 <= region.y0:
                    raise SystemExit(f"walk.py: {name} does not fit: give the window more height")
            _write(self._folder / f"{name}.jpg", pixels[y0 : box.y1, box.x0 : box.x1], width)
            path.unlink()
        self._taken.clear()

    def _raw(self, name: str) -> Path:
        return self._folder / f"{name}.png"


def look_for_program() -> None:
    """End with a message where ImageMagick is missing."""
    if shutil.which(PROGRAM) is None:
        raise SystemExit(f"walk.py: ImageMagick's {PROGRAM} is not installed, which takes pictures of the screen")


def _shoot(path: Path) -> None:
    """A picture of the screen, whose top left corner is that of Blender's window. Blender's own operator for that reads
    what drivers without a GPU leave black.
    """
    subprocess.run([PROGRAM, "-window", "root", str(path)], check=True)


def _pixels(path: Path) -> np.ndarray:
    """Of an image, as its file has them, float32 [height, width, 4], bottom row first."""
    image = bpy.data.images.load(str(path))
    pixels = np.empty((image.size[1], image.size[0], 4), dtype=np.float32)
    image.pixels.foreach_get(pixels.ravel())
    bpy.data.images.remove(image)
    return pixels[-bpy.context.window_manager.windows[0].height :]


def _lowest(pixels: np.ndarray, box: Box) -> int:
    """The lowest row of `box` that has anything but the colour of its bottom left corner."""
    part = pixels[box.y0 + 2 : box.y1, box.x0 + 2 : box.x1 - _SCROLLBAR]
    rows = (np.abs(part - part[0, 0]) > 0.01).any(axis=(1, 2))
    return box.y0 + 2 + int(rows.argmax())


def _write(path: Path, pixels: np.ndarray, width: int) -> None:
    height = pixels.shape[0]
    image = bpy.data.images.new(path.stem, pixels.shape[1], height)
    image.pixels.foreach_set(np.ascontiguousarray(pixels).ravel())
    if width:
        image.scale(width, round(height * width / pixels.shape[1]))
    image.file_format = "JPEG"
    for quality in _QUALITIES:
        image.save(filepath=str(path), quality=quality)
        if path.stat().st_size <= BYTES_MOST:
            break
    else:
        raise SystemExit(f"walk.py: {path} has more than {BYTES_MOST} bytes")
    bpy.data.images.remove(image)
