"""The denoised picture of a film: which passes guide it, and how they are filtered before."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..settings.settings import RenderSettings
from .library import DenoiseLibrary

COMBINED, NOISY_IMAGE = "Combined", "Noisy Image"
ALBEDO, NORMAL = "Denoising Albedo", "Denoising Normal"
_GUIDES = {"NONE": (), "ALBEDO": (ALBEDO,), "ALBEDO_NORMAL": (ALBEDO, NORMAL)}
_INPUTS = {ALBEDO: "albedo", NORMAL: "normal"}  # as the library calls them


def guiding_passes(settings: RenderSettings) -> tuple[str, ...]:
    """Passes that a render needs so that it can be denoised with `settings`; none where it is not."""
    return _GUIDES[settings.denoise_inputs] if settings.denoise == "ON" else ()


def denoised(passes: Mapping[str, np.ndarray], settings: RenderSettings, library: DenoiseLibrary) -> np.ndarray:
    """The pass "Combined" without its noise, float32, of its shape; alpha stays as it is.

    With the prefilter ACCURATE the guiding passes are filtered first, each alone, and then taken as free of noise; with
    NONE they are taken so as they are; with FAST they are taken as noisy, and all is filtered at once.

    Args:
        passes: linear float32 by name, shape [height, width, channels]; with "Combined" and `guiding_passes(settings)`.

    Raises:
        RayBatchError: the library's own message.
    """
    quality = settings.denoise_quality
    guides = {_INPUTS[name]: passes[name] for name in guiding_passes(settings)}
    if settings.denoise_prefilter == "ACCURATE":
        guides = {name: library.filtered({name: pixels}, {}, quality) for name, pixels in guides.items()}
    picture = passes[COMBINED]
    flags = {"hdr": True, "cleanAux": bool(guides) and settings.denoise_prefilter != "FAST"}
    result = np.array(picture, np.float32)
    result[..., :3] = library.filtered({"color": picture[..., :3]} | guides, flags, quality)
    return result


def description(settings: RenderSettings, library: DenoiseLibrary, seconds: float) -> dict[str, Any]:
    """What the statistics say of a denoised picture."""
    return {
        "library": f"Open Image Denoise {library.version}",
        "path": library.path,
        "inputs": settings.denoise_inputs,
        "prefilter": settings.denoise_prefilter,
        "quality": settings.denoise_quality,
        "seconds": round(seconds, 6),
    }
