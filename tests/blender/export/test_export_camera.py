"""Exported cameras against Blender's own projection, and their bokeh against Cycles."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import warp as wp
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene.description import CameraKind
from raybatch_addon.core.shading.camera import CameraData, CameraFeatures, make_camera_ray, upload_camera
from raybatch_addon.export.camera import export_camera


def shoot(camera, width, height, pixel, lens):
    """World rays through `pixel` [n, 2] and points `lens` [n, 2] of the aperture: origin, direction, t_max."""
    camera_ray = make_camera_ray(CameraFeatures(camera.kind, camera.lens_radius > 0))

    @wp.kernel(**KERNEL_OPTIONS)
    def shoot_rays(
        data: CameraData,
        pixel: wp.array(dtype=wp.vec2),
        lens: wp.array(dtype=wp.vec2),
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
    ):
        i = wp.tid()
        o, d, t = camera_ray(data, pixel[i][0], pixel[i][1], lens[i])
        origin[i] = o
        direction[i] = d
        t_max[i] = t

    arrays = [wp.array(np.asarray(a, np.float32), dtype=wp.vec2, device="cpu") for a in (pixel, lens)]
    out = [wp.zeros(len(pixel), dtype=t, device="cpu") for t in (wp.vec3, wp.vec3, float)]
    wp.launch(shoot_rays, len(pixel), [upload_camera(camera, width, height), *arrays], out, device="cpu", block_dim=1)
    return [a.numpy().astype(float) for a in out]


@pytest.fixture
def scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def add_camera(scene, matrix=None, **values):
    data = bpy.data.cameras.new("Camera")
    obj = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(obj)
    if matrix is not None:
        obj.matrix_world = matrix
    for name, value in values.items():
        setattr(data, name, value)
    scene.camera = obj
    return obj


def export(scene, warnings=None, size=None):
    width, height = size or (scene.render.resolution_x, scene.render.resolution_y)
    bpy.context.view_layer.update()
    return export_camera(
        scene, bpy.context.evaluated_depsgraph_get(), width, height, [] if warnings is None else warnings
    )


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_rays_agree_with_blenders_projection(scene, kind):
    rng = np.random.default_rng(5)
    for fit in ("AUTO", "HORIZONTAL", "VERTICAL"):
        for width, height in ((160, 90), (90, 160)):
            matrix = Matrix.LocRotScale(
                Vector(rng.normal(size=3) * 5), Euler(rng.uniform(-3, 3, 3)), Vector(rng.uniform(0.3, 3, 3))
            )
            obj = add_camera(
                scene,
                matrix,
                type=kind,
                sensor_fit=fit,
                lens=float(rng.uniform(10, 120)),
                sensor_width=float(rng.uniform(10, 50)),
                sensor_height=float(rng.uniform(10, 50)),
                shift_x=float(rng.uniform(-0.4, 0.4)),
                shift_y=float(rng.uniform(-0.4, 0.4)),
                ortho_scale=float(rng.uniform(0.5, 9)),
                clip_start=0.25,
                clip_end=60.0,
            )
            scene.render.resolution_x, scene.render.resolution_y = width, height
            scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = rng.uniform(1, 2, 2)
            camera = export(scene)
            assert camera.kind == (CameraKind.ORTHOGRAPHIC if kind == "ORTHO" else CameraKind.PERSPECTIVE)
            pixel = rng.uniform(0, (width, height), (20, 2))
            origin, direction, t_max = shoot(camera, width, height, pixel, np.zeros((20, 2)))
            for o, d, t, p in zip(origin, direction, t_max, pixel):
                near = world_to_camera_view(scene, obj, Vector(o))
                far = world_to_camera_view(scene, obj, Vector(o + d * t))
                assert near.z == pytest.approx(0.25, abs=1e-4) and far.z == pytest.approx(60, rel=1e-4)
                for seen in (near, far):
                    np.testing.assert_allclose((seen.x * width, seen.y * height), p, atol=2e-2)


def test_animated_and_parented_cameras_are_evaluated(scene):
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    parent.location = (1, 2, 3)
    obj = add_camera(scene)
    obj.parent = parent
    obj.data.keyframe_insert("lens", frame=1)
    obj.data.lens = 100
    obj.data.keyframe_insert("lens", frame=10)
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.frame_set(10)
    camera = export(scene)
    np.testing.assert_allclose(camera.transform[:, 3], [1, 2, 3])
    assert camera.window[1] == pytest.approx(0.5 * obj.data.sensor_width / 100)


def test_depth_of_field_settings(scene):
    obj = add_camera(scene, Matrix.Rotation(0.4, 4, "X"), lens=80.0)
    dof = obj.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 2.0, 7.0
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 5, 0.3, 1.5
    camera = export(scene)
    assert camera.lens_radius == pytest.approx(0.02) and camera.focus_distance == pytest.approx(7)
    assert (camera.blade_count, camera.blade_rotation, camera.lens_ratio) == (5, pytest.approx(0.3), pytest.approx(1.5))
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    target.location = (0, 3, -4)
    dof.focus_object = target
    assert export(scene).focus_distance == pytest.approx(
        abs(target.location @ (obj.matrix_world.to_3x3() @ Vector((0, 0, -1)))), rel=1e-5
    )
    obj.data.type = "ORTHO"
    assert export(scene).lens_radius == pytest.approx(0.25)
    dof.focus_object, dof.focus_distance = None, 0.0
    warnings = []
    assert export(scene, warnings).lens_radius == 0 and "Camera" in warnings[0]


def cycles_image(scene, size, samples, path):
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    cycles = scene.cycles
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising, cycles.pixel_filter_type = (
        samples,
        False,
        False,
        "BOX",
    )
    cycles.device = "CPU"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(size, size, 4)[..., 0].astype(float)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_bokeh_is_that_of_cycles(scene, tmp_path, kind):
    """A small bright sphere out of focus shows the aperture: shape, rotation, squeeze and size."""
    size = 24
    obj = add_camera(scene, Euler((1.1, 0.2, 0.4)).to_matrix().to_4x4(), type=kind, lens=120.0, ortho_scale=1.2)
    dof = obj.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 0.29 if kind == "PERSP" else 1.5, 2.0
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 3, 0.5, 1.6
    data = bpy.data.lights.new("Lamp", "POINT")
    data.shadow_soft_size, data.use_soft_falloff, data.energy = 0.1, False, 1.0
    lamp = bpy.data.objects.new("Lamp", data)
    scene.collection.objects.link(lamp)
    centre = obj.matrix_world @ Vector((0.05, 0.1, -4.0))
    lamp.location, lamp.visible_camera = centre, True
    theirs = cycles_image(scene, size, 1024, tmp_path / "bokeh.exr")

    rng = np.random.default_rng(2)
    count = 1000
    y, x = np.divmod(np.arange(size * size), size)
    pixel = np.repeat(np.column_stack([x, y]), count, 0) + rng.uniform(size=(size * size * count, 2))
    origin, direction, _ = shoot(export(scene), size, size, pixel, rng.uniform(size=pixel.shape))
    offset = np.array(centre) - origin
    along = (offset * direction).sum(1)
    hit = (along > 0) & ((offset**2).sum(1) - along**2 < 0.1**2)
    ours = hit.reshape(size, size, count).mean(-1) / (4 * math.pi * math.pi * 0.1**2)
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.03)
    # the rest is noise: a pixel in the bokeh has some hundred hits
    assert ((ours - theirs) ** 2).mean() < 0.02 * (theirs**2).mean()
    for flipped in (ours[::-1], ours[:, ::-1], ours[::-1, ::-1]):
        assert ((flipped - theirs) ** 2).mean() > 0.05 * (theirs**2).mean()


def test_cameras_that_cannot_be_rendered(scene):
    with pytest.raises(SceneError, match="no camera"):
        export(scene)
    empty = bpy.data.objects.new("Not a camera", None)
    scene.collection.objects.link(empty)
    scene.camera = empty
    with pytest.raises(SceneError, match="Not a camera"):
        export(scene)
    obj = add_camera(scene)
    obj.scale = (1, 0, 1)
    with pytest.raises(SceneError, match="Camera.*singular"):
        export(scene)
    obj.scale = (1, 1, 1)
    obj.location.x = float("nan")
    with pytest.raises(SceneError, match="Camera.*not finite"):
        export(scene)
    obj.location.x = 0
    obj.data.clip_start, obj.data.clip_end = 10, 1
    with pytest.raises(SceneError, match="Camera.*clip"):
        export(scene)
    obj.data.clip_end = 100
    if "CUSTOM" not in obj.data.bl_rna.properties["type"].enum_items:
        return
    obj.data.type = "CUSTOM"
    warnings = []
    assert export(scene, warnings).kind == CameraKind.PERSPECTIVE
    assert len(warnings) == 1 and "custom" in warnings[0] and "Camera" in warnings[0]
