"""Renders that go on from their checkpoints, however often and under whatever schedule: the film is that of one."""

import json
import time
import zipfile

import numpy as np
import pytest

from raybatch_addon.core.checkpoint import checkpoint as checkpoints
from raybatch_addon.core.checkpoint.checkpoint import SHARE_MOST, Checkpoint
from raybatch_addon.core.checkpoint.file import load_kept
from raybatch_addon.core.checkpoint.merging import save_merged
from raybatch_addon.core.film import Film
from raybatch_addon.core.wavefront.render import rendering
from tests.support import scenes, schedule_scenes
from tests.support.watched_renders import FRAME, HALVES, SETTINGS, TARGET, assert_same, rounded_anew

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

ADAPTIVE = SETTINGS.replace(sample_count=40, adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8)
SCHEDULES = (
    dict(tile_size=7, ray_count=60, thread_count=1),
    dict(tile_size=64, ray_count=300, sample_order="PIXEL_FIRST"),
    dict(batching="ON", ray_count=90, tile_size=9),
    dict(ray_count=150, thread_count=2, tile_size=11),
)


@pytest.fixture(autouse=True)
def looked_at_often(monkeypatch):
    """Renders here take less time than there usually is between two looks."""
    monkeypatch.setattr(rendering, "POLL_SECONDS", 0.001)


class EagerCheckpoint(Checkpoint):
    """Is due whenever chance has it, and asks the render to stop after so many copies."""

    def __init__(self, path, seed, copies):
        super().__init__(path)
        self._random, self._left = np.random.default_rng(seed), copies

    def is_due(self):
        return self._random.random() < 0.5

    def keep(self, state):
        self._left -= 1
        super().keep(state)
        self.wait()

    def is_over(self):
        return self._left <= 0


def render_in_parts(session, scene, settings, path) -> tuple[Film, int]:
    """The film, and how many renders it took: each is stopped after some copies, and has another schedule."""
    for number in range(400):
        checkpoint = EagerCheckpoint(path, number, copies=2)
        film = session.render(
            scene,
            settings.replace(**SCHEDULES[number % len(SCHEDULES)]),
            checkpoint=checkpoint,
            cancelled=checkpoint.is_over,
        )
        if film.complete:
            return film, number + 1
    raise AssertionError("the render does not get on")


@pytest.mark.parametrize("name", schedule_scenes.SCENES)
@pytest.mark.parametrize("estimate", ["OFF", "ON"])
def test_a_film_in_parts_is_that_of_one_render(session, tmp_path, name, estimate):
    scene = schedule_scenes.SCENES[name]()
    settings = schedule_scenes.ESTIMATOR.replace(error_estimate=estimate, sample_count=40)
    expected = session.render(scene, settings)
    film, parts = render_in_parts(session, scene, settings, tmp_path / "a.checkpoint")
    assert parts > 1
    assert_same(film.passes, expected.passes)
    for mine, theirs in zip(film.halves or (), expected.halves or (), strict=True):
        assert_same(mine.passes, theirs.passes)
    assert film.sample_total == expected.sample_total
    assert load_kept(tmp_path / "a.checkpoint").progress.done == settings.sample_count


@pytest.mark.parametrize("settings", [TARGET, ADAPTIVE], ids=["error target", "adaptive"])
def test_what_ends_a_render_ends_it_at_the_same_sample(session, tmp_path, settings):
    expected = session.render(scenes.mixed(FRAME), settings)
    film, parts = render_in_parts(session, scenes.mixed(FRAME), settings, tmp_path / "a.checkpoint")
    assert parts > 1 and np.array_equal(film.counts, expected.counts)
    assert film.statistics["stopped_by"] == expected.statistics["stopped_by"]
    for mine, theirs in zip((film, *film.halves), (expected, *expected.halves), strict=True):
        assert_same(mine.passes, theirs.passes)


@pytest.mark.parametrize("settings", [SETTINGS, HALVES, ADAPTIVE], ids=["plain", "halves", "adaptive"])
def test_more_samples_are_added_to_a_finished_film(session, tmp_path, settings):
    path, more = tmp_path / "a.checkpoint", settings.replace(sample_count=settings.sample_count + 13)
    session.render(scenes.mixed(FRAME), settings, checkpoint=Checkpoint(path))
    checkpoint = Checkpoint(path)
    film = session.render(scenes.mixed(FRAME), more, checkpoint=checkpoint)
    assert checkpoint.samples_before > 0 and film.statistics["rays"]["camera"] < film.sample_total
    assert_same(film.passes, session.render(scenes.mixed(FRAME), more).passes)


