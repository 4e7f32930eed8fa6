"""Meshes exported to the core."""

import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.export.meshes import mesh_arrays
from raybatch_addon.export.meshes.mesh_arrays import read, read_loops, read_positions, read_triangles, stored
from raybatch_addon.export.meshes.meshes import export_mesh
from tests.support.blender_builders import add_grid, add_mesh, add_object, add_triangle, exported

pytestmark = pytest.mark.usefixtures("scene")

SQUARE = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)]


def only_mesh() -> Mesh:
    scene = exported()
    assert scene.warnings == ()
    (mesh,) = scene.meshes
    return mesh


def area(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles].astype(float), 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_faces_become_triangles_of_the_same_area():
    add_mesh("Pentagon", [*SQUARE, (1, 4, 0)], [(0, 1, 2, 4, 3)])
    mesh = only_mesh()
    assert mesh.triangles.shape == (3, 3) and mesh.triangles.dtype == np.int32
    assert mesh.positions.dtype == np.float32
    assert area(mesh) == pytest.approx(6)
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all(), "triangles keep the side of their face"


def test_modifiers_are_applied():
    obj = add_triangle()
    array = obj.modifiers.new("Array", "ARRAY")
    array.count, array.relative_offset_displace[0] = 3, 2
    mesh = only_mesh()
    assert len(mesh.triangles) == 3
    assert mesh.positions[:, 0].max() == pytest.approx(5)


def test_flat_meshes_have_no_normals_and_smooth_ones_blenders():
    obj = add_mesh(
        "Roof", [(0, 0, 0), (0, 2, 0), (1, 0, 1), (1, 2, 1), (2, 0, 0), (2, 2, 0)], [(0, 2, 3, 1), (2, 4, 5, 3)]
    )
    assert only_mesh().corner_normals is None
    obj.data.polygons.foreach_set("use_smooth", [True, True])
    mesh = only_mesh()
    assert mesh.corner_normals.shape == (4, 3, 3)
    ridge = mesh.positions[mesh.triangles][..., 2] == 1
    assert mesh.corner_normals[ridge] == pytest.approx(np.tile([0, 0, 1], (int(ridge.sum()), 1)), abs=1e-6)
    slope = 0.5**0.5
    left_eave = mesh.positions[mesh.triangles][..., 0] == 0
    assert mesh.corner_normals[left_eave] == pytest.approx(
        np.tile([-slope, 0, slope], (int(left_eave.sum()), 1)), abs=1e-6
    )


def test_custom_normals_are_kept():
    obj = add_triangle()
    obj.data.normals_split_custom_set([(0.6, 0, 0.8)] * 3)
    # Blender stores normals as two 16-bit angles
    assert only_mesh().corner_normals[0] == pytest.approx(np.tile([0.6, 0, 0.8], (3, 1)), abs=1e-3)


def test_uvs_of_the_layer_that_is_active_for_rendering():
    obj = add_triangle()
    assert only_mesh().corner_uvs is None
    for name, scale in (("a", 1), ("b", 10)):
        layer = obj.data.uv_layers.new(name=name)
        layer.uv.foreach_set("vector", np.float32([0, 0, scale, 0, 0, scale]))
    obj.data.uv_layers.active = obj.data.uv_layers["a"]
    obj.data.uv_layers["b"].active_render = True
    mesh = only_mesh()
    position = mesh.positions[mesh.triangles][..., :2]
    assert mesh.corner_uvs == pytest.approx(10 * position)


def test_material_slots_follow_the_faces_and_stay_within_the_slots():
    obj = add_mesh("Strip", [(x, y, 0) for x in range(4) for y in (0, 1)], [(0, 2, 3, 1), (2, 4, 5, 3), (4, 6, 7, 5)])
    for name in ("red", "green"):
        obj.data.materials.append(bpy.data.materials.new(name))
    assert only_mesh().triangle_slot is None, "all in the first slot"
    obj.data.polygons.foreach_set("material_index", [0, 1, 7])
    mesh = only_mesh()
    strip = np.floor(mesh.positions[mesh.triangles][..., 0].mean(axis=1)).astype(int)
    assert mesh.triangle_slot.tolist() == np.array([0, 1, 1])[strip].tolist()


def test_unused_vertices_are_dropped():
    loose = np.random.default_rng(0).normal(size=(1_000_000, 3)).astype(np.float32)
    mesh = bpy.data.meshes.new("Cloud")
    mesh.vertices.add(len(loose) + 3)
    mesh.vertices.foreach_set(
        "co", np.concatenate([loose, [(0, 0, 0), (1, 0, 0), (0, 1, 0)]]).astype(np.float32).ravel()
    )
    mesh.loops.add(3)
    mesh.loops.foreach_set("vertex_index", [1_000_000, 1_000_001, 1_000_002])
    mesh.polygons.add(1)
    mesh.polygons.foreach_set("loop_start", [0])
    mesh.update(calc_edges=True)
    add_object("Cloud", mesh)
    kept = only_mesh()
    assert kept.positions[kept.triangles[0]].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert len(kept.positions) == 3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_mesh_that_is_not_finite_is_left_out_by_name(bad):
    add_triangle("Good")
    # all at once, since Blender clamps values assigned to a single vertex
    add_triangle("Bad").data.vertices.foreach_set("co", np.float32([0, 0, 0, bad, 0, 0, 0, 1, 0]))
    scene = exported()
    assert [mesh.name for mesh in scene.meshes] == ["Good"]
    assert len(scene.instances) == 1
    (warning,) = scene.warnings
    assert "“Bad”" in warning and "1 vertices" in warning


