"""The denoised picture of a film, in Blender and in scripts."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable

import numpy as np

from ..core.convergence.halves import filtered_half_error
from ..core.denoise.library import DenoiseLibrary, DenoiseStoppedError
from ..core.denoise.picture import COMBINED, denoised, denoised_catchers, description, guiding_passes, noisy_pictures
from ..core.film import Film
from ..core.observers import Tile
from ..core.scene.description import Scene
from ..core.settings.settings import RenderSettings


def with_guides(scene: Scene, settings: RenderSettings) -> Scene:
    """`scene` with the passes that guide the denoiser among those of its frame."""
    passes = dict.fromkeys((*scene.frame.passes, *guiding_passes(settings)))
    return dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=tuple(passes)))


def denoise_film(
    film: Film, settings: RenderSettings, library: DenoiseLibrary, cancelled: Callable[[], bool] | None = None
) -> None:
    """Make the denoised picture of `film`, which is then `film.made["Combined"]` beside "Noisy Image", and the same
    of shadow catchers.

    Its sums and passes stay as they are; its statistics say what was done under `denoise`, with the error of the
    denoised halves where the film has halves. Of a cancelled render only noisy ones are made, and where `cancelled`,
    which is asked several times a second, says so meanwhile. Raises `RayBatchError`.
    """
    passes = film.passes
    film.made = noisy_pictures(passes)
    if not film.complete:
        return
    with contextlib.suppress(DenoiseStoppedError):
        _denoise(film, passes, settings, library, cancelled)


def _denoise(
    film: Film,
    passes: dict[str, np.ndarray],
    settings: RenderSettings,
    library: DenoiseLibrary,
    cancelled: Callable[[], bool] | None,
) -> None:
    start = time.perf_counter()
    made = film.made | {COMBINED: denoised(passes, settings, library, cancelled)}
    made |= denoised_catchers(passes, settings, library, cancelled)
    record = description(settings, library, time.perf_counter() - start)
    if film.halves:
        halves = [half.passes for half in film.halves]
        noisy = [half[COMBINED][..., :3] for half in halves]
        clean = [denoised(half, settings, library, cancelled)[..., :3] for half in halves]
        record["error_of_halves"] = dataclasses.asdict(filtered_half_error(*noisy, *clean))
    film.made = made
    film.statistics["denoise"] = record


def whole_tile(film: Film) -> Tile:
    """The region of `film` as one tile, as it is shown."""
    x0, y0, x1, y1 = film.region
    return Tile(x0, y0, x1 - x0, y1 - y0, film.shown)