def test_a_finished_film_is_shown_and_no_ray_is_traced(session, tmp_path):
    path, shown, reported = tmp_path / "a.checkpoint", [], []
    film = session.render(scenes.mixed(FRAME), HALVES, checkpoint=Checkpoint(path))
    written = path.read_bytes()
    again = session.render(
        scenes.mixed(FRAME), HALVES, checkpoint=Checkpoint(path, report=reported.append), on_tile=shown.append
    )
    assert again.complete and again.statistics["rays"]["total"] == 0 and path.read_bytes() == written
    assert "7 of 7 samples are there" in reported[0]
    assert_same(again.passes, film.passes)
    picture = np.zeros_like(film.passes["Combined"])
    for tile in shown:
        picture[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] = tile.passes["Combined"]
    assert np.array_equal(picture, film.passes["Combined"])


def test_samples_that_are_not_finite_are_still_reported_afterwards(session, tmp_path):
    path = tmp_path / "a.checkpoint"
    session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(members["header.json"])
    header["progress"]["invalid_samples"] = 3
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | {"header.json": json.dumps(header).encode()}).items():
            archive.writestr(name, data)
    film = session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))
    assert film.statistics["invalid_samples"] == 3 and "3 samples were not finite" in film.statistics["warnings"][0]


def test_a_render_that_is_stopped_before_its_first_ray_leaves_what_is_there(session, tmp_path):
    path = tmp_path / "a.checkpoint"
    film = session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path), cancelled=lambda: True)
    assert not film.complete and not path.exists()
    session.render(scenes.mixed(FRAME), SETTINGS.replace(sample_count=3), checkpoint=Checkpoint(path))
    written = path.read_bytes()
    session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path), cancelled=lambda: True)
    assert path.read_bytes() == written


def test_the_interval_grows_where_copies_take_long(session, tmp_path, monkeypatch):
    """On a clock that the copies themselves turn."""
    now = [0.0]
    monkeypatch.setattr(checkpoints.time, "perf_counter", lambda: now[0])
    write = checkpoints.write_kept

    def slow(*arguments):
        now[0] += 30.0
        return write(*arguments)

    monkeypatch.setattr(checkpoints, "write_kept", slow)
    kept = Checkpoint(tmp_path / "a.checkpoint", 60.0)
    film = session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(tmp_path / "b.checkpoint"))
    assert film.statistics["checkpoint"]["interval"] == 30.0 / SHARE_MOST
    kept.start()
    assert not kept.is_due()
    now[0] += 60.0
    assert kept.is_due()


def test_a_file_is_no_larger_than_it_may_be(session, tmp_path):
    """Even of samples with digits that nothing compresses."""
    film, pixels = Film.empty(FRAME, 2), 24 * 20
    random = np.random.default_rng(1)
    path = tmp_path / "a.checkpoint"
    session.render(scenes.mixed(FRAME), HALVES, checkpoint=Checkpoint(path))
    kept = load_kept(path)
    for half in kept.halves:
        half.sums.window[:] = random.integers(-(2**62), 2**62, half.sums.window.shape)
    save_merged(path, kept)
    assert film.layout.count == 6
    channels = film.layout.count + sum(len(values) // pixels for values in kept.halves[0].first.values())
    assert path.stat().st_size < 40 * pixels * channels
    for half, again in zip(kept.halves, load_kept(path).halves, strict=True):
        assert np.array_equal(rounded(half), rounded(again))


def rounded(samples) -> np.ndarray:
    return samples.sums.sums()


def test_a_film_that_was_kept_is_made_of_its_sums(session, tmp_path):
    path = tmp_path / "a.checkpoint"
    film = session.render(scenes.mixed(FRAME), HALVES, checkpoint=Checkpoint(path))
    kept = load_kept(path).film()
    assert_same(kept.passes, rounded_anew(film))
    assert_same(kept.passes, film.passes)


def test_a_copy_stays_as_it_was_while_the_render_goes_on(session, tmp_path, monkeypatch):
    """It is packed and written when many more samples are there."""
    write, written = checkpoints.write_kept, []

    def late(path, *kept):
        time.sleep(0.1)
        size = write(path, *kept)
        written.append(load_kept(path))
        return size

    monkeypatch.setattr(checkpoints, "write_kept", late)
    endless = SETTINGS.replace(sample_count=10_000_000, ray_count=500)
    checkpoint = Checkpoint(tmp_path / "a.checkpoint", 0.01)
    session.render(scenes.mixed(FRAME), endless, checkpoint=checkpoint, cancelled=lambda: len(written) > 1)
    for kept in written:
        begun = sum(map(sum, kept.progress.items_begun))
        assert kept.film().sample_total == kept.progress.done * 24 * 20 + begun > 0
