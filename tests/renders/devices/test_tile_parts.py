"""Tiles that are rendered in parts, as several GPUs do: here by the workers of one device."""

from collections import Counter

import numpy as np
import pytest

from raybatch_addon.core.job import Job
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.render import rendering, steps
from raybatch_addon.core.wavefront.render.deal import Deal
from raybatch_addon.core.wavefront.render.steps import TileParts
from tests.support import scenes
from tests.support.watched_renders import FRAME, SETTINGS, assert_same_film, stopping

pytestmark = pytest.mark.usefixtures("general_kernels")

WHOLE = SETTINGS.replace(thread_count=3, tile_size=8, tile_order="TILE_FIRST", sample_count=12)
TILES = 9
WAYS = {
    "plain": {},
    "halves": dict(error_estimate="ON"),
    "adaptive": dict(adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8, sample_count=32),
    "rounds": dict(error_target=1e-9, sample_count=16),
}


@pytest.fixture
def parts(monkeypatch):
    """Renders are in parts, however few paths there are."""
    monkeypatch.setattr(Job, "tile_parts", lambda self, devices: TileParts())
    monkeypatch.setattr(steps, "PART_LEAST", 1)


def box_of(tile) -> tuple[int, int, int, int]:
    return tile.x, tile.y, tile.width, tile.height


@pytest.mark.parametrize("way", WAYS)
def test_the_film_is_that_of_whole_tiles(session, monkeypatch, request, way):
    settings, shown = WHOLE.replace(**WAYS[way]), []
    expected = session.render(scenes.mixed(FRAME), settings)
    request.getfixturevalue("parts")
    film = session.render(scenes.mixed(FRAME), settings, on_tile=shown.append)
    assert_same_film(film, expected)
    assert film.statistics["rays"] == expected.statistics["rays"]
    shares = Counter(map(box_of, shown))
    assert len(shares) == TILES and (way == "adaptive" or min(shares.values()) >= 2)


def test_a_part_is_a_picture_of_so_many_samples(session, request):
    """Each picture of a tile that is shown is the one of a render of that many samples, and of more than the last."""
    shown, pictures = {}, []
    for samples in range(1, WHOLE.sample_count + 1):
        pictures.append(session.render(scenes.mixed(FRAME), WHOLE.replace(sample_count=samples)))
    request.getfixturevalue("parts")
    session.render(
        scenes.mixed(FRAME), WHOLE, on_tile=lambda tile: shown.setdefault(box_of(tile), []).append(tile.passes)
    )
    for (x, y, width, height), its in shown.items():
        known = [each.part(x, y, width, height)["Combined"] for each in pictures]
        counts = [next(n for n, each in enumerate(known, 1) if np.array_equal(each, a["Combined"])) for a in its]
        assert counts == sorted(set(counts)) and counts[-1] == WHOLE.sample_count
        assert counts[0] <= max(1, WHOLE.sample_count // 4)


@pytest.mark.parametrize("way", ["plain", "halves"])
def test_a_stopped_render_goes_on(session, parts, way):
    settings = WHOLE.replace(**WAYS[way])
    expected = session.render(scenes.mixed(FRAME), settings)
    with stopping(9):
        film = session.render(scenes.mixed(FRAME), settings)
    assert not film.complete and film.resume_state
    assert_same_film(session.render(scenes.mixed(FRAME), settings, resume=film), expected)


def test_what_took_long_in_one_round_is_first_in_the_next(session, parts, monkeypatch):
    dealt, begin = [], Deal.__init__

    def noted(self, waiting):
        dealt.append(list(waiting))
        begin(self, dealt[-1])

    monkeypatch.setattr(Deal, "__init__", noted)
    session.render(scenes.mixed(FRAME), WHOLE.replace(**WAYS["rounds"]))
    assert len(dealt) > 1
    assert all(np.isinf([seconds for _, _, seconds in dealt[0]]))
    assert all(0.0 < seconds < np.inf for round_ in dealt[1:] for _, _, seconds in round_)


def test_what_others_have_taken_is_left_to_nobody(session, parts, monkeypatch):
    """Shares are of what nobody has taken: together parts under way and what is left are all that was to be begun."""
    step_end, found = rendering.Rendering._step_end, []

    def noted(self, integrator: TileIntegrator, halves):
        share, inner = [], self._parts.samples

        def samples(tile, left, pixels, its):
            share.append(its * pixels * len(self._integrators) / steps.LEFT_SHARE)
            return inner(tile, left, pixels, its)

        monkeypatch.setattr(self._parts, "samples", samples)
        before = self._state.items_open
        end = step_end(self, integrator, halves)
        monkeypatch.setattr(self._parts, "samples", inner)
        found.append((before, share[0], len(self._taken)))
        return end

    monkeypatch.setattr(rendering.Rendering, "_step_end", noted)
    session.render(scenes.mixed(FRAME), WHOLE)
    assert found[0][0] == found[0][1] == FRAME.pixel_count * WHOLE.sample_count
    assert all(left <= before for before, left, _ in found)
    assert any(left < before for before, left, taken in found if taken > 1)
