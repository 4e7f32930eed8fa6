"""Attributes of meshes and objects, tangents, pointiness and islands."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export.lookup3 import lookup3
from raybatch_addon.export.meshes.attributes import mesh_attributes, property_value
from raybatch_addon.export.meshes.mesh_shape import pointiness, random_per_island, welded
from raybatch_addon.export.meshes.tangents import corner_tangents
from tests.support.blender_builders import add_object, add_triangle, exported, material_of, node_tree

SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float32)
TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)])


def square_mesh():
    mesh = bpy.data.meshes.new("Square")
    mesh.from_pydata(SQUARE.tolist(), [], [(0, 1, 2, 3)])
    mesh.calc_loop_triangles()
    return mesh


@pytest.mark.parametrize(
    "domain, shape", [("POINT", (2, 3, 1)), ("CORNER", (2, 3, 1)), ("FACE", (2, 1)), ("EDGE", (2, 3, 1))]
)
def test_domains(domain, shape):
    mesh = square_mesh()
    values = mesh.attributes.new("a", "FLOAT", domain)
    values.data.foreach_set("value", np.full(len(values.data), 0.25, np.float32))
    warnings: list[str] = []
    (found,) = mesh_attributes(mesh, [("GEOMETRY", "a")], "Object", warnings)
    assert found.values.shape == shape and (found.values == 0.25).all() and not warnings


def test_a_missing_attribute_is_named():
    warnings: list[str] = []
    assert not mesh_attributes(square_mesh(), [("GEOMETRY", "none"), ("TANGENT", "map")], "Object", warnings)
    assert len(warnings) == 2 and "“none”" in warnings[0] and "“map”" in warnings[1]
    assert all("“Object”" in text for text in warnings)


def test_values_that_are_no_numbers_become_0_and_are_reported():
    mesh = square_mesh()
    values = mesh.attributes.new("a", "FLOAT_VECTOR", "POINT")
    values.data.foreach_set("vector", np.float32([np.nan, 1, np.inf] + [2] * 9))
    warnings: list[str] = []
    (found,) = mesh_attributes(mesh, [("GEOMETRY", "a")], "Object", warnings)
    assert set(found.values.ravel().tolist()) == {0, 1, 2}
    # the first vertex is a corner of both triangles
    assert "“a”" in warnings[0] and "4 numbers" in warnings[0] and warnings[0].objects == ("Object",)


@pytest.mark.parametrize(
    "name, expected",
    [
        ("number", (0.5, 0.5, 0.5, 1)),
        ("pair", (3, 4, 0, 1)),
        ("pass_index", (2, 2, 2, 1)),
        ("location", (1, 2, 3, 1)),
        ("none", None),
        ("", None),
        ("location.x", None),
        ("location[1]", None),
        ("name", None),
        ('["number"]', (0.5, 0.5, 0.5, 1)),
    ],
)
def test_properties_of_objects(name, expected):
    obj = bpy.data.objects.new("Object", None)
    obj["number"], obj["pair"], obj.pass_index, obj.location = 0.5, (3, 4), 2, (1, 2, 3)
    assert property_value(obj, name) == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_follow_the_map(mirrored):
    uvs = SQUARE[:, :2] @ np.array([[0, 1], [1, 0]]) if mirrored else SQUARE[:, :2] * (2, 3)
    normals = np.broadcast_to(np.float32((0, 0, 1)), (2, 3, 3))
    found = corner_tangents(SQUARE[TRIANGLES], normals, uvs[TRIANGLES])
    expected = (0, 1, 0, -1) if mirrored else (1, 0, 0, 1)
    assert found == pytest.approx(np.broadcast_to(expected, (2, 3, 4)))


def test_tangents_are_those_of_blender():
    """Tangents on a sphere of triangles, with the seam of its map."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    mesh = bpy.context.object.data
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    mesh.calc_loop_triangles()
    mesh.calc_tangents()
    expected = np.array([(*loop.tangent, loop.bitangent_sign) for loop in mesh.loops])
    loops = np.array([triangle.loops[:] for triangle in mesh.loop_triangles])
    (found,) = mesh_attributes(mesh, [("TANGENT", "")], "Sphere", [])
    assert found.values == pytest.approx(expected[loops], abs=1e-4)


def test_a_map_without_area_gives_unit_tangents():
    normals = np.broadcast_to(np.float32((0, 0, 1)), (2, 3, 3))
    found = corner_tangents(SQUARE[TRIANGLES], normals, np.zeros((2, 3, 2), np.float32))
    assert np.linalg.norm(found[..., :3], axis=-1) == pytest.approx(1)


def test_pointiness_of_a_plane_is_a_half():
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)])
    normals = np.broadcast_to(np.float32((0, 0, 1)), (4, 3))
    assert pointiness(SQUARE, normals, edges) == pytest.approx(0.5)


