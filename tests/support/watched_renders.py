"""Renders that are watched, stopped and gone on with: what tests of rounds share."""

import contextlib

import numpy as np
import pytest

from raybatch_addon.core.film import Film
from raybatch_addon.core.observers import RenderObserver
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront import integrator
from raybatch_addon.core.wavefront.render import rendering
from tests.support import scenes

PASSES = ("Combined", "Depth", "Normal", "Position")
FRAME = Frame(24, 20, passes=PASSES)
# Renders of these tests are of `scenes.mixed` with these settings where they can be: kernels are compiled for what a
# scene and its settings need
SETTINGS = RenderSettings(sample_count=7, bounce_max=5, roulette_bounce=2, clamp_indirect=3.0)
HALVES = SETTINGS.replace(error_estimate="ON")
TARGET = SETTINGS.replace(sample_count=512, error_target=0.05, tile_size=9)


@pytest.fixture(scope="module", name="halves")
def halves_film(session):
    """The film of `HALVES`, rendered in one round."""
    return session.render(scenes.mixed(FRAME), HALVES)


class Watcher(RenderObserver):
    """Wants snapshots at `wanted`."""

    def __init__(self, wanted):
        self.wanted, self.got = wanted, []

    def snapshot_samples(self, sample_count):
        return self.wanted

    def on_snapshot(self, snapshot):
        self.got.append(snapshot)

    @property
    def samples(self) -> list[int]:
        return [snapshot.samples for snapshot in self.got]


def box_of(tile) -> tuple[int, int, int, int]:
    """Where a tile that is shown, or rendered, is."""
    return tile.x, tile.y, tile.width, tile.height


def assert_same(passes, expected):
    assert passes.keys() == expected.keys()
    for name in expected:
        assert np.array_equal(passes[name], expected[name]), name


def assert_same_film(film: Film, expected: Film) -> None:
    """Bit for bit, with the same samples of each pixel, and the same halves."""
    assert film.complete
    assert np.array_equal(film.counts, expected.counts)
    assert_same(film.passes, expected.passes)
    for mine, theirs in zip(film.halves or (), expected.halves or (), strict=True):
        assert_same(mine.passes, theirs.passes)


def rounded_anew(film: Film) -> dict[str, np.ndarray]:
    """The film's passes, made of the sums on the host."""
    return film.merge(Film.empty(FRAME)).passes


@contextlib.contextmanager
def stopping(after: int):
    """Tiles are told to stop when they have asked `after` times; they bring their paths to the end, however long that
    takes.
    """
    render, asked = integrator.TileIntegrator.render, [0]

    def stopped(self, state, first, count, stop, most):
        def tells():
            asked[0] += 1
            return stop() or asked[0] > after

        return render(self, state, first, count, tells, most)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rendering, "DRAIN_SECONDS", 1e9)
        patch.setattr(integrator.TileIntegrator, "render", stopped)
        yield


class WatchedSession:
    """A session whose renders are watched, stopped and gone on with, as `random` says (None: they are left alone)."""

    def __init__(self, session):
        self.session, self.random, self.stops = session, None, 0

    def __getattr__(self, name):
        return getattr(self.session, name)

    def render(self, scene, settings):
        if self.random is None:
            return self.session.render(scene, settings)
        film = None
        for turn in range(4):
            watcher = Watcher(self.random.integers(1, settings.sample_count + 1, self.random.integers(0, 5)).tolist())
            after = 10**9 if turn == 3 else int(2.0 ** self.random.uniform(0, 10))
            with stopping(after):
                film = self.session.render(scene, settings, observers=[watcher], resume=film)
            assert not film.statistics["invalid_samples"]
            waited = film.statistics["batching"]
            if waited:
                assert waited["rays"] == waited["finished"] == film.statistics["rays"]["total"]
            if film.complete:
                break
            self.stops += 1
            counts = film.counts.reshape(-1)
            assert counts.min() < settings.sample_count and film.resume_state is not None
        return film
