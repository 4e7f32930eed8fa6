"""Checkpoints that do not fit, are damaged, or cannot be written: what is said, and what stays."""

import contextlib
import dataclasses
import errno
import json
import os
import zipfile

import numpy as np
import pytest

from raybatch_addon.core.checkpoint import file as checkpoint_file
from raybatch_addon.core.checkpoint.checkpoint import Checkpoint
from raybatch_addon.core.checkpoint.file import CheckpointError, load_kept
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.wavefront.render import rendering
from tests.support import scenes
from tests.support.watched_renders import FRAME, SETTINGS, TARGET, assert_same

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

MATTES = dataclasses.replace(FRAME, passes=(*FRAME.passes, "CryptoObject00"))


@pytest.fixture
def path(session, tmp_path):
    """A checkpoint of a finished film."""
    path = tmp_path / "a.checkpoint"
    session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))
    return path


def with_header(path, change):
    """Write `path` anew, its header changed by `change`."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(members["header.json"])
    change(header)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | {"header.json": json.dumps(header).encode()}).items():
            archive.writestr(name, data)


def moved(scene):
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, clip_end=99.0))


def with_moved_mesh(scene):
    mesh = dataclasses.replace(scene.meshes[0], positions=scene.meshes[0].positions + np.float32(1e-6))
    return dataclasses.replace(scene, meshes=(mesh, *scene.meshes[1:]))


@pytest.mark.parametrize(
    ("scene", "settings", "why"),
    [
        (scenes.mixed(FRAME), SETTINGS.replace(seed=4), "it was begun with seed = 0, and this film has 4"),
        (scenes.mixed(FRAME), SETTINGS.replace(bounce_max=4), "it was begun with bounce_max = 5"),
        (
            scenes.mixed(FRAME),
            SETTINGS.replace(sample_count=6),
            "it was begun for 7 samples, and now sample_count is 6",
        ),
        (scenes.mixed(FRAME), SETTINGS.replace(error_estimate="ON"), "error_estimate = OFF"),
        (scenes.mixed(Frame(24, 21)), SETTINGS, "its frame has 24 x 20 pixels, and this one 24 x 21"),
        (scenes.mixed(dataclasses.replace(FRAME, border=(1, 2, 9, 9))), SETTINGS, r"its border is \[0, 0, 24, 20\]"),
        (scenes.mixed(MATTES), SETTINGS, "its passes are Combined, Depth, Normal, Position, and"),
        (moved(scenes.mixed(FRAME)), SETTINGS, r"its scene is another one \(camera\)"),
        (
            with_moved_mesh(scenes.mixed(FRAME)),
            SETTINGS,
            r"another one \(mesh 1, .*Blender did not make it to the same",
        ),
    ],
    ids=["seed", "bounces", "fewer samples", "halves", "size", "border", "passes", "camera", "mesh"],
)
def test_what_matters_may_not_change(session, path, scene, settings, why):
    written = path.read_bytes()
    with pytest.raises(CheckpointError, match=why):
        session.render(scene, settings, checkpoint=Checkpoint(path))
    assert path.read_bytes() == written


def test_what_changes_no_bit_may_change(session, path):
    names = dataclasses.replace(scenes.mixed(FRAME), object_names=())
    settings = SETTINGS.replace(tile_size=5, batching="ON", ray_count=99, time_limit=100.0, denoise_prefilter="FAST")
    checkpoint = Checkpoint(path)
    assert session.render(names, settings, checkpoint=checkpoint).complete and checkpoint.samples_before == 7


def test_names_matter_where_mattes_show_them(session, tmp_path):
    path, scene = tmp_path / "a.checkpoint", scenes.mixed(MATTES)
    session.render(scene, SETTINGS, checkpoint=Checkpoint(path))
    renamed = dataclasses.replace(scene, object_names=tuple(f"{name}!" for name in scene.object_names))
    with pytest.raises(CheckpointError, match="names that mattes show"):
        session.render(renamed, SETTINGS, checkpoint=Checkpoint(path))


def test_another_range_of_samples_is_another_film(session, path):
    with pytest.raises(CheckpointError, match="its samples begin at 0, and 7 is asked for"):
        session.render(scenes.mixed(FRAME), SETTINGS, sample_first=7, checkpoint=Checkpoint(path))


def test_more_samples_than_an_error_target_was_judged_by_are_refused(session, tmp_path):
    path, target = tmp_path / "a.checkpoint", TARGET.replace(sample_count=8, error_target=1e-9)
    session.render(scenes.mixed(FRAME), target, checkpoint=Checkpoint(path))
    with pytest.raises(CheckpointError, match="with error_target, which looks at the error at the end"):
        session.render(scenes.mixed(FRAME), target.replace(sample_count=16), checkpoint=Checkpoint(path))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda header: header.update(version=2), "format version 2, and this RayBatch reads version 1"),
        (lambda header: header["film"]["versions"].update(raybatch="9.9"), "it was rendered by RayBatch 9.9"),
        (lambda header: header["film"].update(device="CUDA, Voodoo 2"), r"another device \(CUDA, Voodoo 2"),
        (lambda header: header["film"]["settings"].update(warmth=1), "this RayBatch lacks the setting warmth"),
        (lambda header: header["film"]["settings"].pop("nee"), "it lacks the setting nee"),
    ],
    ids=["format", "RayBatch", "device", "newer setting", "older settings"],
)
def test_files_of_other_versions_and_devices_are_reported(session, path, change, why):
    with_header(path, change)
    with pytest.raises(CheckpointError, match=why):
        session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.update(format="another"),
        lambda header: header.pop("film"),
        lambda header: header.update(progress=[]),
        lambda header: header["progress"]["tiles"].pop(),
        lambda header: header["progress"]["tiles"][0].__setitem__(2, 10**9),
        lambda header: header["film"].update(region=[0, 0, 25, 20]),
        lambda header: header["film"].update(passes=["Combined"]),
        lambda header: header["film"]["settings"].update(sample_count=-1),
    ],
)
def test_headers_that_say_nonsense_are_damage(path, change):
    with_header(path, change)
    with pytest.raises(CheckpointError, match="damaged, cut short or of another kind"):
        load_kept(path)


def test_a_damaged_or_cut_file_is_reported_and_never_read(path):
    """Each byte of the header and of the arrays has a say in a check sum."""
    whole, random = path.read_bytes(), np.random.default_rng(2)
    expected = load_kept(path).halves[0].sums.window
    for _ in range(60):
        cut = bytearray(whole[: random.integers(len(whole))])
        path.write_bytes(cut)
        with pytest.raises(CheckpointError, match="damaged"):
            load_kept(path)
        flipped = bytearray(whole)
        flipped[random.integers(len(whole))] ^= 1 << random.integers(8)
        path.write_bytes(flipped)
        with contextlib.suppress(CheckpointError):  # a bit of a date says nothing about the film
            assert np.array_equal(load_kept(path).halves[0].sums.window, expected)


def test_files_of_other_kinds_are_reported_and_left_alone(session, tmp_path):
    path = tmp_path / "a.checkpoint"
    for content in (b"", b"not a film at all", np.zeros(3).tobytes()):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="of another kind"):
            session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))
        assert path.read_bytes() == content
    with pytest.raises(CheckpointError, match="there is no file"):
        load_kept(tmp_path / "none")
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_kept(tmp_path)


@pytest.mark.parametrize("where", ["sync", "array"])
def test_a_full_disk_ends_no_render_and_what_was_written_stays(session, path, monkeypatch, where):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    written = path.read_bytes()
    if where == "sync":
        monkeypatch.setattr(checkpoint_file.os, "fsync", full)
    else:
        monkeypatch.setattr(checkpoint_file, "_write_array", full)
    more = SETTINGS.replace(sample_count=20)
    film = session.render(scenes.mixed(FRAME), more, checkpoint=Checkpoint(path))
    assert film.complete and path.read_bytes() == written and os.listdir(path.parent) == [path.name]
    warning = film.statistics["warnings"][0]
    assert "No space left on device" in warning and "what it held before is still there" in warning
    assert_same(film.passes, session.render(scenes.mixed(FRAME), more).passes)


def test_what_a_killed_process_left_is_removed_and_nothing_else(session, path):
    left, other = path.with_name(f".12345.7.{path.name}"), path.with_name(".12345.7.b.checkpoint")
    for each in (left, other):
        each.write_bytes(b"half of it")
    session.render(scenes.mixed(FRAME), SETTINGS, checkpoint=Checkpoint(path))
    assert not left.exists() and other.exists()


@pytest.mark.parametrize("is_over", [True, False])
def test_a_render_may_begin_anew_and_keeps_what_was_unfinished(session, path, monkeypatch, is_over):
    if not is_over:
        with_header(path, lambda header: header["progress"].update(end=7, done=0))
    written, other = path.read_bytes(), SETTINGS.replace(seed=4)
    film = session.render(scenes.mixed(FRAME), other, checkpoint=Checkpoint(path, begins_anew=True))
    assert "the render begins anew" in film.statistics["warnings"][0] and "seed" in film.statistics["warnings"][0]
    assert_same(film.passes, session.render(scenes.mixed(FRAME), other).passes)
    aside = path.with_name("a.checkpoint.old")
    assert (not aside.exists()) if is_over else aside.read_bytes() == written
    assert load_kept(path).identity.settings["seed"] == 4


def test_rays_that_are_given_up_leave_the_copy_before(session, tmp_path, monkeypatch):
    path = tmp_path / "a.checkpoint"
    monkeypatch.setattr(rendering, "KEPT_PATIENCE", 1e-9)
    monkeypatch.setattr(rendering, "POLL_SECONDS", 0.001)
    endless = SETTINGS.replace(sample_count=10_000_000, ray_count=500)
    looks = []

    def cancelled():
        looks.append(1)
        return len(looks) > 20

    film = session.render(scenes.mixed(FRAME), endless, checkpoint=Checkpoint(path), cancelled=cancelled)
    assert not film.complete and not path.exists()
    assert "so a.checkpoint was not written" in film.statistics["warnings"][-1]


def test_a_stop_waits_for_rays_where_the_film_is_kept(session, tmp_path, monkeypatch):
    """Without a checkpoint it would give them up at once."""
    monkeypatch.setattr(rendering, "DRAIN_SECONDS", 0.0)
    monkeypatch.setattr(rendering, "POLL_SECONDS", 0.001)
    looks, path = [], tmp_path / "a.checkpoint"
    endless = SETTINGS.replace(sample_count=10_000_000, ray_count=500)

    def cancelled():
        looks.append(1)
        return len(looks) > 20

    film = session.render(scenes.mixed(FRAME), endless, checkpoint=Checkpoint(path), cancelled=cancelled)
    assert film.resume_state is not None and not film.statistics["warnings"]
    assert sum(int(half.counts.sum()) for half in load_kept(path).halves) == film.sample_total > 0