def test_a_loose_vertex_that_is_not_finite_does_no_harm():
    add_mesh("Triangle", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (np.nan, 0, 0)], [(0, 1, 2)])
    assert np.isfinite(only_mesh().positions).all()


def test_a_mesh_without_faces_is_named_and_an_empty_one_is_nothing():
    add_mesh("Points", [(0, 0, 0), (1, 0, 0)], [])
    add_mesh("Nothing", [], [])
    scene = exported()
    assert scene.meshes == () and len(scene.instances) == 0
    (warning,) = scene.warnings
    assert "“Points”" in warning and "no faces" in warning


def test_zero_area_faces_are_kept():
    add_mesh("Sliver", [(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)])
    assert len(only_mesh().triangles) == 1


@pytest.mark.parametrize("kind", ["curve", "text", "surface", "metaball"])
def test_what_is_no_mesh_is_read_as_its_evaluated_mesh(kind):
    if kind == "curve":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.bevel_depth = 0.1
    elif kind == "text":
        bpy.ops.object.text_add()
    elif kind == "surface":
        bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    else:
        bpy.ops.object.metaball_add(type="BALL")
    scene = exported()
    assert len(scene.meshes) == len(scene.instances) == 1
    assert area(scene.meshes[0]) > 0.1
    assert scene.object_names == (bpy.context.object.name,)
    assert scene.warnings == ()


def test_a_mesh_in_edit_mode_is_read():
    obj = add_triangle()
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert area(only_mesh()) == pytest.approx(0.5)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_no_line_of_python_runs_once_a_vertex_face_or_corner():
    def lines_run(edge: int) -> int:
        obj = add_grid("Grid", edge)
        obj.data.uv_layers.new()
        obj.data.polygons.foreach_set("use_smooth", np.ones(edge * edge, bool))
        for _ in range(2):
            obj.data.materials.append(bpy.data.materials.new("m"))
        obj.data.polygons.foreach_set("material_index", np.arange(edge * edge, dtype=np.int32) % 2)
        count = 0

        def trace(_frame, event, _argument):
            nonlocal count
            count += event == "line"
            return trace

        data = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        before = sys.gettrace()
        sys.settrace(trace)
        try:
            mesh = export_mesh(data, "Grid", [])
        finally:
            sys.settrace(before)
        assert len(mesh.triangles) == 2 * edge * edge
        return count

    assert lines_run(60) == lines_run(6) > 0


# --- arrays are read as Blender stores them, and are what its slower collections say


@pytest.fixture
def bent(scene):
    """A mesh: a grid of quads that bend, of two materials."""
    made = add_grid("Grid", 5).data
    for number, vertex in enumerate(made.vertices):
        vertex.co.z = 0.3 * np.sin(2.3 * number)
    for number, polygon in enumerate(made.polygons):
        polygon.material_index = number % 2
        polygon.use_smooth = True
    for name in ("A", "B"):
        made.materials.append(bpy.data.materials.new(name))
    made.update()
    made.calc_loop_triangles()
    return made


def test_positions_triangles_and_materials_are_those_of_the_collections(bent):
    count, loops = len(bent.loop_triangles), read_loops(bent)
    np.testing.assert_array_equal(read_positions(bent), read(bent.vertices, "co", np.float32, len(bent.vertices), 3))
    expected = read(bent.loop_triangles, "vertices", np.int32, count, 3)
    np.testing.assert_array_equal(read_triangles(bent, loops), expected)
    polygons = read(bent.polygons, "material_index", np.int32, len(bent.polygons))
    of_faces = polygons[read(bent.loop_triangle_polygons, "value", np.int32, count)]
    np.testing.assert_array_equal(export_mesh(bent, "Grid", []).triangle_slot, of_faces)


@pytest.mark.parametrize("domain", ["POINT", "FACE", "CORNER"])
def test_normals_are_those_of_corners(bent, domain):
    for number, polygon in enumerate(bent.polygons):
        polygon.use_smooth = domain == "POINT" or (domain == "CORNER" and number % 3 > 0)
    bent.update()
    bent.calc_loop_triangles()
    assert bent.normals_domain == domain
    found = export_mesh(bent, "Grid", []).corner_normals
    if domain == "FACE":
        assert found is None
    else:
        corners = read(bent.corner_normals, "vector", np.float32, len(bent.loops), 3)
        np.testing.assert_array_equal(found, corners[read_loops(bent)])


def test_what_is_not_stored_is_asked_for_item_by_item(bent, monkeypatch):
    first = export_mesh(bent, "Grid", [])
    assert stored(bent, "not there", "value", np.int32, 1) is None
    assert stored(bent, "position", "vector", np.float32, len(bent.vertices) + 1, 3) is None
    for module in (mesh_arrays, export_mesh.__globals__):
        replace = monkeypatch.setattr if module is mesh_arrays else monkeypatch.setitem
        replace(module, "stored", lambda *_: None)
    second = export_mesh(bent, "Grid", [])
    for name in ("positions", "triangles", "triangle_slot", "corner_normals"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
