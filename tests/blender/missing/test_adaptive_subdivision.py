"""Adaptive subdivision, for which levels stand in, is named before the render."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.notice import Weight
from tests.blender.missing.test_before_the_render import found, the_one
from tests.support.blender_builders import add_grid


def test_it_is_named_where_it_would_be_rendered(scene):
    modifier = add_grid("Host", 1).modifiers.new("Subdivision", "SUBSURF")
    if not hasattr(modifier, "use_adaptive_subdivision"):
        pytest.skip("objects of this Cycles have it, not modifiers")
    assert found(scene) == []
    modifier.use_adaptive_subdivision = True
    notice = the_one(scene, "adaptive subdivision")
    assert notice.weight == Weight.REPLACED and "Host" in notice and "levels for renders" in notice
    modifier.show_render = False
    assert found(scene) == []
