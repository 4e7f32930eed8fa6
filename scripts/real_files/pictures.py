"""Pictures of a file: Cycles, RayBatch, and how far they are apart, as bytes of a screen."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from lib.output import write_whole
from rendering.pictures import display_pixels, save_png

from real_files.measures import Pair

GAIN = 3  # differences are shown this many times as large
BRIGHT_PERCENTILE = 98.0  # of Cycles' picture: shown as white
DARKEST = 1e-4  # brightness that is shown as white at the least
GAP = 4  # pixels between pictures


def where_both_are(theirs: Pair | None, ours: Pair | None) -> np.ndarray | None:
    """`side_by_side`; None where a picture is not there, or they differ in size."""
    if theirs is None or ours is None or theirs.mean.shape != ours.mean.shape:
        return None
    return side_by_side(theirs, ours)


def side_by_side(theirs: Pair, ours: Pair) -> np.ndarray:
    """Cycles, RayBatch and their absolute difference, uint8 [height, width, 3], top row first."""
    bright = max(DARKEST, float(np.percentile(theirs.mean, BRIGHT_PERCENTILE)))
    apart = GAIN * np.abs(ours.mean - theirs.mean)
    shown = [_display(each / bright) for each in (theirs.mean, ours.mean, apart)]
    gap = np.full((shown[0].shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([shown[0], gap, shown[1], gap, shown[2]], 1)


def _display(linear: np.ndarray) -> np.ndarray:
    return display_pixels(np.concatenate([linear, np.ones_like(linear[..., :1])], -1).astype(np.float32))[..., :3]


def png(pixels: np.ndarray) -> bytes:
    """A PNG of `pixels`."""
    encoded = io.BytesIO()
    save_png(encoded, pixels)
    return encoded.getvalue()


def write_png(path: Path, pixels: np.ndarray) -> None:
    """`pixels` in a file, whole or not at all."""
    write_whole(path, lambda temporary: temporary.write_bytes(png(pixels)))
