"""Ranges of samples: which may be rendered by themselves, and which pixels get the samples of one."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...errors import RayBatchError
from ...film import Film
from ...scene.description import Frame
from ...settings.settings import RenderSettings
from ..plan.plan import Choice
from .active_pixels import ActivePixels
from .looks import Looks


def first_active(
    frame: Frame, settings: RenderSettings, sample_first: int, after: Film | ActivePixels | None, device: wp.Device
) -> ActivePixels | None:
    """Pixels that get the samples from `sample_first` on; None where all get all samples. `after` is the film that
    was looked at before them, or what the look found.

    Raises `RayBatchError` for a range whose pixels are not known before it: one that goes beyond a look at the noise
    without having all samples before, or that begins after one without the film that was looked at, `after`. So is one
    with an error target, which is that of all samples.
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
    if settings.error_target > 0:
        raise RayBatchError(
            f"error_target is set, but of samples from {sample_first} on alone nobody knows the error of the whole "
            "film; set error_target to 0, or render all samples at once"
        )
    active = None
    if isinstance(after, ActivePixels):
        if after.region == tuple(frame.region) and after.threshold == settings.noise_threshold:
            active = after.copy()
    elif after is not None and after.halves and _place(after) == _place(frame):
        active = _active_after(after, looks, last, settings.noise_threshold, device)
    if active is None:
        raise RayBatchError(
            f"samples from {sample_first} on need the film of samples 0 to {last} of the same frame, by which adaptive "
            "sampling decided which pixels go on; give it with after=, finished, and merged of its ranges if need be, "
            "or set adaptive_sampling to OFF"
        )
    return active


def check_after(
    settings: RenderSettings, sample_first: int, resume: Film | None, after: Film | ActivePixels | None
) -> None:
    """Raises `RayBatchError` where a film is given with `after` and nobody would look at it."""
    if after is None:
        return
    why = ""
    if resume is not None:
        why = "the film to resume knows which pixels go on"
    elif not settings.is_adaptive:
        why = "adaptive_sampling is OFF"
    elif sample_first == 0:
        why = "sample_first is 0, and no look comes before the first sample"
    if why:
        raise RayBatchError(f"the film given with after= would not be used: {why}; leave after= out")


def _active_after(film: Film, looks: Looks, last: int, threshold: float, device: wp.Device) -> ActivePixels | None:
    """Pixels that go on after the look at `last` samples; None where `film` is not that of all samples until then."""
    counts = [int(count) for count in np.unique(film.counts)]
    if not film.complete or not counts or counts[-1] > last or any(looks.last_until(n) != n or n == 0 for n in counts):
        return None
    # where every pixel ended before, the look at which the last ones did says so
    active = ActivePixels.after(film, counts[-1], threshold, device)
    return active if counts[-1] == last or active.share == 0.0 else None


def pixels_can_end(settings: RenderSettings, sample_first: int) -> bool:
    """Whether a look at the noise comes in a render from `sample_first` on, or came before it."""
    looks = Looks.of(settings)
    return looks is not None and looks.first <= (sample_first or settings.sample_count)


def chosen_looks(settings: RenderSettings) -> dict[str, Choice]:
    """What `adaptive_samples_min` is where it was left open."""
    looks = Looks.of(settings)
    if looks is None or settings.adaptive_samples_min:
        return {}
    return {"adaptive_samples_min": Choice(looks.first, "by noise_threshold")}


def _place(picture: Film | Frame) -> tuple:
    return picture.width, picture.height, tuple(picture.region)
