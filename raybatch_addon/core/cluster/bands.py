"""Bands of a frame: rows whose pixels get their samples in tasks of their own, so that a film is small beside the work
in it. Pixels do not depend on one another: a band has the bits that its rows have in the whole frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from ..checkpoint.file import KeptFilm
from ..checkpoint.samples import TileSamples, samples_as_arrays, samples_of_arrays
from ..scene.description import Scene
from ..wavefront.adaptive.active_pixels import ActivePixels

Region = tuple[int, int, int, int]  # x0, y0, x1, y1 [pixels]

# A band has about so many pixels: its film takes 18 MB without further passes, and a GPU still has enough to do
BAND_PIXELS = 1 << 18


def bands_of(region: Region) -> list[Region]:
    """The bands of `region`, of about equal heights, from the first row on."""
    x0, y0, x1, y1 = region
    count = min(max(round((x1 - x0) * (y1 - y0) / BAND_PIXELS), 1), y1 - y0)
    rows = [y0 + (y1 - y0) * i // count for i in range(count + 1)]
    return [(x0, first, x1, end) for first, end in itertools.pairwise(rows)]


def scene_of_band(scene: Scene, band: Region) -> Scene:
    """`scene` whose frame is rendered in `band` alone."""
    return scene if tuple(scene.frame.region) == band else replace(scene, frame=replace(scene.frame, border=band))


def active_in_band(active: ActivePixels, band: Region) -> ActivePixels:
    """The pixels of `band` among those of `active`, without looks."""
    (x0, y0, _, _), (left, first, right, end) = active.region, band
    return ActivePixels(band, active.threshold, active.stopped[first - y0 : end - y0, left - x0 : right - x0].copy())


def film_of_bands(films: Sequence[KeptFilm], region: Region) -> KeptFilm:
    """The film of `region` of those of all its bands, which have the same samples."""
    first = films[0]
    if len(films) == 1:
        return first
    identity = replace(first.identity, region=region)
    rectangle = identity.part.rectangle
    progress = replace(
        first.progress,
        tiles=(rectangle,),
        items_begun=first.progress.items_begun[:1],
        invalid_samples=sum(film.progress.invalid_samples for film in films),
    )
    halves = tuple(
        samples_of_arrays(
            identity.part,
            samples_as_arrays(
                identity.part, [TileSamples(film.identity.part.rectangle, film.halves[half]) for film in films]
            ),
        )
        for half in range(len(first.halves))
    )
    return KeptFilm(identity, progress, halves)
