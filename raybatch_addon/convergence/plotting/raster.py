"""A canvas: rectangles, smooth lines, dots and text, drawn into an array."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from .letters import ADVANCE, BASELINE, CAPITALS, LINE_HEIGHT, strokes_of

Color = tuple[float, float, float]
# Width of a letter's strokes, in parts of the grid's unit
_STROKE = 0.85


class Canvas:
    """A picture to draw on. Places are in pixels, (0, 0) the bottom left corner; colours are RGB from 0 to 1, as
    shown.
    """

    def __init__(self, width: int, height: int, color: Color):
        """`width` x `height` pixels of `color`."""
        self.width, self.height = width, height
        self.pixels = np.empty((height, width, 4), np.float32)  # RGBA, bottom row first
        self.pixels[...] = (*color, 1.0)

    def rectangle(self, x0: float, y0: float, x1: float, y1: float, color: Color, alpha: float = 1.0) -> None:
        """Fill from (x0, y0) to (x1, y1), rounded to whole pixels."""
        part = self._part(round(x0), round(y0), round(x1), round(y1))
        part += (np.array(color, np.float32) - part) * np.float32(alpha)

    def line(
        self,
        points: Sequence[tuple[float, float]],
        color: Color,
        width: float = 1.5,
        dash: float = 0.0,
        clip=None,
        alpha: float = 1.0,
    ) -> None:
        """A line through `points` with round ends, `width` wide; with dashes and gaps `dash` long. Nothing is drawn
        outside `clip`, (x0, y0, x1, y1).
        """
        clip = clip or (0, 0, self.width, self.height)
        for ends in itertools.pairwise(points):
            for a, b in _dashes(*ends, dash) if dash else [ends]:
                self._segment(a, b, color, width / 2, clip, alpha)

    def dot(self, x: float, y: float, radius: float, color: Color, clip=None) -> None:
        """A disc around (x, y)."""
        self._segment((x, y), (x, y), color, radius, clip or (0, 0, self.width, self.height), 1.0)

    def text(self, x: float, y: float, text: str, size: float, color: Color, align: float = 0.0) -> None:
        """`text` on the baseline y, its capitals `size` high; x is its left end (`align` 0), middle (0.5) or right end
        (1).
        """
        unit = size / (CAPITALS - BASELINE)
        left = round(x - align * text_width(text, size))
        bottom = round(y - BASELINE * unit)
        for i, letter in enumerate(text):
            if letter == " ":
                continue
            mask = _letter_mask(letter, round(unit * 16) / 16)
            x0, y0 = left + round(i * ADVANCE * unit) - 2, bottom - 2
            self._blend(x0, y0, mask, color)

    # --- pixels

    def _part(self, x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
        return self.pixels[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0), :3]

    def _blend(self, x0: int, y0: int, mask: np.ndarray, color: Color) -> None:
        mask = mask[max(-y0, 0) :, max(-x0, 0) :]
        part = self._part(x0, y0, x0 + mask.shape[1] + max(-x0, 0), y0 + mask.shape[0] + max(-y0, 0))
        mask = mask[: part.shape[0], : part.shape[1], None]
        part += (np.array(color, np.float32) - part) * mask

    def _segment(self, a, b, color: Color, radius: float, clip, alpha: float) -> None:
        x0, x1 = (
            max(int(min(a[0], b[0]) - radius - 1), round(clip[0])),
            min(int(max(a[0], b[0]) + radius + 2), round(clip[2])),
        )
        y0, y1 = (
            max(int(min(a[1], b[1]) - radius - 1), round(clip[1])),
            min(int(max(a[1], b[1]) + radius + 2), round(clip[3])),
        )
        if x1 <= x0 or y1 <= y0:
            return
        part = self._part(x0, y0, x1, y1)
        mask = _coverage(a, b, radius, x0, y0, part.shape[1], part.shape[0])
        part += (np.array(color, np.float32) - part) * (mask * np.float32(alpha))[..., None]


def text_width(text: str, size: float) -> float:
    """Pixels that `text` takes, its capitals `size` high."""
    return len(text) * ADVANCE * size / (CAPITALS - BASELINE)


def line_height(size: float) -> float:
    """Pixels from one line of text to the next."""
    return LINE_HEIGHT * size / (CAPITALS - BASELINE)


def _coverage(a, b, radius: float, x0: int, y0: int, width: int, height: int) -> np.ndarray:
    """Share of each pixel that a round-ended segment covers, about: float32 [height, width]. (x0, y0) is the corner of
    the first pixel.
    """
    x = np.arange(width, dtype=np.float32)[None, :] + np.float32(x0 + 0.5 - a[0])
    y = np.arange(height, dtype=np.float32)[:, None] + np.float32(y0 + 0.5 - a[1])
    dx, dy = b[0] - a[0], b[1] - a[1]
    squared = dx * dx + dy * dy
    if squared > 0:
        along = np.clip((x * np.float32(dx) + y * np.float32(dy)) / np.float32(squared), 0, 1)
        x, y = x - along * np.float32(dx), y - along * np.float32(dy)
    return np.clip(np.float32(radius + 0.5) - np.hypot(x, y), 0, 1)


def _dashes(a, b, length: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """The pieces that are drawn of a dashed line from a to b."""
    whole = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    starts = np.arange(0, whole, 2 * length) / max(whole, 1e-9)
    ends = np.minimum(starts + length / max(whole, 1e-9), 1)

    def at(share: float) -> tuple[float, float]:
        return a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share

    return [(at(start), at(end)) for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]


@lru_cache(maxsize=1024)
def _letter_mask(letter: str, unit: float) -> np.ndarray:
    """Coverage of one letter, float32; its grid begins 2 pixels from the corner."""
    mask = np.zeros((int(9 * unit) + 5, int(5 * unit) + 5), np.float32)
    for stroke in strokes_of(letter):
        for a, b in itertools.pairwise(stroke):
            start, end = ((2 + x * unit + unit / 2, 2 + y * unit) for x, y in (a, b))
            np.maximum(mask, _coverage(start, end, _STROKE * unit / 2, 0, 0, mask.shape[1], mask.shape[0]), out=mask)
    return mask
