"""Materials that Blender makes up where a file gives none, or none with nodes."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.export.materials import export_material
from tests.support.blender_builders import add_triangle, exported

pytestmark = pytest.mark.usefixtures("scene")

RED = (1.0, 0.25, 0.125, 1.0)


def test_no_material_is_the_default_of_cycles():
    """A Principled BSDF as it is added; Lambert's before Blender 5."""
    add_triangle()
    (material,) = exported().materials
    if bpy.app.version < (5, 0):
        (closure,) = material.closures
        assert closure.kind == K.DIFFUSE and closure.weight == pytest.approx([0.8] * 3)
        return
    added = bpy.data.materials.new("As it is added")
    expected = {each.kind: each.weight for each in export_material(added)[0].closures}
    assert {each.kind: each.weight for each in material.closures} == expected
    assert [each.roughness for each in material.closures] == pytest.approx([0.5] * len(material.closures))


def test_a_material_without_nodes_has_its_viewport_values():
    material = bpy.data.materials.new("Plain")
    if bpy.app.version >= (5, 0):
        pytest.skip("materials have nodes always")
    material.use_nodes = False
    material.diffuse_color, material.metallic, material.roughness = RED, 1.0, 0.25
    got, _ = export_material(material)
    (closure,) = got.closures
    assert closure.kind == K.METAL and closure.roughness == 0.25
    assert np.array(closure.weight) * closure.color == pytest.approx(RED[:3])
