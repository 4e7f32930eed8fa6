"""Bands of a frame: their pixels are those of the whole frame, whatever the film holds."""

import dataclasses
import itertools

import numpy as np
import pytest

from raybatch_addon.core.checkpoint.identity import FilmIdentity
from raybatch_addon.core.cluster import bands
from raybatch_addon.core.cluster.bands import active_in_band, bands_of, film_of_bands, scene_of_band
from raybatch_addon.core.cluster.films import kept_of, received_film, sent_film
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.adaptive.active_pixels import ActivePixels
from tests.support import scenes
from tests.support.watched_renders import FRAME, assert_same, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")


@pytest.mark.parametrize("region", [(0, 0, 3840, 2160), (7, 100, 1927, 1180), (0, 5, 1, 6), (0, 0, 9_000_000, 2)])
def test_bands_cover_the_region(region):
    found = bands_of(region)
    assert found[0][:2] == region[:2] and found[-1][2:] == region[2:]
    assert all(a[3] == b[1] and a[0] == b[0] and a[2] == b[2] for a, b in itertools.pairwise(found))
    heights = {each[3] - each[1] for each in found}
    assert max(heights) - min(heights) <= 1 and min(heights) > 0
    pixels = (region[2] - region[0]) * (region[3] - region[1])
    assert len(found) == min(max(round(pixels / bands.BAND_PIXELS), 1), region[3] - region[1])


@pytest.mark.parametrize("border", [None, (3, 2, 20, 17)])
@pytest.mark.parametrize("halves", ["OFF", "ON"])
def test_films_of_bands_make_that_of_the_frame(session, monkeypatch, border, halves):
    frame = dataclasses.replace(FRAME, border=border or FRAME.border)
    scene, settings = scenes.mixed(frame), RenderSettings(sample_count=3, bounce_max=3, error_estimate=halves)
    region = tuple(map(int, frame.region))
    monkeypatch.setattr(bands, "BAND_PIXELS", 100)
    whole, films = FilmIdentity.of(scene, settings, session.device), []
    for band in bands_of(region):
        film = session.render(scene_of_band(scene, band), settings)
        kept = kept_of(film, dataclasses.replace(whole, region=band), 0, settings.sample_order)
        films.append(received_film(sent_film(kept, []))[0])
    assert len(films) > 2
    made, expected = film_of_bands(films, region), session.render(scene, settings)
    film = made.film()
    film.complete = True
    assert_same_film(film, expected)
    for mine, theirs in zip(film.halves or (), expected.halves or (), strict=True):
        assert_same(mine.passes, theirs.passes)
    assert made.identity == whole and made.progress.done == 3


def test_pixels_that_ended_are_those_of_the_band():
    stopped = np.arange(20 * 24, dtype=np.int32).reshape(20, 24)
    active = ActivePixels((10, 5, 34, 25), 0.1, stopped)
    found = active_in_band(active, (10, 9, 34, 12))
    assert found.region == (10, 9, 34, 12) and found.threshold == 0.1
    assert np.array_equal(found.stopped, stopped[4:7]) and not found.looks
