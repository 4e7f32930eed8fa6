"""Adaptive sampling and error targets on a cluster are decided as by one process, after the same samples."""

import pytest

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.checkpoint.file import load_kept
from raybatch_addon.core.cluster.connection import Connection
from raybatch_addon.core.cluster.ranges import RangeDeal
from raybatch_addon.core.cluster.session import ClusterSession
from raybatch_addon.core.errors import RayBatchError
from tests.core.cluster.clusters import SETTINGS, dealing
from tests.support import scenes
from tests.support.running.shares import thorough_but
from tests.support.watched_renders import FRAME, assert_same_film

pytestmark = pytest.mark.usefixtures("general_kernels")

ADAPTIVE = SETTINGS.replace(
    sample_count=64, adaptive_sampling="ON", noise_threshold=0.1, adaptive_samples_min=8, error_estimate="OFF"
)
TARGET = SETTINGS.replace(sample_count=256, error_target=0.01)
CHANGES = {
    "noise": ADAPTIVE,
    "noise of all": ADAPTIVE.replace(noise_threshold=0.6),
    "error": TARGET,
    "noise and error": ADAPTIVE.replace(error_target=0.015, sample_count=128),
    "error not reached": TARGET.replace(error_target=1e-6, sample_count=40),
}


@pytest.fixture
def long_tasks(monkeypatch):
    """Every round has several ranges: of twice as many samples as in other tests, since these films have more."""
    monkeypatch.setattr(RangeDeal, "next", dealing(4))


@pytest.fixture(scope="module", params=CHANGES)
def by_one(request, session):
    """Settings, and the film of one process."""
    settings = CHANGES[request.param]
    return settings, session.render(scenes.mixed(FRAME), settings)


def test_these_films_are_worth_comparing(session):
    counts = session.render(scenes.mixed(FRAME), ADAPTIVE).counts
    assert {8, 64} <= {*counts.tolist()} and len({*counts.tolist()}) > 3
    assert session.render(scenes.mixed(FRAME), TARGET).statistics["stopped_by"] == "error"


def test_the_film_is_that_of_one_process(connection, by_one, long_tasks, cut):
    settings, expected = by_one
    tiles, fractions = [], []
    film = ClusterSession(connection).render(
        scenes.mixed(FRAME), settings, on_tile=tiles.append, on_progress=lambda each: fractions.append(each.fraction)
    )
    assert_same_film(film, expected)
    for name in ("stopped_by", "samples_per_pixel", "error", "adaptive", "samples", "rays"):
        assert film.statistics[name] == expected.statistics[name], name
    assert tiles and fractions[-1] == 1.0


def test_pixels_that_ended_go_to_a_machine_once_and_are_asked_for_where_they_are_lost(connection, session, monkeypatch):
    expected, lost = session.render(scenes.mixed(FRAME), ADAPTIVE), []
    submit = Connection.submit

    def submit_without(self, name, *arguments, **options):
        if name == "render" and arguments[5] and len(lost) < 2:
            lost.append(arguments[5])
            self._client.run(lose, arguments[5])
        return submit(self, name, *arguments, **options)

    monkeypatch.setattr(Connection, "submit", submit_without)
    film = ClusterSession(connection).render(scenes.mixed(FRAME), ADAPTIVE)
    assert_same_film(film, expected)
    assert lost and film.statistics["cluster"]["tasks_again"] >= 1


def lose(digest):
    """On a worker: a part is gone from its machine."""
    from raybatch_addon.core.cluster.work import part_store

    part_store()._path(digest).unlink(missing_ok=True)


@pytest.mark.parametrize("change", thorough_but(["noise and error", "error"], ["noise", "noise and error", "error"]))
def test_a_checkpoint_in_the_middle_of_a_round_is_that_of_any_render(
    connection, session, long_tasks, tmp_path, change, bands
):
    settings, path, stops = CHANGES[change], tmp_path / "film.checkpoint", []
    expected = session.render(scenes.mixed(FRAME), settings)
    cluster = ClusterSession(connection)

    def cancelled():
        stops.append(1)
        return path.exists() and load_kept(path).progress.done > (8 if settings.is_adaptive else 4)

    film = cluster.render(scenes.mixed(FRAME), settings, checkpoint=Checkpoint(path, 0.05), cancelled=cancelled)
    assert not film.complete
    copy = path.with_name("copy.checkpoint")
    copy.write_bytes(path.read_bytes())
    assert_same_film(cluster.render(scenes.mixed(FRAME), settings, checkpoint=Checkpoint(path)), expected)
    assert_same_film(session.render(scenes.mixed(FRAME), settings, checkpoint=Checkpoint(copy)), expected)
    # and nothing is rendered any more
    again = cluster.render(scenes.mixed(FRAME), settings, checkpoint=Checkpoint(path))
    assert_same_film(again, expected)
    assert again.statistics["cluster"]["shares"] == []


def test_a_checkpoint_of_one_process_goes_on_on_a_cluster(connection, session, tmp_path):
    path, expected = tmp_path / "film.checkpoint", session.render(scenes.mixed(FRAME), ADAPTIVE)
    session.render(scenes.mixed(FRAME), ADAPTIVE.replace(sample_count=24), checkpoint=Checkpoint(path))
    film = ClusterSession(connection).render(scenes.mixed(FRAME), ADAPTIVE, checkpoint=Checkpoint(path))
    assert_same_film(film, expected)


def test_samples_behind_a_look_cannot_be_rendered_by_themselves(connection):
    with pytest.raises(RayBatchError, match="adaptive sampling"):
        ClusterSession(connection).render(scenes.mixed(FRAME), ADAPTIVE, sample_first=32)