def test_vertices_at_one_place_are_one():
    positions = np.concatenate([SQUARE, SQUARE[1:3]])
    assert welded(positions).tolist() in ([0, 1, 2, 3, 1, 2], [0, 4, 5, 3, 4, 5])


def test_islands_have_a_number_each():
    found = random_per_island(6, np.array([(0, 1), (1, 2), (3, 4)]))
    assert len(set(found[:3].tolist())) == 1 and found[3] == found[4]
    assert len(set(found.tolist())) == 3 and (found >= 0).all() and (found <= 1).all()


def test_the_hash_takes_any_word():
    assert len(set(lookup3(np.array([0, 1, 2, 2**32 - 1], np.uint32)).tolist())) == 4


def asks(obj, kind, **properties):
    """Give `obj` a material that emits the output of a node of `kind`."""
    tree, surface = node_tree(material_of(obj, "Asks"))
    emission, node = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new(kind)
    for name, value in properties.items():
        setattr(node, name, value)
    tree.links.new(node.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)


@pytest.mark.usefixtures("scene")
def test_meshes_have_what_their_materials_ask_for_and_no_more():
    one, other = add_triangle("One"), add_triangle("Other")
    for obj in (one, other):
        for name in ("wanted", "not wanted"):
            obj.data.attributes.new(name, "FLOAT", "POINT")
    asks(one, "ShaderNodeAttribute", attribute_name="wanted")
    scene = exported()
    assert scene.attributes == (("GEOMETRY", "wanted"),)
    assert sorted([a.name for a in mesh.attributes] for mesh in scene.meshes) == [[], ["wanted"]]


@pytest.mark.usefixtures("scene")
def test_a_mesh_shared_by_objects_of_other_materials_has_what_both_ask_for():
    one = add_triangle("One")
    one.data.materials.append(None)
    other = add_object("Other", one.data)
    for obj, name in ((one, "first"), (other, "second")):
        obj.data.attributes.new(name, "FLOAT", "POINT")
        obj.material_slots[0].link = "OBJECT"
        obj.material_slots[0].material = bpy.data.materials.new(name)
        tree, surface = node_tree(obj.material_slots[0].material)
        emission, node = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        tree.links.new(node.outputs[0], emission.inputs["Color"])
        tree.links.new(emission.outputs[0], surface)
    (mesh,) = exported().meshes
    assert sorted(a.name for a in mesh.attributes) == ["first", "second"]


@pytest.mark.usefixtures("scene")
def test_objects_have_their_properties_and_those_of_what_places_them():
    obj = add_triangle("One")
    obj["tint"] = (0.1, 0.2, 0.3)
    asks(obj, "ShaderNodeAttribute", attribute_type="OBJECT", attribute_name="tint")
    assert exported().instances.attributes == pytest.approx(np.array([[[0.1, 0.2, 0.3, 1.0]]]))
    del obj["tint"]
    obj.update_tag()
    scene = exported()
    assert not scene.instances.attributes.any()
    (text,) = scene.warnings
    assert "“tint”" in text and "“One”" in text and "not supported" not in text


@pytest.mark.usefixtures("scene")
def test_instances_know_where_they_are_on_what_places_them():
    parent = add_object("Parent", bpy.data.meshes.new("Parent"))
    parent.data.from_pydata(SQUARE.tolist(), [], [(0, 1, 2), (0, 2, 3)])
    uvs = parent.data.uv_layers.new(name="UVMap")
    uvs.uv.foreach_set("vector", np.repeat([[0.25, 0.5], [0.75, 0.125]], 3, axis=0).astype(np.float32).ravel())
    child = add_triangle("Child")
    child.parent, parent.instance_type = parent, "FACES"
    asks(child, "ShaderNodeUVMap", from_instancer=True)
    values = exported().instances.attributes
    assert sorted(values[values.any(axis=(1, 2)), 0, :2].tolist()) == [[0.25, 0.5], [0.75, 0.125]]


@pytest.mark.usefixtures("scene")
def test_instances_have_random_numbers_of_their_own(scene):
    """Blender's random numbers are 32 bits, which it returns with a sign."""
    child = add_triangle("Child")
    parts = bpy.data.collections.new("Parts")
    scene.collection.objects.unlink(child)
    parts.objects.link(child)
    for i in range(8):
        copy = add_object(f"Copy {i}", None)
        copy.instance_type, copy.instance_collection = "COLLECTION", parts
    tree, surface = node_tree(material_of(child, "Asks"))
    emission, info = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeObjectInfo")
    tree.links.new(info.outputs["Random"], emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], surface)
    numbers = exported().instances.info[:, 5]
    assert len(set(numbers.tolist())) == 8 and (numbers >= 0).all() and (numbers <= 1).all()
    signed = [
        placed.random_id for placed in bpy.context.evaluated_depsgraph_get().object_instances if placed.is_instance
    ]
    assert min(signed) < 0 and sorted(numbers.tolist()) == pytest.approx(
        sorted(number % 2**32 / (2**32 - 1) for number in signed)
    )
