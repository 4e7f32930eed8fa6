"""Sheets of pictures for docs/parity.md: for each family one PNG with a numbered cell for each of its features.

A cell shows Cycles, RayBatch and their difference side by side below the feature's number and name. A sheet keeps the
names and sizes of its cells, so that the pictures of features that are not compared anew are found in it again.
"""

from __future__ import annotations

import json
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

THUMBNAIL = 64  # pixels of the edge of each of the three pictures
GAIN = 10  # differences are shown this many times as large
COLUMNS = 4
CELL = (244, 80)  # pixels of the largest thumbnail, width and height
LABEL, LETTERS, GAP = 30, 12, 12  # pixels: two lines of text above a thumbnail, size of letters, space between cells
LABEL_COLUMNS = 38  # letters of a line of text
_KEY = "cells"  # of the PNG's text: names and sizes, in the order of the cells
Cells = dict[str, np.ndarray]  # thumbnails by feature, uint8 [height, width, 3]


def slug(name: str) -> str:
    """`name` as part of a file's name."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _to_screen(pixels: np.ndarray) -> np.ndarray:
    """Linear to sRGB bytes."""
    value = np.clip(np.nan_to_num(pixels, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return (
        np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.power(np.maximum(value, 1e-9), 1 / 2.4) - 0.055) * 255
        + 0.5
    ).astype(np.uint8)


def _enlarged(pixels: np.ndarray) -> np.ndarray:
    """Top row first, about `THUMBNAIL` pixels high."""
    factor = max(1, round(THUMBNAIL / pixels.shape[0]))
    return np.repeat(np.repeat(pixels[::-1], factor, 0), factor, 1)


def thumbnail(result: Any) -> np.ndarray:
    """Cycles, RayBatch and difference side by side, uint8 [height, width, 3]."""
    both = result.theirs, result.ours
    low, high = 0.0, 1.0
    if result.feature.kind == "node":
        values = result.theirs[np.isfinite(result.theirs)]
        low, high = min(0.0, float(np.percentile(values, 1))), max(1.0, float(np.percentile(values, 99)))
    else:
        high = max(float(np.percentile(result.theirs, 97)), 1e-6)
    shown = [(each - low) / (high - low) for each in both] + [GAIN * np.abs(both[0] - both[1]) / (high - low)]
    gap = np.full((_enlarged(result.theirs).shape[0], 2, 3), 255, np.uint8)
    parts = [_to_screen(_enlarged(each)) for each in shown]
    whole = np.concatenate([parts[0], gap, parts[1], gap, parts[2]], 1)
    return whole[: CELL[1], : CELL[0]]


def _corner(number: int) -> tuple[int, int]:
    """Left and top pixel of the cell `number`, 0 and up."""
    row, column = divmod(number, COLUMNS)
    return GAP + column * (CELL[0] + GAP), GAP + row * (CELL[1] + LABEL + GAP)


def write_sheet(cells: Cells, file: Path) -> None:
    """`cells` as a PNG, numbered from 1."""
    from PIL import Image, ImageDraw, ImageFont
    from PIL.PngImagePlugin import PngInfo

    right, bottom = _corner(COLUMNS - 1)[0] + CELL[0], _corner(len(cells) - 1)[1] + CELL[1] + LABEL
    sheet = Image.new("RGB", (right + GAP, bottom + GAP), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(LETTERS)
    for number, (name, pixels) in enumerate(cells.items()):
        left, top = _corner(number)
        label = textwrap.wrap(f"{number + 1}  {name}", LABEL_COLUMNS)[:2]
        draw.text((left, top), "\n".join(label), "black", font, spacing=1)
        sheet.paste(Image.fromarray(pixels), (left, top + LABEL))
    about = PngInfo()
    about.add_itxt(_KEY, json.dumps([[name, *pixels.shape[:2]] for name, pixels in cells.items()]))
    sheet.save(file, optimize=True, pnginfo=about)


def read_sheet(file: Path) -> Cells:
    """The thumbnails of a sheet that `write_sheet` wrote; none where there is no file."""
    from PIL import Image
    from PIL.PngImagePlugin import PngImageFile

    if not file.exists():
        return {}
    with Image.open(file) as sheet:
        assert isinstance(sheet, PngImageFile)
        sheet.load()
        pixels, about = np.asarray(sheet.convert("RGB")), json.loads(sheet.text[_KEY])
    cells = {}
    for number, (name, height, width) in enumerate(about):
        left, top = _corner(number)
        cells[name] = pixels[top + LABEL : top + LABEL + height, left : left + width]
    return cells


def write_sheets(results: list, folder: Path) -> dict[str, int]:
    """Sheets of all families of `results` in `folder`; returns the numbers of cells by feature.

    A result without pictures keeps the cell that it has. Sheets are written only where a picture is new or gone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers: dict[str, int] = {}
    files: dict[Path, list] = {}
    for result in results:
        files.setdefault(folder / f"{slug(result.feature.family)}.png", []).append(result)
    for file, some in files.items():
        earlier, cells = read_sheet(file), {}
        new = False
        for result in some:
            name = result.feature.name
            if result.ours is not None and result.theirs is not None:
                cells[name], new = thumbnail(result), True
            elif name in earlier:
                cells[name] = earlier[name]
        if cells and (new or list(cells) != list(earlier)):
            write_sheet(cells, file)
        numbers |= {name: number + 1 for number, name in enumerate(cells)}
    for file in folder.glob("*.png"):
        if file not in files:
            file.unlink()  # of a family that is there no more
    return numbers
