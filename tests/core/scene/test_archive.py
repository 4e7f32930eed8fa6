"""A saved scene comes back as it was, to the bit, or not at all."""

import dataclasses
import json
from enum import Enum

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene import description as d
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.frozen import is_frozen
from raybatch_addon.core.settings.settings import RenderSettings


def assert_same(a, b):
    """Equal in type, structure and every bit of every array."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert a.tobytes() == b.tobytes()
    elif dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            assert_same(left, right)
    else:
        assert a == b
        assert isinstance(a, Enum) == isinstance(b, Enum)


def full_scene() -> d.Scene:
    """A scene with every kind of part in it."""
    matrix = np.eye(4, dtype=np.float32)[:3]
    mesh = d.Mesh(
        "Grün/Würfel",
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, -0.0]], np.float32),
        np.array([[0, 1, 2]], np.int32),
        np.array([1], np.int32),
        corner_normals=np.tile(np.array([0, 0, 1], np.float32), (1, 3, 1)),
        corner_uvs=np.random.default_rng(1).random((1, 3, 2), np.float32),
        attributes=(
            d.Attribute("GEOMETRY", "Größe", np.full((1, 3, 4), 0.1, np.float32)),
            d.Attribute("COLOR", "", np.zeros((1, 1), np.float32)),
        ),
    )
    materials = (
        d.Material("glass", (d.Closure(d.ClosureKind.GLASS, (0.1, 0.2, 1 / 3), 0.4, 1.45),), (d.ClosureKind.GLASS,)),
        d.Material("nothing", shadow_opaque=True),
    )
    one = np.zeros(1, np.int32)
    return d.Scene(
        camera=d.Camera(d.CameraKind.PERSPECTIVE, matrix, (-0.5, 0.5, -0.25, 0.25), clip_end=np.inf, lens_radius=0.01),
        frame=d.Frame(64, 32, border=(1, 2, 30, 20), transparent=True, passes=("Combined", "Depth")),
        meshes=(mesh, dataclasses.replace(mesh, name="second", corner_uvs=None)),
        instances=d.Instances(
            one,
            matrix[None].copy(),
            one,
            np.array([int(d.Visibility.ALL)], np.int32),
            one,
            attributes=np.ones((1, 2, 4), np.float32),
        ),
        slot_materials=np.array([1, 0], np.int32),
        materials=materials,
        images=(
            d.Image("one", np.random.default_rng(2).integers(0, 256, (4, 3, 4)).astype(np.uint8), d.ImageEncoding.SRGB),
            d.Image(
                "many", tiles=((1001, np.ones((2, 2, 1), np.float16)), (1012, np.full((1, 2, 3), np.inf, np.float32)))
            ),
            d.Image("missing"),
        ),
        attributes=(("GEOMETRY", "Größe"), ("COLOR", "")),
        lights=(d.Light("sun", d.LightKind.SUN, matrix, (1.0, 0.9, 0.8), angle=0.01, visibility=d.Visibility.DIFFUSE),),
        world=d.World((0.1, 0.2, 0.3), sun=d.SkySun((0.0, 0.6, 0.8), 0.01)),
        object_names=("Grün",),
        warnings=("something was left out",),
    )


def test_round_trip_is_exact(tmp_path):
    scene, settings = full_scene(), RenderSettings(sample_count=7, clamp_indirect=0.1, nee="HALF")
    save_scene(tmp_path / "a.scene.npz", scene, settings)
    scene_back, settings_back = load_scene(tmp_path / "a.scene.npz")
    assert_same(scene, scene_back)
    assert_same(settings, settings_back)
    assert all(is_frozen(mesh.positions) for mesh in scene_back.meshes), "renders would look at them again and again"
    assert [path.name for path in tmp_path.iterdir()] == ["a.scene.npz"]


@hypothesis_settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    positions=arrays_of.arrays(np.float32, st.tuples(st.integers(0, 5), st.just(3))),
    radiance=st.tuples(*[st.floats(width=64, allow_nan=False)] * 3),
    name=st.text(max_size=8),
)
def test_any_number_and_name_survive(tmp_path, positions, radiance, name):
    camera = d.Camera(d.CameraKind.ORTHOGRAPHIC, np.eye(3, 4, dtype=np.float32), (-1, 1, -1, 1))
    mesh = d.Mesh(name, positions, np.zeros((0, 3), np.int32))
    scene = d.Scene(camera, d.Frame(2, 2), meshes=(mesh,), world=d.World(radiance))
    save_scene(tmp_path / "any.scene.npz", scene, RenderSettings())
    assert_same(load_scene(tmp_path / "any.scene.npz")[0], scene)


def test_a_file_cut_short_is_refused_at_every_length(tmp_path):
    path = tmp_path / "whole.scene.npz"
    save_scene(path, full_scene(), RenderSettings())
    whole = path.read_bytes()
    cut = tmp_path / "cut.scene.npz"
    for length in [0, 1, 100, *range(len(whole) // 10, len(whole), len(whole) // 10), len(whole) - 1]:
        cut.write_bytes(whole[:length])
        with pytest.raises(SceneError, match="cut.scene.npz"):
            load_scene(cut)


def test_a_flipped_byte_of_an_array_is_noticed(tmp_path):
    path = tmp_path / "a.scene.npz"
    scene = full_scene()
    save_scene(path, scene, RenderSettings())
    data = path.read_bytes()
    offset = data.index(scene.meshes[0].corner_uvs.tobytes())
    path.write_bytes(data[:offset] + bytes([data[offset] ^ 1]) + data[offset + 1 :])
    with pytest.raises(SceneError, match="damaged"):
        load_scene(path)


def rewrite_header(path, change):
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    header = json.loads(members["header"].tobytes())
    change(header)
    members["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path, **members)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header: header.update(version=999), "version 999.*reads version 2"),
        (lambda header: header.update(format="other"), "not a saved scene"),
        (lambda header: header["scene"]["fields"].update(unknown=1), "cannot be read"),
        (lambda header: header["scene"].update({"class": "Path"}), "cannot be read"),
        (lambda header: header.update(scene=3), "does not hold a scene"),
        (lambda header: header["settings"]["fields"].update(sample_count=-3), "sample_count"),
    ],
)
def test_a_header_of_another_kind_is_refused(tmp_path, change, message):
    path = tmp_path / "a.scene.npz"
    save_scene(path, full_scene(), RenderSettings())
    rewrite_header(path, change)
    with pytest.raises(SceneError, match=message):
        load_scene(path)


def test_a_renamed_field_keeps_its_name_in_files(tmp_path):
    path = tmp_path / "a.scene.npz"
    scene = full_scene()
    closure = dataclasses.replace(scene.materials[0].closures[0], color=(0.25, 0.5, 1.0))
    scene = dataclasses.replace(scene, materials=(dataclasses.replace(scene.materials[0], closures=(closure,)),))
    save_scene(path, scene, RenderSettings())
    with np.load(path) as archive:
        header = json.loads(archive["header"].tobytes())
    assert header["scene"]["fields"]["materials"][0]["fields"]["closures"][0]["fields"]["colour"] == [0.25, 0.5, 1.0]
    assert_same(load_scene(path)[0], scene)


def test_files_of_other_kinds_are_refused(tmp_path):
    np.savez(tmp_path / "geometry.npz", v=np.zeros((3, 3)))
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "pickled.npz", header=np.array([{}], dtype=object))
    (tmp_path / "text.npz").write_text("hello")
    for name in ("geometry.npz", "array.npy", "pickled.npz", "text.npz", "missing.npz"):
        with pytest.raises(SceneError, match=name):
            load_scene(tmp_path / name)


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.scene.npz"
    save_scene(path, full_scene(), RenderSettings(seed=1))

    def full_disk(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(SceneError, match="No space left"):
        save_scene(path, full_scene(), RenderSettings(seed=2))
    monkeypatch.undo()
    assert load_scene(path)[1].seed == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.scene.npz"]
    with pytest.raises(SceneError, match="cannot be written"):
        save_scene(tmp_path / "no" / "folder.scene.npz", full_scene(), RenderSettings())


def test_earlier_files_that_hold_maps_of_all_instances_are_read(tmp_path):
    still = d.Instances(*(np.zeros(2, np.int32), np.zeros((2, 3, 4), np.float32), *([np.zeros(2, np.int32)] * 3)))
    maps = np.arange(72, dtype=np.float32).reshape(2, 3, 3, 4)
    made = full_scene()
    scene = d.Scene(made.camera, made.frame, instances=dataclasses.replace(still, motion=maps))
    path = tmp_path / "earlier.scene.npz"
    save_scene(path, scene, RenderSettings())
    read = load_scene(path)[0].instances
    assert read.motion.instance.tolist() == [0, 1] and np.array_equal(read.motion.maps, maps) and read.frames is None
