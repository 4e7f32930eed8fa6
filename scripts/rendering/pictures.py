"""Pictures that Blender does not write: PNG (display colours) and OpenEXR (linear, every pass) where there is none,
heat maps.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
from lib.output import OutputError, print_saved, write_whole

from raybatch_addon.core.denoise.picture import COMBINED, NOISY_IMAGE
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.cryptomatte import matte_fields
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.passes import DEPTH_OF_NOTHING, letters_of

FORMATS = (".png", ".exr")
# Colours of heat maps at equal steps from nothing to the largest value, sRGB: brightness grows evenly, for those who
# see no red or green too
HEAT_COLORS = np.array(
    [
        (0, 0, 4),
        (40, 11, 84),
        (101, 21, 110),
        (159, 42, 99),
        (212, 72, 66),
        (245, 125, 21),
        (250, 193, 39),
        (252, 255, 164),
    ]
)


def picture_path(out: Path) -> Path:
    """`out` with the extension of a format that can be written (.png if it has none); raises `OutputError` for
    another.
    """
    if out.suffix == "":
        return out.with_name(out.name + ".png")
    if out.suffix.lower() not in FORMATS:
        raise OutputError(f"{out} cannot be written without Blender as {out.suffix}: name it {' or '.join(FORMATS)}")
    return out


def write_picture(path: Path, film: Film, scene: Scene) -> None:
    """Write the rendered region of `film`, a picture of `scene`, to `path`, whole or not at all."""

    def write(temporary: Path) -> None:
        if path.suffix.lower() == ".exr":
            _write_exr(temporary, film.shown, matte_fields("", scene))
        else:
            _write_png(temporary, film.shown)

    write_whole(path, write)


def display_pixels(combined: np.ndarray) -> np.ndarray:
    """sRGB pixels as a PNG holds them, uint8 [height, width, 4], top row first, alpha not multiplied in.

    `combined` is linear Rec. 709, float32 [height, width, 4], bottom row first, multiplied by alpha. The curve is
    that of IEC 61966-2-1; what is brighter than white is cut off.
    """
    alpha = np.clip(combined[..., 3:], 0, 1)
    color = np.divide(combined[..., :3], alpha, out=np.zeros_like(combined[..., :3]), where=alpha > 0)
    color = np.clip(color, 0, 1)
    curve = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
    return np.rint(np.concatenate([curve, alpha], axis=-1)[::-1] * 255).astype(np.uint8)


def write_heat_map(path: Path, values: np.ndarray, name: str) -> None:
    """Write `values` [height, width] of the pass `name` to the PNG `path`, from black for 0 to bright for its largest
    finite value, beside the depth of nothing; names which that is.
    """
    pixels, largest = heat_pixels(values)
    write_whole(path, lambda temporary: save_png(temporary, pixels))
    print_saved(path, f"{name}, 0 to {largest:.4g}")


def heat_pixels(values: np.ndarray) -> tuple[np.ndarray, float]:
    """sRGB pixels, uint8 [height, width, 3], top row first, and the largest finite value, which is the brightest.

    `values` are float32 [height, width], bottom row first; what is infinite, or as deep as where there is nothing, is
    the brightest too.
    """
    finite = values[np.isfinite(values) & (values < DEPTH_OF_NOTHING)]
    largest = float(finite.max()) if finite.size and finite.max() > 0 else 1.0
    place = np.clip(values[::-1] / np.float32(largest), 0, 1) * (len(HEAT_COLORS) - 1)
    channels = [np.interp(place, np.arange(len(HEAT_COLORS)), HEAT_COLORS[:, k]) for k in range(3)]
    return np.rint(np.stack(channels, -1)).astype(np.uint8), largest


def save_png(target: Path | BinaryIO, pixels: np.ndarray) -> None:
    """Write `pixels`, uint8 [height, width, 3 or 4], top row first, to a path or an open file."""
    from PIL import Image

    Image.fromarray(pixels).save(target, format="PNG")


def _write_png(path: Path, passes: dict[str, np.ndarray]) -> None:
    pixels = display_pixels(passes["Combined"])
    if (pixels[..., 3] == 255).all():
        pixels = np.ascontiguousarray(pixels[..., :3])
    save_png(path, pixels)


def _write_exr(path: Path, passes: dict[str, np.ndarray], metadata: dict[str, str]) -> None:
    import OpenEXR

    channels = {}
    for name, values in passes.items():
        letters = "RGBA" if name == NOISY_IMAGE else letters_of(name)
        for k, letter in enumerate(letters):
            channels[letter if name == COMBINED else f"{name}.{letter}"] = np.ascontiguousarray(values[::-1, :, k])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **metadata}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
