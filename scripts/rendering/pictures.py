"""Pictures written where there is no Blender: PNG (display colours) and OpenEXR (linear, every pass)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from raybatch_addon.core.film import Film

from .output import OutputError, write_whole

FORMATS = (".png", ".exr")


def picture_path(out: Path) -> Path:
    """`out` with the extension of a format that can be written (.png if it has none); raises `OutputError` for another."""
    if out.suffix == "":
        return out.with_name(out.name + ".png")
    if out.suffix.lower() not in FORMATS:
        raise OutputError(f"{out} cannot be written without Blender as {out.suffix}: name it {' or '.join(FORMATS)}")
    return out


def write_picture(path: Path, film: Film) -> None:
    """Write the rendered region of `film` to `path`, whole or not at all."""
    write = _write_exr if path.suffix.lower() == ".exr" else _write_png
    write_whole(path, lambda temporary: write(temporary, film.passes))


def display_pixels(combined: np.ndarray) -> np.ndarray:
    """sRGB pixels as a PNG holds them, uint8 [height, width, 4], top row first, alpha not multiplied in.

    `combined` is linear Rec. 709, float32 [height, width, 4], bottom row first, multiplied by alpha. The curve is
    that of IEC 61966-2-1; what is brighter than white is cut off.
    """
    alpha = np.clip(combined[..., 3:], 0, 1)
    colour = np.divide(combined[..., :3], alpha, out=np.zeros_like(combined[..., :3]), where=alpha > 0)
    colour = np.clip(colour, 0, 1)
    curve = np.where(colour <= 0.0031308, 12.92 * colour, 1.055 * colour ** (1 / 2.4) - 0.055)
    return np.rint(np.concatenate([curve, alpha], axis=-1)[::-1] * 255).astype(np.uint8)


def _write_png(path: Path, passes: dict[str, np.ndarray]) -> None:
    from PIL import Image

    pixels = display_pixels(passes["Combined"])
    if (pixels[..., 3] == 255).all():
        pixels = np.ascontiguousarray(pixels[..., :3])
    Image.fromarray(pixels).save(path, format="PNG")


def _write_exr(path: Path, passes: dict[str, np.ndarray]) -> None:
    import OpenEXR

    channels = {}
    for name, values in passes.items():
        letters = "RGBA" if name == "Combined" else "V" if values.shape[2] == 1 else "XYZ"
        for k, letter in enumerate(letters):
            channels[letter if name == "Combined" else f"{name}.{letter}"] = np.ascontiguousarray(values[::-1, :, k])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
