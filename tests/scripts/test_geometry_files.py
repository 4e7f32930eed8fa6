"""Geometry from NumPy archives: what it becomes, and what is said of bad ones."""

import math

import numpy as np
import pytest
from lib.geometry_files import View, framing_view, load_geometry, look_at, parse_view, read_mesh, sun_axes, view_axes

from raybatch_addon.core.errors import SceneError

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32)
FACE = np.array([[0, 1, 2]], np.int32)


def write(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_arrays_become_one_mesh_with_a_material_for_each_id(tmp_path):
    path = write(tmp_path / "a.npz", v=TRIANGLE, f=np.repeat(FACE, 4, 0), m=np.array([24, 3, 24, -1], np.int16))
    mesh, materials = read_mesh(path)
    assert mesh.positions.tobytes() == TRIANGLE.tobytes()
    assert mesh.positions.dtype == np.float32 and mesh.triangles.dtype == np.int32
    assert mesh.triangle_slot.tolist() == [2, 1, 2, 0]
    assert [material.name for material in materials] == ["Material -1", "Material 3", "Material 24"]
    colors = {material.closures[0].weight for material in materials}
    assert len(colors) == 3
    assert all(0.2 < c < 0.9 for color in colors for c in color)


def test_without_ids_it_is_white_and_wider_types_are_narrowed(tmp_path):
    path = write(tmp_path / "a.npz", v=TRIANGLE.astype(np.float16), f=FACE.astype(np.uint64))
    scene = load_geometry(path, width=64, height=32)
    (material,) = scene.materials
    assert len(set(material.closures[0].weight)) == 1
    assert scene.meshes[0].triangles.dtype == np.int32
    assert (scene.frame.width, scene.frame.height) == (64, 32)
    assert len(scene.lights) == 1 and min(scene.world.radiance) > 0


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"f": FACE}, "no array v"),
        ({"v": TRIANGLE}, "no array f"),
        ({}, "no array v and no array f"),
        ({"v": TRIANGLE, "f": FACE + 1}, "array f names vertices 1 to 3, but v has 3"),
        ({"v": TRIANGLE, "f": FACE - 1}, "array f names vertices -1 to 1"),
        ({"v": TRIANGLE * np.float32(np.nan), "f": FACE}, "array v has 3 vertices that are not finite"),
        ({"v": TRIANGLE.astype(np.float64) * 1e300, "f": FACE}, "array v has 2 vertices that are not finite"),
        ({"v": TRIANGLE[:, :2], "f": FACE}, r"array v is float32 of shape \[3, 2\]"),
        ({"v": TRIANGLE, "f": FACE.astype(np.float32)}, "array f is float32"),
        ({"v": TRIANGLE, "f": FACE[:0]}, "array f has no triangles"),
        ({"v": TRIANGLE, "f": FACE, "m": np.zeros(2, np.int16)}, r"array m is int16 of shape \[2\]"),
        ({"v": TRIANGLE, "f": FACE, "m": np.zeros(1, np.float32)}, "array m is float32"),
    ],
)
def test_bad_arrays_are_named_with_their_file(tmp_path, arrays, message):
    with pytest.raises(SceneError, match=f"bad.npz.*{message}"):
        read_mesh(write(tmp_path / "bad.npz", **arrays))


def test_files_that_are_no_archive(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    np.save(tmp_path / "array.npy", TRIANGLE)
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    whole = write(tmp_path / "whole.npz", v=np.random.default_rng(0).random((999, 3)), f=FACE).read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("text.npz", "array.npz", "cut.npz", "missing.npz"):
        with pytest.raises(SceneError, match=name):
            read_mesh(tmp_path / name)


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "1,2,3,4,5,6,x", "1,2,3,4,5,6,nan", "1,2,3,4,5,6,0", "1,2,3,4,5,6,180", "1,2,3,1,2,3,40"]
)
def test_bad_cameras_are_refused(text):
    with pytest.raises(SceneError):
        parse_view(text)


def project(camera, points):
    """Where `points` are in the camera's window, 0..1 across and up, float64 [n, 2]."""
    matrix = camera.transform.astype(np.float64)
    local = (points - matrix[:, 3]) @ matrix[:, :3]
    assert (local[:, 2] < 0).all()
    left, right, bottom, top = camera.window
    flat = local[:, :2] / -local[:, 2:]
    return np.stack([(flat[:, 0] - left) / (right - left), (flat[:, 1] - bottom) / (top - bottom)], axis=1)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_given_camera_sees_its_target_in_the_middle_and_up_upwards(up):
    view = parse_view("3,-4,2,1,1,0.5,60")
    camera = look_at(view, up, 200, 100)
    above = np.add(view.target, {"y": (0, 0.1, 0), "z": (0, 0, 0.1)}[up])
    middle, higher = project(camera, np.array([view.target, above]))
    assert middle == pytest.approx([0.5, 0.5], abs=1e-6)
    assert higher[0] == pytest.approx(0.5, abs=1e-6) and higher[1] > 0.5
    left, right, bottom, top = camera.window
    assert right - left == pytest.approx(2 * math.tan(math.radians(30)))
    assert top - bottom == pytest.approx((right - left) / 2)
    tall = look_at(view, up, 100, 200).window
    assert tall[3] - tall[2] == pytest.approx(2 * math.tan(math.radians(30)))


def test_whole_numbers_are_a_view_too():
    ints, floats = (View((each(0), each(0), each(5)), (each(0), each(3), each(1)), 1.0) for each in (int, float))
    assert np.array_equal(view_axes(ints, "y"), view_axes(floats, "y"))


@pytest.mark.parametrize("up", ["y", "z"])
def test_straight_down_has_axes_too(up):
    eye = {"y": (0.0, 5.0, 0.0), "z": (0.0, 0.0, 5.0)}[up]
    for axes in (view_axes(View(eye, (0.0, 0.0, 0.0), 1.0), up), sun_axes(View(eye, (0.0, 0.0, 0.0), 1.0), up)):
        assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("size", [(64, 32), (32, 64)])
@pytest.mark.parametrize("high", [(1, 2, 3), (1e4, 1, 1), (1e-3, 1e-3, 0)])
def test_the_default_camera_shows_everything(up, size, high):
    low, high = np.array([-1.0, 0, 0]) * high, np.array(high, np.float64)
    corners = np.array(
        [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    seen = project(look_at(framing_view(low, high, *size, up), up, *size), corners)
    assert (seen > 0).all() and (seen < 1).all()
    assert np.ptp(seen, axis=0).max() > 0.3


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_sun_shines_down_and_away_from_the_viewer(up):
    view = parse_view("3,4,2,1,1,0.5,60")
    shines = -sun_axes(view, up)[:, 2]
    assert shines @ {"y": np.array([0, 1, 0]), "z": np.array([0, 0, 1])}[up] < -0.5
    assert shines @ view_axes(view, up)[:, 2] < 0
