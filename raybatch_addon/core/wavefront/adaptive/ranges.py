"""Ranges of samples: which may be rendered by themselves, and which pixels get the samples of one."""

from __future__ import annotations

import warp as wp

from ...errors import RayBatchError
from ...film import Film
from ...scene.description import Frame
from ...settings.settings import RenderSettings
from ..plan.plan import Choice
from .active_pixels import ActivePixels
from .looks import Looks


def first_active(
    frame: Frame, settings: RenderSettings, sample_first: int, after: Film | None, device: wp.Device
) -> ActivePixels | None:
    """Pixels that get the samples from `sample_first` on; None where all get all samples.

    Raises `RayBatchError` for a range whose pixels are not known before it: one that goes beyond a look at the noise
    without having all samples before, or that begins after one without the film that was looked at, `after`.
    """
    if not settings.is_adaptive:
        return None
    looks, end = Looks.of(settings), sample_first + settings.sample_count
    if sample_first == 0 or looks is None:
        return ActivePixels.all_of(frame.region, settings.noise_threshold)
    last, following = looks.last_until(sample_first), looks.after(sample_first)
    if end > following:
        raise RayBatchError(
            f"samples {sample_first} to {end} cannot be rendered by themselves: adaptive sampling decides after "
            f"{following} samples which pixels go on, by all samples until then; end the range there, merge, and "
            "render the rest with after=the merged film, or set adaptive_sampling to OFF"
        )
    if last == 0:
        return ActivePixels.all_of(frame.region, settings.noise_threshold)
    if after is None or not after.halves or after.counts.max(initial=0) != last or _place(after) != _place(frame):
        raise RayBatchError(
            f"samples from {sample_first} on need the film of samples 0 to {last} of the same frame, by which adaptive "
            "sampling decided which pixels go on; give it with after=, merged of its ranges if need be, or set "
            "adaptive_sampling to OFF"
        )
    return ActivePixels.after(after, last, settings.noise_threshold, device)


def chosen_looks(settings: RenderSettings) -> dict[str, Choice]:
    """What `adaptive_samples_min` is where it was left open."""
    looks = Looks.of(settings)
    if looks is None or settings.adaptive_samples_min:
        return {}
    return {"adaptive_samples_min": Choice(looks.first, "by noise_threshold")}


def _place(picture: Film | Frame) -> tuple:
    return picture.width, picture.height, tuple(picture.region)
