"""The camera that scenes without one are given."""

import pytest

bpy = pytest.importorskip("bpy")

from real_files.sheets import sheets_of

from tests.support.blender_builders import add_grid, material_of


def test_a_scene_whose_objects_are_hidden_in_viewports_shows_nothing(scene):
    grid = add_grid("Grid", 2)
    material_of(grid)
    bpy.data.objects.remove(scene.camera)
    grid.hide_viewport = True
    assert sheets_of(scene) is None and scene.camera is None
    grid.hide_viewport = False
    assert sheets_of(scene) is not None and scene.camera is not None
