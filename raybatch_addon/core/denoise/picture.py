"""The denoised picture of a film: which passes guide it, and how they are filtered before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..scene.passes import CATCHER_PASS, CATCHER_SHADOWS
from ..settings.settings import RenderSettings
from .library import DenoiseLibrary

COMBINED, NOISY_IMAGE = "Combined", "Noisy Image"
_ALBEDO, _NORMAL = "Denoising Albedo", "Denoising Normal"
NOISY_CATCHER = "Noisy Shadow Catcher"
_GUIDES = {"NONE": (), "ALBEDO": (_ALBEDO,), "ALBEDO_NORMAL": (_ALBEDO, _NORMAL)}
_INPUTS = {_ALBEDO: "albedo", _NORMAL: "normal"}  # as the library calls them


def guiding_passes(settings: RenderSettings) -> tuple[str, ...]:
    """Passes that a render needs so that it can be denoised with `settings`; none where it is not."""
    return _GUIDES[settings.denoise_inputs] if settings.is_on("denoise") else ()


def noisy_pictures(passes: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What `denoised` and `denoised_catchers` take the place of among `passes`, by the names that it is kept by."""
    kept = {NOISY_IMAGE: passes[COMBINED]}
    return kept | {NOISY_CATCHER: passes[CATCHER_PASS]} if CATCHER_PASS in passes else kept


def denoised(
    passes: Mapping[str, np.ndarray],
    settings: RenderSettings,
    library: DenoiseLibrary,
    given_up: Callable[[], bool] | None = None,
) -> np.ndarray:
    """The pass "Combined" without its noise, float32, of its shape; alpha stays as it is, unless the shadows of shadow
    catchers are in it.

    With the prefilter ACCURATE the guiding passes are filtered first, each alone, and then taken as free of noise; with
    NONE they are taken so as they are; with FAST they are taken as noisy, and all is filtered at once.

    Args:
        passes: linear float32 by name, shape [height, width, channels]; with "Combined" and `guiding_passes(settings)`.
        given_up: as for `DenoiseLibrary.filtered`.

    Raises:
        DenoiseStoppedError: `given_up` said so.
        RayBatchError: the library's own message.
    """
    picture, filtered = passes[COMBINED], _filter(passes, settings, library, given_up)
    result = np.array(picture, np.float32)
    result[..., :3] = filtered(picture[..., :3], True)
    if CATCHER_SHADOWS in passes and (picture[..., 3] != 1).any():
        result[..., 3] = filtered(np.repeat(picture[..., 3:], 3, -1), False).mean(-1)
    return result


def denoised_catchers(
    passes: Mapping[str, np.ndarray],
    settings: RenderSettings,
    library: DenoiseLibrary,
    given_up: Callable[[], bool] | None = None,
) -> dict[str, np.ndarray]:
    """The pass of shadow catchers by its name, without its noise, if it is among `passes`; as `denoised` otherwise."""
    if CATCHER_PASS not in passes:
        return {}
    return {CATCHER_PASS: _filter(passes, settings, library, given_up)(passes[CATCHER_PASS], True)}


def _filter(
    passes: Mapping[str, np.ndarray],
    settings: RenderSettings,
    library: DenoiseLibrary,
    given_up: Callable[[], bool] | None,
) -> Callable[[np.ndarray, bool], np.ndarray]:
    """Function (picture, hdr) that filters a picture of three channels with the guiding passes among `passes`."""
    quality = settings.denoise_quality
    guides = {_INPUTS[name]: passes[name] for name in guiding_passes(settings)}
    if settings.denoise_prefilter == "ACCURATE":
        guides = {name: library.filtered({name: pixels}, {}, quality, given_up) for name, pixels in guides.items()}
    flags = {"cleanAux": bool(guides) and settings.denoise_prefilter != "FAST"}

    def filtered(picture: np.ndarray, hdr: bool) -> np.ndarray:
        return library.filtered({"color": picture} | guides, {"hdr": hdr, **flags}, quality, given_up)

    return filtered


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
