"""How a live picture grows: from coarse pixels to fine ones, then from few samples to many. Pure policy."""

from __future__ import annotations

from dataclasses import replace

from ..scene.description import Scene
from ..settings.settings import RenderSettings

# What the first picture after an edit is planned to take, without a tree's build [s]
FIRST_SECONDS = 0.08
# Part of it that does not depend on the number of pixels [s]
FIXED_SECONDS = 0.03
# Side of the coarsest pixels, in pixels of the finest picture, and that of the first picture of all
COARSEST = 8
UNKNOWN = 4
# A picture that refines is shown about as often, once there are samples enough [s]
SHOWN_SECONDS = 0.5


class Pace:
    """The time that a sample of a pixel takes, measured."""

    def __init__(self) -> None:
        self._seconds_a_pixel: float | None = None

    def note(self, pixel_samples: float, seconds: float) -> None:
        """Take note that `pixel_samples` samples, summed over all pixels, took `seconds` without a build."""
        if pixel_samples > 0:
            self._seconds_a_pixel = max(seconds - FIXED_SECONDS, 0.0) / pixel_samples

    def seconds(self, pixel_samples: float) -> float | None:
        """What so many samples of pixels will take; None: nobody knows yet."""
        return None if self._seconds_a_pixel is None else _seconds(self._seconds_a_pixel, pixel_samples)

    def divisors(self, pixel_count: float) -> list[int]:
        """Sides of the pixels of one picture after another, in pixels of the last one, whose side is 1: halved each
        time, from the finest on that is planned to be there in `FIRST_SECONDS`.
        """
        if self._seconds_a_pixel is None:
            first = UNKNOWN
        else:
            first = 1
            while first < COARSEST and _seconds(self._seconds_a_pixel, pixel_count / first**2) > FIRST_SECONDS:
                first *= 2
        found = [first]
        while found[-1] > 1:
            found.append(found[-1] // 2)
        return found

    def marks(self, sample_count: int, pixel_count: int, powers_alone: bool = False) -> list[int]:
        """Sample counts at which a picture of so many pixels is shown: 1, 2, 4 and so on, and between them as often as
        `SHOWN_SECONDS` lets, unless `powers_alone`.
        """
        powers = {1 << i for i in range(sample_count.bit_length()) if 1 << i <= sample_count}
        marks = powers | {sample_count}
        a_sample = self.seconds(pixel_count)
        if not powers_alone and a_sample is not None:
            step, done = max(1, int(SHOWN_SECONDS / a_sample)), 1
            while done < sample_count:
                marks.add(done)
                done += min(step, done)
        return sorted(marks)


def _seconds(a_pixel: float, pixel_samples: float) -> float:
    return FIXED_SECONDS + a_pixel * pixel_samples


def coarse(scene: Scene, side: int) -> Scene:
    """`scene` with pixels of `side` times the width and height; those at the right and the upper edge reach beyond the
    frame where it is no multiple.
    """
    if side == 1:
        return scene
    frame, (left, right, bottom, top) = scene.frame, scene.camera.window
    width, height = -(-frame.width // side), -(-frame.height // side)
    border = None
    if frame.border is not None:
        x0, y0, x1, y1 = frame.border
        border = (x0 // side, y0 // side, -(-x1 // side), -(-y1 // side))
    window = (
        left,
        left + (right - left) * (width * side / frame.width),
        bottom,
        bottom + (top - bottom) * (height * side / frame.height),
    )
    return replace(
        scene,
        camera=replace(scene.camera, window=window),
        frame=replace(frame, width=width, height=height, border=border),
    )


def without_splits(settings: RenderSettings) -> RenderSettings:
    """`settings` whose trees split no triangles unless that is asked for: the next edit would wait until they have, and
    trees that follow edits lose their splits.
    """
    return settings.replace(spatial_splits="OFF") if settings.spatial_splits == "AUTO" else settings
