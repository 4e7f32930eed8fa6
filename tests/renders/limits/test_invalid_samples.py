"""Samples that are not finite count as black, and are counted: whatever tiles, halves, parts and stops there are."""

import numpy as np
import pytest

from raybatch_addon.core.film.tile import FilmTiles
from raybatch_addon.core.job import Job
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.render import steps
from raybatch_addon.core.wavefront.render.steps import TileParts
from tests.support import scenes
from tests.support.watched_renders import stopping

pytestmark = pytest.mark.usefixtures("general_kernels")

FRAME = Frame(24, 20)
SETTINGS = RenderSettings(sample_count=6, bounce_max=1, thread_count=2, tile_size=8)
ALL = FRAME.pixel_count * SETTINGS.sample_count
WAYS = {
    "tile first": dict(tile_order="TILE_FIRST"),
    "one tile": dict(tile_size=24),
    "halves": dict(error_estimate="ON"),
    "streaming": dict(schedule="STREAMING"),
}


def blinding() -> scenes.Scene:
    """Two lights of one surface that are more together than a float holds, all around the camera."""
    light = Closure(ClosureKind.EMISSION, (3e38,) * 3)
    around = scenes.box(size=20.0), scenes.translation(0, 0, 0), scenes.material(light, light)
    return scenes.scene([around], frame=FRAME, view=scenes.camera())


@pytest.mark.parametrize("way", WAYS)
def test_each_of_them_is_counted_once(session, way):
    film = session.render(blinding(), SETTINGS.replace(**WAYS[way]))
    assert film.statistics["invalid_samples"] == ALL
    assert (film.counts == SETTINGS.sample_count).all() and not film.passes["Combined"][..., :3].any()


def test_parts_of_tiles_are_counted_in_one_render_alone(session, monkeypatch):
    monkeypatch.setattr(Job, "tile_parts", lambda self, devices: TileParts())
    monkeypatch.setattr(steps, "PART_LEAST", 1)
    parts, note = [], TileParts.note
    monkeypatch.setattr(TileParts, "note", lambda self, tile, *its: parts.append(tile) or note(self, tile, *its))
    for seed in (0, 1):
        film = session.render(blinding(), SETTINGS.replace(tile_order="TILE_FIRST", seed=seed))
        assert film.statistics["invalid_samples"] == ALL
    assert len(parts) > 2 * len(set(parts)) > 2


def test_counts_pass_what_32_bits_hold(session, monkeypatch):
    """A render of so many samples takes too long: counts begin at the largest signed number of 32 bits instead."""
    most = 2**31 - 1
    monkeypatch.setattr(FilmTiles, "begin_render", lambda self: self._invalid.fill_(most))
    film = session.render(blinding(), SETTINGS)
    workers, counted = divmod(film.statistics["invalid_samples"], most)
    assert workers > 0 and counted == ALL


def test_a_render_that_is_gone_on_with_counts_both_parts(session):
    with stopping(4):
        film = session.render(blinding(), SETTINGS)
    begun = film.statistics["invalid_samples"]
    assert 0 < begun == film.sample_total < ALL
    film = session.render(blinding(), SETTINGS, resume=film)
    assert film.complete and film.statistics["invalid_samples"] == ALL == np.sum(film.counts)
