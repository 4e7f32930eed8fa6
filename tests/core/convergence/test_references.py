"""Reference pictures: what is refused, and what files keep."""

import dataclasses
import math
import zipfile

import numpy as np
import pytest

from raybatch_addon.core.convergence.points import Reference, load_reference, save_reference, scene_hash
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

SHAPE = (40, 60, 3)


def test_references_that_are_none_are_refused():
    good = np.ones(SHAPE)
    bad = good.copy()
    bad[3, 4, 1], bad[0, 0, 0] = math.nan, math.inf
    for arguments, message in [
        ((bad, None, "R"), "R has 2 values that are not finite"),
        ((good, bad, "R"), "variance of R has 2 values"),
        ((good[..., 0], None, "R"), r"R is no picture.*\[40, 60\]"),
        ((np.zeros((0, 3, 3)),), "no picture"),
        ((good, -good), "below 0"),
        ((good, good[:2]), "make it again"),
    ]:
        with pytest.raises(RayBatchError, match=message):
            Reference(*arguments)


@pytest.fixture
def saved(tmp_path):
    reference = Reference(np.random.default_rng(1).uniform(0, 3, SHAPE), np.full(SHAPE, 0.25), "from far away", 4096)
    settings = RenderSettings(bounce_max=5)
    path = tmp_path / "folder" / "r.npz"
    save_reference(path, reference, "abc", settings)
    return path, reference, settings


def test_references_come_back_from_files_bit_for_bit(saved):
    path, reference, settings = saved
    back = load_reference(
        path, (60, 40), "abc", settings.replace(seed=3, nee="OFF", clamp_indirect=2.0, sample_sequence="INDEPENDENT")
    )
    assert np.array_equal(back.picture, reference.picture) and np.array_equal(back.variance, reference.variance)
    assert (back.name, back.samples, back.size) == ("from far away", 4096, (60, 40))
    assert [p.name for p in path.parent.iterdir()] == ["r.npz"]
    save_reference(path, Reference(reference.picture))
    assert load_reference(path).variance is None


def test_references_of_something_else_are_refused(saved):
    path, _, settings = saved
    for arguments, message in [
        (((40, 60),), "60 x 40 pixels and the render 40 x 60"),
        ((None, "abd"), "another scene"),
        ((None, "", settings.replace(bounce_max=6)), "bounce_max = 5.*has 6: set bounce_max to 5"),
        ((None, "", settings.replace(pixel_filter="BOX")), "pixel_filter"),
    ]:
        with pytest.raises(RayBatchError, match=message):
            load_reference(path, *arguments)


def test_films_are_references_whose_error_nobody_knows(tmp_path):
    picture = np.random.default_rng(2).uniform(0, 1, (4, 5, 4)).astype(np.float32)
    np.savez_compressed(tmp_path / "film.npz", Combined=picture, Depth=picture[..., :1])
    reference = load_reference(tmp_path / "film.npz", (5, 4), "abc", RenderSettings())
    assert (
        np.array_equal(reference.picture, picture[..., :3])
        and reference.variance is None
        and reference.name == "film.npz"
    )


def test_unreadable_references_are_refused(saved, tmp_path):
    path, reference, _ = saved
    whole = path.read_bytes()
    bad = tmp_path / "bad.npz"

    def refused(message):
        with pytest.raises(RayBatchError, match=message):
            load_reference(bad)

    refused("there is no file")
    for length in (0, 10, len(whole) // 2, len(whole) - 4):
        bad.write_bytes(whole[:length])
        refused("cannot be read|is no reference")
    bad.write_text("hello")
    refused("cannot be read")
    with open(bad, "wb") as file:
        np.save(file, np.zeros(3))
    refused("single array")
    np.savez(bad, other=np.zeros(3))
    refused("neither a reference's header nor")
    np.savez(bad, picture=reference.picture, header=np.frombuffer(b'{"format": "raybatch-scene"}', np.uint8))
    refused("another kind")
    np.savez(
        bad,
        picture=reference.picture,
        header=np.frombuffer(b'{"format": "raybatch-reference", "version": 77}', np.uint8),
    )
    refused("version 77")
    np.savez(bad, picture=reference.picture, header=np.frombuffer(b"\xff{", np.uint8))
    refused("damaged")
    np.savez(bad, picture=reference.picture, header=np.frombuffer(b"[" * 100_000, np.uint8))
    refused("damaged")
    text = b'{"format": "raybatch-reference", "version": 1, "settings": [1]}'
    np.savez(bad, picture=reference.picture, header=np.frombuffer(text, np.uint8))
    refused("no settings")
    with zipfile.ZipFile(bad, "w") as archive:
        archive.writestr("Combined", b"no array")
    refused("cannot be read")
    np.savez(bad, Combined=np.array(["text"] * 3))
    refused("floating-point")
    np.savez(bad, Combined=np.full(SHAPE, np.nan))
    refused("not finite")
    with pytest.raises(RayBatchError, match="cannot be read"):
        load_reference(tmp_path)


def test_a_file_with_flipped_bits_is_read_or_refused(tmp_path):
    """Whatever a bit says: that the file is encrypted, compressed in another way, longer than it is."""
    path, random = tmp_path / "r.npz", np.random.default_rng(1)
    save_reference(path, Reference(np.ones((3, 4, 3)), np.ones((3, 4, 3))), "abc", RenderSettings())
    whole, refused = path.read_bytes(), 0
    for place in random.choice(len(whole), 600, replace=False):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << random.integers(8)]) + whole[place + 1 :])
        try:
            load_reference(path, (4, 3), "abc", RenderSettings())
        except RayBatchError:
            refused += 1
    assert refused > 300


def test_a_reference_that_cannot_be_written_leaves_nothing(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(RayBatchError, match="cannot be written"):
        save_reference(blocked / "r.npz", Reference(np.ones(SHAPE)))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_the_hash_of_a_scene_depends_on_what_is_seen():
    def made(color=0.5, size=2.0, frame=None, **more):
        return scenes.scene([(scenes.plane(size=size), scenes.IDENTITY, scenes.diffuse(color))], frame=frame, **more)

    base = scene_hash(made())
    assert scene_hash(made()) == base and len(base) == 32
    assert scene_hash(made(frame=Frame(32, 32, passes=("Combined", "Depth")))) == base
    scene = made()
    mapped = tuple(
        dataclasses.replace(mesh, corner_uvs=np.zeros((len(mesh.triangles), 3, 2), np.float32)) for mesh in scene.meshes
    )
    assert scene_hash(dataclasses.replace(scene, meshes=mapped)) == base  # no shader reads them
    others = [
        made(0.6),
        made(size=2.1),
        made(frame=Frame(32, 33)),
        made(world=0.1),
        made(lights=[scenes.sun()]),
        made(view=scenes.camera(eye=(0, -5, 0))),
        made(frame=Frame(32, 32, border=(0, 0, 8, 8))),
        scenes.scene(),
    ]
    assert len({base, *map(scene_hash, others)}) == 1 + len(others)
