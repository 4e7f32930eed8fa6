"""Bad input through the whole engine.

Data that cannot be rendered is an error; data that can be left out is named in a warning.
"""

import math
import os

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame
from tests.blender.bad_input.outcomes import BACKGROUND, assert_fails, assert_picture, glow, render
from tests.support.blender_builders import add_mesh, add_object, add_triangle

NAN, INFINITY = math.nan, math.inf


# --- cameras


def test_no_camera(lit, tmp_path):
    """Blender refuses by itself, before it calls an engine."""
    lit.camera, lit.render.filepath = None, str(tmp_path / "never")
    with pytest.raises(RuntimeError, match="no camera"):
        bpy.ops.render.render(write_still=True)
    assert os.listdir(tmp_path) == []


def test_a_camera_that_is_lost_on_the_way(lit, tmp_path, monkeypatch):
    """The engine's own message if Blender let a scene without camera pass."""
    original = frame.export_scene

    def export(depsgraph, **options):
        depsgraph.scene.camera = None
        return original(depsgraph, **options)

    monkeypatch.setattr(frame, "export_scene", export)
    assert_fails(tmp_path, "no camera", f"“{lit.name}”", "add one")


def test_something_else_as_the_camera(lit, tmp_path):
    lit.camera = add_object("Not a camera", None)
    assert_fails(tmp_path, "“Not a camera”", "make a camera the active one")


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0), (0, 1, 1)])
def test_a_camera_with_a_singular_matrix(lit, tmp_path, scale):
    lit.camera.scale = scale
    assert_fails(tmp_path, "“Camera”", "singular", "scale")


@pytest.mark.parametrize("what", ["location", "rotation_euler", "scale"])
def test_a_camera_with_a_matrix_that_is_not_finite(lit, tmp_path, what):
    setattr(lit.camera, what, (1, NAN, 1))
    assert_fails(tmp_path, "“Camera”", "not finite", "reset")


@pytest.mark.parametrize("location", [(0, INFINITY, 10), (0, 0, -INFINITY), (1e30, 0, 0)])
def test_a_camera_beyond_all_numbers(lit, tmp_path, location):
    """Blender turns an infinite location into the largest float32."""
    lit.camera.location = location
    assert_fails(tmp_path, "camera", "1e+18 m", "reset")


def test_a_camera_whose_parent_is_flat(lit, tmp_path):
    parent = add_object("Parent", None)
    parent.scale = (0, 0, 0)
    lit.camera.parent = parent
    assert_fails(tmp_path, "“Camera”", "parented to")


# --- objects


@pytest.mark.parametrize("what", ["location", "scale"])
@pytest.mark.parametrize("value", [NAN, INFINITY])
def test_an_object_with_a_matrix_that_is_not_finite(lit, films, what, value):
    bad = glow(add_triangle("Nowhere"))
    setattr(bad, what, (value, 1, 1))
    (warning,) = render()
    # Blender turns an infinite number into the largest float32
    assert "“Nowhere”" in warning and ("not finite" in warning or (value == INFINITY and "1e+18 m" in warning))
    assert_picture(films[0])
    assert films[0].statistics["warnings"] == [warning]


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0), (0, 3, 3)])
def test_an_object_scaled_to_nothing(lit, films, scale):
    glow(add_triangle("Flat")).scale = scale
    (warning,) = render()
    assert "“Flat”" in warning and "scale" in warning
    assert_picture(films[0])


@pytest.mark.parametrize("value", [NAN, INFINITY, -INFINITY])
def test_a_mesh_with_vertices_that_are_not_finite(lit, films, value):
    glow(add_mesh("Broken", [(0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, value)], [(0, 1, 2), (1, 2, 3)]))
    (warning,) = render()
    assert "“Broken”" in warning and "1 vertices" in warning and "NaN or infinite" in warning
    assert_picture(films[0])


def test_a_mesh_of_coordinates_whose_squares_are_not_finite(lit, films):
    glow(add_mesh("Vast", [(1e30, 0, 0), (0, 1e30, 0), (-1e30, 0, 5)], [(0, 1, 2)]))
    (warning,) = render()
    assert "“Vast”" in warning
    assert_picture(films[0])


def test_meshes_without_faces(lit, films):
    add_object("Nothing", bpy.data.meshes.new("Nothing"))
    add_mesh("Points", [(0, 0, 1), (1, 0, 1)], [])
    wire = bpy.data.meshes.new("Wire")
    wire.from_pydata([(0, 0, 1), (1, 0, 1)], [(0, 1)], [])
    add_object("Wire", wire)
    warnings = render()
    assert_picture(films[0])
    assert [any(f"“{name}”" in text for text in warnings) for name in ("Nothing", "Points", "Wire")] == [
        False,
        True,
        True,
    ]
    assert all("no faces" in text for text in warnings)


def test_faces_without_area(lit, films):
    """Faces that are points and lines, in front of everything, smooth and flat: no hit, nothing invalid."""
    corners = [(0, 0, 1), (1, 0, 1), (2, 0, 1), (0, 0, 1)]
    for name in ("Smooth", "Flat"):
        obj = glow(add_mesh(name, corners, [(0, 1, 2), (0, 3, 1)]))
        obj.data.polygons.foreach_set("use_smooth", [name == "Smooth"] * 2)
    doubled = glow(add_mesh("Doubled", [(0.3, 0.3, 1)] * 3, [(0, 1, 2)]))
    doubled.location.x = -0.5
    assert render() == []
    assert_picture(films[0])


def test_a_scene_of_faces_without_area_alone(lit, films):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    add_mesh("Line", [(0, 0, 1), (1, 0, 1), (2, 0, 1)], [(0, 1, 2)])
    render()
    assert films[0].passes["Combined"][..., :3].reshape(-1, 3) == pytest.approx(
        np.tile(BACKGROUND, (32 * 24, 1)), rel=1e-5
    )


def test_a_million_loose_vertices(lit, films):
    bpy.data.objects["Lamp"].data.vertices.add(1_000_000)
    cloud = bpy.data.meshes.new("Cloud")
    cloud.vertices.add(1_000_000)
    add_object("Cloud", cloud)
    (warning,) = render()
    assert "“Cloud”" in warning and "no faces" in warning
    assert_picture(films[0])
    assert films[0].statistics["triangles"] == 1


def test_an_empty_scene_renders_the_world(lit, films):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    assert render() == []
    picture = films[0].passes["Combined"]
    assert picture.reshape(-1, 4) == pytest.approx(np.tile((*BACKGROUND, 1), (32 * 24, 1)), rel=1e-5)
