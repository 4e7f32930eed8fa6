"""Strands that an earlier export cut are the same arrays as long as Blender's points are the same."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.frozen import is_frozen
from raybatch_addon.export.meshes import kept_meshes
from tests.support.blender_builders import add_object, exported, node_tree

pytestmark = pytest.mark.usefixtures("scene")
FIELDS = ("positions", "triangles", "radii", "corner_uvs")
BENT = np.float32([(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 2, 5)])


@pytest.fixture
def hair():
    """A bent strand and a straight one with UV coordinates, which their material reads; nothing is kept of others."""
    kept_meshes.forget_meshes()
    curves = bpy.data.hair_curves.new("Hair")
    curves.add_curves([5, 2])
    points = np.concatenate([BENT, np.float32([(0, 0, 0), (0, 0, 1)])])
    curves.position_data.foreach_set("vector", points.ravel())
    uvs = curves.attributes.new("surface_uv_coordinate", "FLOAT2", "CURVE")
    uvs.data.foreach_set("vector", np.float32([0.25, 0.5, 0.75, 0.5]))
    material = bpy.data.materials.new("Mapped")
    tree, surface = node_tree(material)
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(tree.nodes.new("ShaderNodeUVMap").outputs[0], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], surface)
    curves.materials.append(material)
    return add_object("Hair", curves)


def of_scene():
    (mesh,) = exported().meshes
    return mesh


def test_unchanged_strands_are_found_again(hair):
    first = of_scene()
    hair.update_tag(refresh={"DATA"})
    bpy.context.view_layer.update()
    second = of_scene()
    assert len(first.triangles) > 6 and first.corner_uvs is not None
    for name in FIELDS:
        assert getattr(second, name) is getattr(first, name) and is_frozen(getattr(first, name)), name
    kept_meshes.forget_meshes()
    new = of_scene()
    assert all(np.array_equal(getattr(second, name), getattr(new, name)) for name in FIELDS)


def move(data):
    data.position_data[0].vector = (1, 0, 0.5)


def thicken(data):
    radii = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    radii.data.foreach_set("value", np.full(7, 0.02, np.float32))


def map_elsewhere(data):
    data.attributes["surface_uv_coordinate"].data.foreach_set("vector", np.float32([0.1, 0.5, 0.75, 0.5]))


@pytest.mark.parametrize("change, other", [(move, "positions"), (thicken, "radii"), (map_elsewhere, "corner_uvs")])
def test_strands_that_changed_are_cut_anew(hair, change, other):
    first = of_scene()
    change(hair.data)
    hair.data.update_tag()
    bpy.context.view_layer.update()
    second = of_scene()
    assert not np.array_equal(getattr(second, other), getattr(first, other))
    kept_meshes.forget_meshes()
    new = of_scene()
    assert all(np.array_equal(getattr(second, name), getattr(new, name)) for name in FIELDS)
