"""Meshes that an earlier export made are the same objects as long as Blender's are the same."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.frozen import is_frozen
from raybatch_addon.export.meshes import kept_meshes
from tests.support.blender_builders import add_grid, exported, node_tree

pytestmark = pytest.mark.usefixtures("scene")
FIELDS = ("positions", "triangles", "triangle_slot", "corner_normals", "corner_uvs")


@pytest.fixture
def obj():
    """A grid with a UV map, a colour attribute, two materials and a modifier; nothing is kept of earlier tests."""
    kept_meshes.forget_meshes()
    grid = add_grid("Grid", 4)
    grid.data.uv_layers.new(name="Map")
    grid.data.color_attributes.new("Paint", "BYTE_COLOR", "CORNER")
    for name in ("One", "Two"):
        grid.data.materials.append(bpy.data.materials.new(name))
    grid.data.polygons[0].material_index = 1
    material = grid.data.materials[0]
    tree, surface = node_tree(material)
    paint = tree.nodes.new("ShaderNodeVertexColor")
    paint.layer_name = "Paint"
    normal = tree.nodes.new("ShaderNodeNormalMap")
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(paint.outputs["Color"], shader.inputs["Color"])
    tree.links.new(normal.outputs[0], shader.inputs["Normal"])
    tree.links.new(shader.outputs[0], surface)
    grid.modifiers.new("Solid", "SOLIDIFY").thickness = 0.5
    return grid


def of_scene():
    (mesh,) = exported().meshes
    return mesh


def equal(a, b):
    return (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))


def assert_as_new(mesh):
    """`mesh` holds the numbers of an export that has nothing to go by."""
    kept_meshes.forget_meshes()
    new = of_scene()
    assert all(equal(getattr(mesh, name), getattr(new, name)) for name in FIELDS)
    assert [(a.kind, a.name) for a in mesh.attributes] == [(a.kind, a.name) for a in new.attributes]
    assert all(np.array_equal(a.values, b.values) for a, b in zip(mesh.attributes, new.attributes))


def test_an_unchanged_mesh_is_found_again(obj):
    first = of_scene()
    obj.update_tag(refresh={"DATA"})
    bpy.context.view_layer.update()  # evaluates it anew: other addresses, the same numbers
    second = of_scene()
    assert len(first.attributes) == 2 and first.corner_uvs is not None and first.triangle_slot is not None
    for name in FIELDS:
        assert getattr(second, name) is getattr(first, name), name
    assert all(a.values is b.values for a, b in zip(first.attributes, second.attributes))
    arrays = [getattr(first, name) for name in FIELDS] + [a.values for a in first.attributes]
    assert all(is_frozen(array) for array in arrays if array is not None)
    assert_as_new(second)


def move(obj):
    obj.data.vertices[0].co.z = 0.25


def thicken(obj):
    obj.modifiers[0].thickness = 0.75


def smooth(obj):
    obj.data.polygons.foreach_set("use_smooth", [True] * len(obj.data.polygons))
    obj.data.update()


def sharpen(obj):
    obj.data.shade_smooth() if hasattr(obj.data, "shade_smooth") else smooth(obj)
    obj.data.set_sharp_from_angle(angle=0.1)


def assign(obj):
    obj.data.polygons[1].material_index = 1


def unwrap(obj):
    obj.data.uv_layers[0].uv[0].vector = (0.75, 0.5)


def paint(obj):
    obj.data.color_attributes["Paint"].data[0].color = (1.0, 0.0, 0.5, 1.0)


def custom(obj):
    obj.data.normals_split_custom_set([(0.6, 0.0, 0.8)] * len(obj.data.loops))


def rotate_face(obj):
    data = obj.data
    loops = [loop.vertex_index for loop in data.loops]
    data.loops.foreach_set("vertex_index", loops[1:4] + loops[:1] + loops[4:])


@pytest.mark.parametrize(
    "change, kept",
    [
        (move, []),
        (thicken, []),
        (smooth, []),
        (sharpen, []),
        (assign, []),
        (custom, []),
        (rotate_face, []),
        (unwrap, ["positions", "triangles", "triangle_slot"]),
        (paint, list(FIELDS)),
    ],
)
def test_a_changed_mesh_is_exported_anew(obj, change, kept):
    first = of_scene()
    change(obj)
    obj.data.update()
    obj.update_tag(refresh={"DATA"})
    bpy.context.view_layer.update()
    second = of_scene()
    same = [
        name for name in FIELDS if getattr(first, name) is not None and getattr(second, name) is getattr(first, name)
    ]
    assert same == [name for name in kept if getattr(first, name) is not None]
    changed = [name for name in FIELDS if not equal(getattr(first, name), getattr(second, name))]
    colors = [next(a.values for a in mesh.attributes if a.kind == "COLOR") for mesh in (first, second)]
    assert changed or not np.array_equal(*colors), "the change shows"
    assert_as_new(second)


def test_another_map_or_color_attribute_that_is_marked_for_rendering_counts(obj):
    obj.data.uv_layers.new(name="Second").uv[0].vector = (0.5, 0.25)
    first = of_scene()
    obj.data.uv_layers["Second"].active_render = True
    obj.update_tag(refresh={"DATA"})
    bpy.context.view_layer.update()
    second = of_scene()
    assert not np.array_equal(first.corner_uvs, second.corner_uvs)
    assert_as_new(second)


def test_meshes_that_are_not_used_any_more_are_dropped(obj):
    of_scene()
    assert len(kept_meshes._kept) == 1
    bpy.data.objects.remove(obj)
    for _ in range(2):
        exported()
    assert not kept_meshes._kept


def test_of_a_mesh_that_deforms_the_last_shape_alone_is_kept(obj, monkeypatch):
    kept_before = []
    real = kept_meshes.export_mesh

    def export_mesh(*arguments):
        kept_before.append(len(kept_meshes._kept))
        return real(*arguments)

    monkeypatch.setattr(kept_meshes, "export_mesh", export_mesh)
    other = add_grid("Other", 4)
    other.location.x = 9.0
    for frame in range(4):
        obj.data.vertices[0].co.z = 0.1 * frame
        obj.data.update()
        obj.update_tag(refresh={"DATA"})
        bpy.context.view_layer.update()
        exported()
    assert kept_before == [0, 1, 1, 1, 1] and len(kept_meshes._kept) == 2, "nothing but the grid that stays"
    assert len(kept_meshes._last) == 2


def test_two_shapes_of_a_mesh_that_take_turns_are_both_kept(obj):
    """Two shapes like those of a viewport and of a final render, each of which is found again."""
    made = []
    for hidden in (True, True, False, True, False, True):
        obj.modifiers["Solid"].thickness = 0.25 if hidden else 0.5
        bpy.context.view_layer.update()
        made.append(of_scene().positions)
    assert made[0] is made[1] is made[3] is made[5] and made[2] is made[4] is not made[0]


def test_kept_meshes_take_a_share_of_the_memory_at_most(obj, monkeypatch):
    of_scene()
    monkeypatch.setattr(kept_meshes, "_MEMORY_SHARE", 0.0)
    of_scene()
    assert not kept_meshes._kept


def test_a_uv_map_that_is_rounded_in_another_way_is_the_same(obj):
    """Modifiers that run on several threads interpolate it differently each time."""

    def scale(factor):
        uv = obj.data.uv_layers[0].uv
        values = np.empty(2 * len(uv), np.float32)
        uv.foreach_get("vector", values)
        uv.foreach_set("vector", values * np.float32(factor))
        obj.update_tag(refresh={"DATA"})
        bpy.context.view_layer.update()

    scale(0.7)  # of many digits
    first = of_scene()
    scale(1 + 2**-22)
    second = of_scene()
    assert second.corner_uvs is first.corner_uvs
    assert all(a.values is b.values for a, b in zip(first.attributes, second.attributes, strict=True))
    scale(1 + 2**-17)
    third = of_scene()
    assert not np.array_equal(third.corner_uvs, first.corner_uvs)
    assert_as_new(third)


def test_attributes_are_alike_number_by_number():
    values = np.array([0.0, 1e6, 0.1, np.nan, np.inf], np.float32)
    assert kept_meshes._is_alike(values[:3], values[:3] * np.float32(1 + 2**-23))
    for place, other in enumerate((1e-9, 1e6 + 4, 0.1001)):
        changed = values[:3].copy()
        changed[place] = other
        assert not kept_meshes._is_alike(values[:3], changed)
    assert not kept_meshes._is_alike(values[2:4], np.array([0.1, 1.0], np.float32))
    assert not kept_meshes._is_alike(values[4:], np.array([1.0], np.float32))
    assert not kept_meshes._is_alike(np.array([1, 2]), np.array([1, 3]))
