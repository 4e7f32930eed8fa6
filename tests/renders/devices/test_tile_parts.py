"""Tiles that are rendered in parts, as several GPUs do: here by the workers of one device."""

import math
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.job import Job
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import rendering, steps
from raybatch_addon.core.wavefront.render.deal import Deal
from raybatch_addon.core.wavefront.render.steps import TileParts
from raybatch_addon.core.wavefront.scheduler import Rectangle
from raybatch_addon.core.wavefront.tile_state import TileState
from tests.support import scenes
from tests.support.watched_renders import FRAME, SETTINGS, assert_same, assert_same_film, box_of, stopping

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


@pytest.fixture
def begun(monkeypatch):
    """The boxes of tiles, as workers begin to render them. One that was begun `most` times is not gone on with before
    the render is to stop.
    """
    made, render = SimpleNamespace(boxes=[], most=math.inf), integrator.TileIntegrator.render

    def noted(self, state, first, count, stop, items):
        made.boxes.append(state.tile.box)
        while made.boxes.count(state.tile.box) > made.most and not stop():
            time.sleep(0.001)
        return render(self, state, first, count, stop, items)

    monkeypatch.setattr(integrator.TileIntegrator, "render", noted)
    return made


@pytest.mark.parametrize("way", WAYS)
def test_the_film_is_that_of_whole_tiles(session, begun, request, way):
    settings, shown, rounds = WHOLE.replace(**WAYS[way]), [], []
    expected = session.render(scenes.mixed(FRAME), settings, on_tile=rounds.append)
    whole = Counter(begun.boxes)
    begun.boxes.clear()
    request.getfixturevalue("parts")
    film = session.render(scenes.mixed(FRAME), settings, on_tile=shown.append)
    assert_same_film(film, expected)
    assert film.statistics["rays"] == expected.statistics["rays"]
    parts = Counter(begun.boxes)
    assert len(parts) == TILES and (way == "adaptive" or all(parts[box] > whole[box] for box in parts))
    assert Counter(map(box_of, shown)) == Counter(map(box_of, rounds))  # once a round, however many parts it had


def test_parts_that_take_long_are_seen(session, request, monkeypatch):
    """Each picture of a tile that is shown is the one of a render of that many samples, and of more than the last."""
    monkeypatch.setattr(rendering, "PART_SEEN_SECONDS", 0.0)
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
def test_parts_are_seen_where_a_render_is_stopped(session, begun, parts, way):
    """When all tiles have their first parts it is cancelled: each is shown as a render of so many samples shows it."""
    settings, shown = WHOLE.replace(**WAYS[way]), {}
    expected = session.render(scenes.mixed(FRAME), settings)
    workers = expected.statistics["schedule"]["workers"]
    begun.boxes.clear()
    begun.most = 1 + (way == "halves")
    film = session.render(
        scenes.mixed(FRAME),
        settings,
        on_tile=lambda tile: shown.setdefault(box_of(tile), tile.passes),
        cancelled=lambda: len(begun.boxes) == TILES * begun.most + workers,  # all of them wait
    )
    begun.most = math.inf
    assert not film.complete and len(shown) == TILES
    samples = int(film.counts.min())
    assert 0 < samples == film.counts.max() < settings.sample_count
    known = session.render(scenes.mixed(FRAME), settings.replace(sample_count=samples))
    for box, passes in shown.items():
        assert_same(passes, known.part(*box))
    assert_same(film.passes, known.passes)
    assert_same_film(session.render(scenes.mixed(FRAME), settings, resume=film), expected)


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


def test_what_others_have_taken_is_left_to_nobody(monkeypatch):
    """A worker's share is of what nobody has begun, and nobody has taken to begin."""
    parts, asked = TileParts(), []
    monkeypatch.setattr(parts, "samples", lambda tile, left, pixels, share: asked.append(share * pixels) or 1)
    tiles = [(TileState(Rectangle(8 * i, 0, 8, 8)),) for i in range(4)]
    state = SimpleNamespace(items_open=4 * 64 * 100 - 640, samples_of=lambda each: SimpleNamespace(sample_count=100))
    render = SimpleNamespace(_steps=None, _parts=parts, _state=state, _integrators=["a", "b"], _taken={})
    render._items_taken = lambda integrator: rendering.Rendering._items_taken(render, integrator)
    step_end = rendering.Rendering._step_end
    assert step_end(render, "a", tiles[0]) == 1
    assert render._taken == {"a": (tiles[0], 1)}
    tiles[0][0].items_begun = 640  # of a part that goes to sample 30, and of a round that ends at 100
    render._taken = {"a": (tiles[0], 30)}
    step_end(render, "b", tiles[1])
    render._taken = {"a": (tiles[0], 300)}
    step_end(render, "b", tiles[1])
    whole = state.items_open
    expected = [whole, whole - (30 * 64 - 640), whole - (100 * 64 - 640)]
    assert asked == pytest.approx([steps.LEFT_SHARE / 2 * each for each in expected])
