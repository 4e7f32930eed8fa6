"""Cameras and frames of regions of the 3D view."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene.cameras import CameraKind
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.export.camera import export_camera
from raybatch_addon.export.live.view3d import camera_of, live_camera, region_view
from tests.blender.viewport.regions import region_context

FRAME = Frame(1, 1)


def seen(context, scene):
    view = region_view(context.region, context.space_data, scene)
    return view, *live_camera(view, scene.camera, bpy.context.evaluated_depsgraph_get(), FRAME)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.2, -0.1)])
def test_through_the_camera_a_region_of_its_frame_sees_what_it_sees(scene, kind, shift):
    scene.camera.data.type = kind
    scene.camera.data.shift_x, scene.camera.data.shift_y = shift
    scene.camera.location, scene.camera.rotation_euler = (1, -5, 2), (1.2, 0.1, 0.2)
    scene.camera.data.dof.use_dof = True
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    bpy.context.view_layer.update()
    _, camera, frame = seen(region_context(48, 32), scene)
    own = export_camera(scene, bpy.context.evaluated_depsgraph_get(), 48, 32, [])
    assert camera.kind == own.kind and frame.region == (0, 0, 48, 32)
    assert np.allclose(camera.transform, own.transform, atol=1e-5)
    assert np.allclose(camera.window, own.window, atol=1e-5)
    assert (camera.clip_start, camera.clip_end) == (own.clip_start, own.clip_end)
    assert np.isclose(camera.lens_radius, own.lens_radius) and camera.lens_radius > 0


def test_a_view_of_its_own_is_sharp_and_clips_as_the_space_does(scene):
    scene.camera.data.dof.use_dof = True
    context = region_context(through_camera=False)
    context.space_data.clip_start, context.space_data.clip_end = 0.5, 50
    _, camera, _ = seen(context, scene)
    assert camera.kind == CameraKind.PERSPECTIVE and camera.lens_radius == 0
    assert (camera.clip_start, camera.clip_end) == (0.5, 50)


@pytest.mark.parametrize(
    "through_camera, matrix, named",
    [
        (True, "to_view", "camera “Camera”: its matrix"),
        (True, "projection", "camera “Camera”: its lens"),
        (False, "to_view", "the view's matrix"),
        (False, "projection", "the view's matrix"),
    ],
)
def test_a_view_that_is_not_finite_is_named(scene, through_camera, matrix, named):
    context = region_context(through_camera=through_camera)
    context.space_data.use_render_border = scene.render.use_border = True
    view, *_ = seen(context, scene)
    scene.camera.name = "Camera"
    lost = replace(view, **{matrix: (float("nan"),) * 16})
    with pytest.raises(SceneError, match=f"{named} is not finite; .*(reset|choose)"):
        live_camera(lost, scene.camera, bpy.context.evaluated_depsgraph_get(), FRAME)


def test_an_orthographic_view_sees_behind_where_it_is(scene):
    scene.camera.data.type = "ORTHO"
    context = region_context(through_camera=False)
    context.space_data.clip_end = 50
    _, camera, _ = seen(context, scene)
    assert camera.kind == CameraKind.ORTHOGRAPHIC
    assert np.allclose(camera.transform[:, 3], (0, 0, 60)) and camera.clip_end == 100


def test_a_border_is_a_part_of_the_cameras_frame_or_of_the_region(scene):
    render = scene.render
    render.resolution_x, render.resolution_y = 48, 32
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.5, 0.25, 0.75
    context = region_context(48, 32)
    view, _, frame = seen(context, scene)
    assert frame.border == (12, 8, 24, 24)
    # zoomed out to half the size the frame is the middle of the region
    zoomed = replace(
        view, projection=tuple(each * (0.5 if i in (0, 5) else 1) for i, each in enumerate(view.projection))
    )
    frame = live_camera(zoomed, scene.camera, bpy.context.evaluated_depsgraph_get(), FRAME)[1]
    assert frame.border == (18, 12, 24, 20)
    away = replace(view, border=(-2.0, 0.0, -1.0, 1.0))
    assert live_camera(away, scene.camera, bpy.context.evaluated_depsgraph_get(), FRAME)[1] is None
    space = context.space_data
    space.use_render_border = True
    space.render_border_min_x, space.render_border_max_x = 0.5, 1.0
    space.render_border_min_y, space.render_border_max_y = 0.0, 0.5
    try:
        assert seen(region_context(48, 32, through_camera=False), scene)[2].border == (24, 0, 48, 16)
    finally:
        space.use_render_border = False


def test_a_panorama_fills_the_cameras_frame(scene):
    data = scene.camera.data
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    data.type = "PANO"
    context = region_context(48, 32)
    context.region.data.is_perspective = True
    _, camera, _ = seen(context, scene)
    assert camera.kind.is_panorama and np.allclose(camera.window, (0, 1, 0, 1), atol=1e-5)


def test_without_a_camera_the_view_is_its_own(scene):
    context = region_context()
    scene.camera = None
    view = region_view(context.region, context.space_data, scene)
    assert not view.through_camera and camera_of(context.space_data, scene) is None
    camera, frame = live_camera(view, None, bpy.context.evaluated_depsgraph_get(), FRAME)
    assert camera.kind == CameraKind.PERSPECTIVE and frame is not None
