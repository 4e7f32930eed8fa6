"""Checkpoints of ranges of samples, merged: the film of one render, or an error that says what is missing."""

import itertools

import pytest

from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.checkpoint.file import CheckpointError, load_kept
from raybatch_addon.core.checkpoint.merging import merged_films, range_of, save_merged
from tests.support import schedule_scenes
from tests.support.watched_renders import assert_same

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


@pytest.fixture(scope="module")
def scene():
    return schedule_scenes.SCENES["mixed"]()


def rendered(session, scene, folder, edges, **changes):
    """Checkpoints of the ranges between `edges`."""
    paths = []
    for first, end in itertools.pairwise(edges):
        settings = schedule_scenes.ESTIMATOR.replace(sample_count=end - first, **changes)
        paths.append(folder / f"{first}.checkpoint")
        session.render(scene, settings, sample_first=first, checkpoint=Checkpoint(paths[-1]))
    return paths


@pytest.mark.parametrize("estimate", ["OFF", "ON"])
def test_ranges_merge_to_one_render_that_goes_on(session, scene, tmp_path, estimate):
    paths = rendered(session, scene, tmp_path, (0, 3, 4, 9), error_estimate=estimate)
    merged = merged_films([paths[2], paths[0], paths[1]])
    settings = schedule_scenes.ESTIMATOR.replace(sample_count=9, error_estimate=estimate)
    expected = session.render(scene, settings)
    assert range_of(merged).end == 9
    assert_same(merged.film().passes, expected.passes)
    save_merged(paths[0], merged)
    assert_same(load_kept(paths[0]).film().passes, expected.passes)
    more = settings.replace(sample_count=12)
    checkpoint = Checkpoint(paths[0])
    film = session.render(scene, more, checkpoint=checkpoint)
    assert checkpoint.samples_before == 9
    assert_same(film.passes, session.render(scene, more).passes)


def test_a_later_range_alone_is_a_film_of_its_own(session, scene, tmp_path):
    paths = rendered(session, scene, tmp_path, (4, 6, 9))
    merged = merged_films(paths)
    settings = schedule_scenes.ESTIMATOR.replace(sample_count=5)
    assert_same(merged.film().passes, session.render(scene, settings, sample_first=4).passes)


def test_what_cannot_be_merged_is_reported(session, scene, tmp_path):
    first, second, third = rendered(session, scene, tmp_path, (0, 2, 4, 7))
    with pytest.raises(CheckpointError, match="name two checkpoints or more"):
        merged_films([first])
    with pytest.raises(CheckpointError, match="samples 2 to 3 are in neither.*--sample-first 2 --set sample_count=2"):
        merged_films([first, third])
    with pytest.raises(CheckpointError, match="both have samples 2 to 3, which would count twice"):
        merged_films([first, second, second])
    (tmp_path / "other").mkdir()
    (other,) = rendered(session, scene, tmp_path / "other", (2, 4), seed=1)
    with pytest.raises(CheckpointError, match="cannot be merged with .*seed = 1, and this film has 0"):
        merged_films([first, other])
    (adaptive,) = rendered(session, scene, tmp_path / "other", (0, 2), adaptive_sampling="ON")
    with pytest.raises(CheckpointError, match="adaptive_sampling = ON, with which samples depend"):
        merged_films([adaptive, second])
