"""A scene in parts that are known by what they hold, and films that are what was sent."""

import dataclasses
import json

import numpy as np
import pytest

from raybatch_addon.core.checkpoint.file import CheckpointError
from raybatch_addon.core.checkpoint.identity import FilmIdentity
from raybatch_addon.core.cluster import films, store
from raybatch_addon.core.cluster.parts import digests_in, part_digest, parts_of, scene_of
from raybatch_addon.core.cluster.store import PartMissing, PartStore, StoreError
from raybatch_addon.core.convergence.reference import digest_of_value
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.watched_renders import FRAME, HALVES, SETTINGS, assert_same

pytestmark = pytest.mark.usefixtures("general_kernels")


def test_a_scene_comes_back_from_its_parts(tmp_path):
    scene = scenes.mixed(FRAME)
    parts, kept = parts_of(scene, SETTINGS), PartStore(tmp_path)
    assert sorted(parts.arrays) == digests_in(parts.recipe) == kept.lacks(digests_in(parts.recipe))
    kept.put(parts.arrays)
    assert kept.lacks(sorted(parts.arrays)) == []
    found, settings = scene_of(parts.recipe, kept.load)
    assert settings == SETTINGS and digest_of_value(found) == digest_of_value(scene)
    assert parts_of(found, settings).digest == parts.digest


def test_scenes_share_the_parts_that_are_alike():
    scene = scenes.mixed(FRAME)
    matrix = np.array(scene.camera.transform)
    matrix[0, 3] += 1
    moved = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, transform=matrix))
    first, second = parts_of(scene, SETTINGS), parts_of(moved, SETTINGS)
    assert first.digest != second.digest
    assert len(second.arrays.keys() - first.arrays.keys()) == 1  # the camera's matrix
    assert parts_of(scene, SETTINGS.replace(seed=7)).arrays.keys() == first.arrays.keys()


@pytest.mark.parametrize("recipe", ["", "{}", "[]", json.dumps({"record": {"scene": 3, "settings": 4}, "arrays": {}})])
def test_a_recipe_that_is_none(recipe):
    with pytest.raises(SceneError, match="cannot be read"):
        scene_of(recipe, lambda digest: np.zeros(1))


def test_parts_that_are_damaged_are_sent_again(tmp_path):
    kept, array = PartStore(tmp_path), np.arange(1000.0)
    digest = part_digest(array)
    with pytest.raises(PartMissing, match="damaged on its way"):
        kept.put({digest: array + 1})
    with pytest.raises(PartMissing, match="cannot be read"):
        kept.load(digest)
    kept.put({digest: array})
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(data)
    with pytest.raises(PartMissing, match="is damaged"):
        kept.load(digest)
    assert kept.lacks([digest]) == [digest]
    kept.put({digest: array})
    assert np.array_equal(kept.load(digest), array)


def test_a_full_disk_is_told(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store.np.lib.format, "write_array", full)
    with pytest.raises(StoreError, match="cannot keep a part: No space left on device"):
        PartStore(tmp_path).put({part_digest(np.arange(3)): np.arange(3)})
    assert not [*tmp_path.iterdir()]


def test_what_was_not_asked_for_for_longest_makes_room(tmp_path):
    arrays = [np.full(1000, i, np.float64) for i in range(5)]
    kept = PartStore(tmp_path, kept_bytes=3 * 8200)
    digests = [part_digest(each) for each in arrays]
    for i, (digest, array) in enumerate(zip(digests, arrays, strict=True)):
        kept.put({digest: array})
        store.os.utime(tmp_path / f"{digest}.npy", (i, i))
    assert kept.lacks(digests) == digests[:2]


@pytest.mark.parametrize("settings", [SETTINGS, HALVES], ids=["one film", "halves"])
def test_films_that_are_sent_merge_to_one(session, settings):
    scene = scenes.mixed(FRAME)
    expected = session.render(scene, settings)
    sent = []
    for first, count in ((0, 3), (3, 4)):
        own = settings.replace(sample_count=count)
        film = session.render(scene, own, sample_first=first)
        kept = films.kept_of(film, FilmIdentity.of(scene, own, session.device), first, own.sample_order)
        sent.append(films.sent_film(kept, [{"first": first}]))
    kept, shares = films.received_film(films.merged(*sent))
    assert shares == [{"first": 0}, {"first": 3}] and kept.progress.done == 7
    assert_same(kept.film().passes, expected.passes)
    for mine, theirs in zip(kept.film().halves or (), expected.halves or (), strict=True):
        assert_same(mine.passes, theirs.passes)


@pytest.fixture(scope="module")
def kept_film(session):
    scene, settings = scenes.mixed(FRAME), RenderSettings(sample_count=1, bounce_max=5)
    film = session.render(scene, settings)
    return films.kept_of(film, FilmIdentity.of(scene, settings, session.device), 0, settings.sample_order)


@pytest.mark.parametrize("spoil", ["header", "array", "lacks", "kind"])
def test_a_damaged_film_is_told(kept_film, spoil):
    sent = films.sent_film(kept_film, [])
    if spoil == "header":
        sent["header"] = sent["header"].replace("raybatch", "raybotch", 1)
    elif spoil == "array":
        sent["halves"][0]["window"][0, 5] ^= 1
    elif spoil == "lacks":
        del sent["halves"][0]["counts"]
    else:
        sent["halves"] = 3
    with pytest.raises(films.DamagedFilm):
        films.received_film(sent)


def test_films_of_unlike_devices_are_not_merged(kept_film):
    identity = dataclasses.replace(kept_film.identity, device="CUDA, another")
    other = films.sent_film(dataclasses.replace(kept_film, identity=identity), [])
    with pytest.raises(CheckpointError, match="another device"):
        films.merged(films.sent_film(kept_film, []), other)
