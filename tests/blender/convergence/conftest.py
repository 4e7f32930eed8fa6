"""A scene whose error is estimated and recorded."""

import pytest


@pytest.fixture
def lit(scene):
    """A grid under a lamp: its error is in the lamp's penumbra and in bounced light."""
    import bpy

    from raybatch_addon.convergence.records import store
    from raybatch_addon.ui.convergence import shown
    from tests.support.blender_builders import add_grid, add_object

    add_grid("Grid", 4)
    lamp = add_object("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.location = (0.5, 0.5, 1)
    scene.camera.location = (0, 0, 4)
    scene.raybatch.error_estimate = "ON"
    scene.raybatch_convergence.record = True  # without windows nothing is recorded unless asked for
    scene.raybatch.sample_count = 16
    store.clear()
    yield scene
    store.clear()
    image = bpy.data.images.get(shown.IMAGE_NAME)
    if image:
        bpy.data.images.remove(image)
