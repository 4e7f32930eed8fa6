"""Viewports without a window: a region made up in a real space, and Blender's updates passed on as it would."""

from __future__ import annotations

import time
from contextlib import contextmanager
from types import SimpleNamespace

import bpy
import numpy as np

SECONDS = 120.0  # a test waits for this at most: kernels may have to be compiled


def view_space() -> bpy.types.SpaceView3D:
    """A 3D view of the file's screens."""
    return next(area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D")


def region_context(width=48, height=32, through_camera=True) -> SimpleNamespace:
    """A context as callbacks get it: through the scene's camera, whose frame fills the region; or a view of its own."""
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    camera = scene.camera
    flat = camera.calc_matrix_camera(depsgraph, x=width, y=height)
    data = SimpleNamespace(
        view_perspective="CAMERA" if through_camera else "PERSP",
        view_matrix=camera.matrix_world.inverted(),
        window_matrix=flat,
        is_perspective=camera.data.type == "PERSP",
    )
    region = SimpleNamespace(width=width, height=height, data=data)
    return SimpleNamespace(
        region=region, space_data=view_space(), preferences=SimpleNamespace(system=SimpleNamespace(pixel_size=1.0))
    )


@contextmanager
def updates_to(receive):
    """`receive(depsgraph)` is called for each of Blender's evaluations, while its list of updates is there."""

    def handler(_scene, depsgraph):
        receive(depsgraph)

    bpy.app.handlers.depsgraph_update_post.append(handler)
    try:
        yield
    finally:
        if handler in bpy.app.handlers.depsgraph_update_post:  # Blender forgets it with the file
            bpy.app.handlers.depsgraph_update_post.remove(handler)


def wait_for(condition) -> None:
    """Return once `condition()`; fails where that does not come."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, "nothing came"
        time.sleep(0.002)


def matrix_of(rows) -> tuple[float, ...]:
    """The 16 numbers of a matrix of Blender's, row by row."""
    return tuple(float(each) for row in np.array(rows) for each in row)
