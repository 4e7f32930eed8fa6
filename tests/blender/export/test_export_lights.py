"""Exported lights and worlds against small renders by Cycles."""

import functools
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import warp as wp
from mathutils import Matrix, Vector

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData
from raybatch_addon.core.scene.description import Camera, CameraKind, Frame, LightKind, Scene, Visibility
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.shading.lights.choice import lit_point, packed_side
from raybatch_addon.core.shading.lights.hits import LightHitFeatures, make_light_hits
from raybatch_addon.core.shading.lights.lights import LightFeatures, make_lights
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.export.lights import export_light
from raybatch_addon.export.scene import export_scene
from raybatch_addon.export.world import export_world

COUNT = 2**15
FEATURES = LightFeatures(lights=tuple(LightKind), light_sphere=True)


@functools.cache
def probe_kernel():
    sample = make_lights(FEATURES).sample
    intersect, miss, _ = make_light_hits(LightHitFeatures(FEATURES.lights, FEATURES.light_sphere, light_hits=True))

    @wp.kernel(**KERNEL_OPTIONS)
    def probe(table: LightTable, geometry: Geometry, point: wp.vec3, up: wp.vec3, light: wp.array(dtype=wp.vec3)):
        i = wp.tid()
        r = wp.rand_init(11, i)
        lit = lit_point(point, packed_side(up, False))
        s = sample(table, geometry, lit, 0.0, wp.vec2(wp.randf(r), wp.randf(r)))
        if s.pdf > 0.0:
            light[i] = s.radiance * (wp.max(wp.dot(s.direction, up), 0.0) / s.pdf)

    @wp.kernel(**KERNEL_OPTIONS)
    def look(
        table: LightTable,
        nodes: NodeData,
        origin: wp.vec3,
        direction: wp.vec3,
        visibility: int,
        light: wp.array(dtype=wp.vec3),
    ):
        from_there = lit_point(origin, wp.uint32(0))
        seen = intersect(table, nodes, from_there, direction, 0.0, 1e30, visibility, 0.0, 0, 0)
        light[0] = seen + miss(table, nodes, from_there, direction, visibility, 0.0, 0, 0)

    return probe, look


def table_of(light):
    camera = Camera(CameraKind.PERSPECTIVE, np.eye(3, 4, dtype=np.float32), (-1, 1, -1, 1))
    return upload_lights(Scene(camera=camera, frame=Frame(1, 1), lights=(light,)), wp.get_device("cpu"))


def irradiance(light, point, up):
    """RayBatch's irradiance, RGB, with its standard error."""
    uploaded = table_of(light)
    out = wp.zeros(COUNT, dtype=wp.vec3, device="cpu")
    wp.launch(
        probe_kernel()[0],
        COUNT,
        [uploaded.table, Geometry(), wp.vec3(*point), wp.vec3(*up)],
        [out],
        device="cpu",
        block_dim=1,
    )
    values = out.numpy().astype(float)
    return values.mean(0), values.std(0).max() / math.sqrt(COUNT)


def seen_radiance(light, origin, direction):
    uploaded = table_of(light)
    out = wp.zeros(1, dtype=wp.vec3, device="cpu")
    inputs = [uploaded.table, NodeData(), wp.vec3(*origin), wp.vec3(*direction), int(Visibility.CAMERA)]
    wp.launch(probe_kernel()[1], 1, inputs, [out], device="cpu", block_dim=1)
    return out.numpy()[0].astype(float)


@pytest.fixture
def scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.resolution_percentage = 100
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", 256, False, False
    cycles.max_bounces, cycles.sample_clamp_direct, cycles.light_sampling_threshold, cycles.blur_glossy = 0, 0, 0, 0
    cycles.pixel_filter_type = "BOX"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.image_settings.color_mode = "RGBA"
    return scene


def cycles_mean(scene, path):
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(-1, 4)[:, :3].astype(float).mean(0)


def look_at(scene, point, origin):
    """An orthographic camera at `origin` that sees half a centimetre around `point`."""
    data = bpy.data.cameras.new("Camera")
    obj = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(obj)
    data.type, data.ortho_scale, data.clip_start = "ORTHO", 0.005, 1e-3
    obj.location = origin
    obj.rotation_euler = (Vector(point) - Vector(origin)).to_track_quat("-Z", "Y").to_euler()
    scene.camera = obj


def add_white_plane(scene, point):
    mesh = bpy.data.meshes.new("Plane")
    h = 0.01
    mesh.from_pydata([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], [], [(0, 1, 2, 3)])
    obj = bpy.data.objects.new("Plane", mesh)
    obj.location = point
    scene.collection.objects.link(obj)
    material = bpy.data.materials.new("White")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)


def add_light(scene, kind, scale=(1, 1, 1), name="Lamp", **values):
    data = bpy.data.lights.new(name, kind)
    obj = bpy.data.objects.new(name, data)
    scene.collection.objects.link(obj)
    obj.location, obj.rotation_euler, obj.scale = (0.4, -0.3, 1.5), (0.25, 0.2, 0.5), scale
    for key, value in values.items():
        setattr(data, key, value)
    bpy.context.view_layer.update()
    return obj


def export(obj, warnings=None):
    collected = [] if warnings is None else warnings
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    light = export_light(evaluated, evaluated.matrix_world, collected)
    assert warnings is not None or not collected
    return light


COLOR = dict(color=(1.0, 0.7, 0.4), energy=30.0)
CASES = {
    "point": ("POINT", (1, 1, 1), dict(shadow_soft_size=0.0)),
    "point disk": ("POINT", (3, 2, 1), dict(shadow_soft_size=0.4)),
    "point sphere inside": ("POINT", (1, 1, 1), dict(shadow_soft_size=2.5, use_soft_falloff=False)),
    "point not normalised": ("POINT", (1, 1, 1), dict(shadow_soft_size=0.3, normalize=False)),
    "point without size, not normalised": ("POINT", (1, 1, 1), dict(shadow_soft_size=0.0, normalize=False)),
    "point exposure and temperature": (
        "POINT",
        (1, 1, 1),
        dict(exposure=1.5, use_temperature=True, temperature=3500.0),
    ),
    "spot": ("SPOT", (2, 0.7, 1.3), dict(shadow_soft_size=0.0, spot_size=1.2, spot_blend=1.0)),
    "spot disk": ("SPOT", (1, 1, 1), dict(shadow_soft_size=0.5, spot_size=0.7, spot_blend=0.6)),
    "spot disk inside": ("SPOT", (1, 1, 1), dict(shadow_soft_size=2.5, spot_size=0.7, spot_blend=0.6)),
    "spot sphere": (
        "SPOT",
        (1, 1, 1),
        dict(shadow_soft_size=0.5, spot_size=0.7, spot_blend=0.3, use_soft_falloff=False),
    ),
    "sun": ("SUN", (1, 1, 1), dict(angle=0.0)),
    "sun wide": ("SUN", (-1, 2, 1), dict(angle=0.8)),
    "sun not normalised": ("SUN", (1, 1, 1), dict(angle=0.8, normalize=False)),
    "square": ("AREA", (1, 1, 1), dict(shape="SQUARE", size=1.0)),
    "rectangle scaled": ("AREA", (2, -0.5, 3), dict(shape="RECTANGLE", size=0.8, size_y=1.6)),
    "disk": ("AREA", (1, 1, 1), dict(shape="DISK", size=1.0)),
    "ellipse scaled": ("AREA", (2, 0.5, 1), dict(shape="ELLIPSE", size=0.8, size_y=1.6, normalize=False)),
    "rectangle spread": ("AREA", (1, 1, 1), dict(shape="RECTANGLE", size=0.8, size_y=1.6, spread=1.2)),
    "disk spread": ("AREA", (1, 1, 1), dict(shape="DISK", size=1.5, spread=0.8)),
    "parallel": ("AREA", (1, 1, 1), dict(shape="SQUARE", size=2.0, spread=0.0)),
}


@pytest.mark.parametrize("name", CASES)
def test_irradiance_is_that_of_cycles(scene, tmp_path, name):
    kind, scale, values = CASES[name]
    point = (0.3, 0.1, 0.2)
    add_white_plane(scene, point)
    look_at(scene, point, (0.3, 0.6, 0.7))
    light = export(add_light(scene, kind, scale, **COLOR, **values))
    theirs = cycles_mean(scene, tmp_path / "a.exr") * math.pi
    ours, error = irradiance(light, point, (0, 0, 1))
    assert theirs.max() > 0
    np.testing.assert_allclose(ours, theirs, atol=4 * error, rtol=5e-3)


@pytest.mark.parametrize("name", ["point disk", "spot sphere", "sun wide", "square", "disk spread"])
def test_lights_are_seen_as_in_cycles(scene, tmp_path, name):
    """Lights seen directly, if the object is visible to the camera; Blender's lights are not by default."""
    kind, scale, values = CASES[name]
    obj = add_light(scene, kind, scale, **COLOR, **values)
    away = obj.matrix_world.to_3x3() @ Vector((0.05, 0.02, -1))
    look_at(scene, obj.location, obj.location + 2 * away)
    hidden = export(obj)
    obj.visible_camera = True
    seen = export(obj)
    theirs = cycles_mean(scene, tmp_path / "b.exr")
    direction = -np.array(away.normalized())
    origin = np.array(obj.location) - 2 * away.length * direction
    assert theirs.max() > 0
    np.testing.assert_allclose(seen_radiance(seen, origin, direction), theirs, rtol=5e-3)
    assert not seen_radiance(hidden, origin, direction).any()


def emission_node(data):
    if bpy.app.version < (5, 0):
        data.use_nodes = True
    return next(node for node in data.node_tree.nodes if node.type in ("EMISSION", "BACKGROUND"))


def test_strength_and_nodes(scene):
    lamp = add_light(scene, "POINT", energy=4 * math.pi, color=(1, 0.5, 0.25), shadow_soft_size=0.0)
    np.testing.assert_allclose(export(lamp).emission, (1, 0.5, 0.25), rtol=1e-6)
    node = emission_node(lamp.data)
    node.inputs["Color"].default_value = (0.5, 1, 1, 1)
    node.inputs["Strength"].default_value = 3
    np.testing.assert_allclose(export(lamp).emission, (1.5, 1.5, 0.75), rtol=1e-6)
    tree = lamp.data.node_tree
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 2
    tree.links.new(value.outputs[0], node.inputs["Strength"])
    np.testing.assert_allclose(export(lamp).emission, (1, 1, 0.5), rtol=1e-6)
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    tree.links.new(falloff.outputs[0], node.inputs["Strength"])
    warnings = []
    light = export(lamp, warnings)
    np.testing.assert_allclose(light.emission, (1, 0.5, 0.25), rtol=1e-6)
    assert not warnings and {step.op for step in light.program.instructions} >= {"light_falloff", "emission"}
    tree.links.clear()
    assert export(lamp).emission == (0, 0, 0)


def test_flags(scene):
    lamp = add_light(scene, "POINT")
    assert export(lamp).visibility == int(Visibility.ALL & ~Visibility.CAMERA) and export(lamp).casts_shadow
    lamp.visible_glossy, lamp.data.use_shadow = False, False
    light = export(lamp)
    assert light.visibility == int(Visibility.ALL & ~Visibility.CAMERA & ~Visibility.GLOSSY) and not light.casts_shadow
    lamp.visible_volume_scatter = False
    assert not export(lamp).visibility & Visibility.VOLUME_SCATTER


def test_limits_of_bounces(scene):
    lamp, world = add_light(scene, "POINT"), bpy.data.worlds.new("Sky")
    assert export(lamp).bounce_max is None
    assert (export_world(world, []).bounce_max, export_world(world, []).casts_shadow) == (None, True)
    lamp.data.cycles.max_bounces, world.cycles.max_bounces = 2, 0
    warnings = []
    assert export(lamp, warnings).bounce_max == 2
    assert (export_world(world, warnings).bounce_max, export_world(world, warnings).casts_shadow) == (0, True)
    assert warnings == []


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="worlds have Cast Shadow from Blender 5 on")
def test_a_world_that_casts_no_shadow(scene):
    world = bpy.data.worlds.new("Sky")
    world.cycles.use_shadows = False
    assert not export_world(world, []).casts_shadow


def test_lights_that_cannot_be_rendered_are_named(scene):
    def single(obj):
        warnings = []
        light = export(obj, warnings)
        assert len(warnings) == 1 and obj.name in warnings[0]
        return light

    assert single(add_light(scene, "POINT", energy=-5.0, name="Dark")).emission == (0, 0, 0)
    assert single(add_light(scene, "SUN", (0, 0, 0), name="Flat sun")) is None
    assert single(add_light(scene, "SPOT", (1, 0, 1), name="Flat spot")) is None
    assert single(add_light(scene, "AREA", (0, 1, 1), name="Flat area")) is None
    broken = add_light(scene, "POINT", name="Lost")
    broken.location.x = float("nan")
    bpy.context.view_layer.update()
    assert single(broken) is None
    sheared = add_light(scene, "AREA", name="Sheared")
    warnings = []
    light = export_light(sheared, sheared.matrix_world @ Matrix.Shear("XY", 4, (0.5, 0.2)), warnings)
    assert "Sheared" in warnings[0]
    np.testing.assert_allclose(light.transform[:, :3].T @ light.transform[:, :3], np.eye(3), atol=1e-6)


def test_portals(scene, tmp_path):
    """Area lamps with Portal give no light: the world is sampled through them, also where it has one colour."""
    lamp = add_light(scene, "AREA", (1, 2, 1), name="Window")
    lamp.location = (1, 2, 3)
    lamp.data.size, lamp.data.cycles.is_portal = 0.5, True
    look_at(scene, (0, 0, 0), (0, 0, 1))
    scene.world = bpy.data.worlds.new("Sky")

    def exported():
        bpy.context.view_layer.update()
        found = export_scene(bpy.context.evaluated_depsgraph_get())
        assert not found.lights and not any("Window" in line for line in found.warnings)
        return found.world

    background = emission_node(scene.world)
    background.inputs["Color"].default_value = (0, 0, 0, 1)
    assert exported().portals == () and exported().program is None
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    world = exported()
    (portal,) = world.portals
    assert portal.kind == LightKind.RECTANGLE and portal.size == pytest.approx((0.5, 1.0))
    np.testing.assert_array_equal(portal.transform[:, 3], (1, 2, 3))
    assert world.program is not None and world.program.ops == ("emission",)
    scene.world.cycles.sampling_method = "NONE"
    scene.world.update_tag()
    assert exported().portals == ()


def test_world(scene, tmp_path):
    look_at(scene, (0, 0, 0), (0, 0, 1))
    assert export_world(None, []).radiance == (0, 0, 0)
    world = bpy.data.worlds.new("Sky")
    scene.world = world
    background = emission_node(world)
    background.inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)
    background.inputs["Strength"].default_value = 2.5
    warnings = []
    exported = export_world(world, warnings)
    np.testing.assert_allclose(exported.radiance, cycles_mean(scene, tmp_path / "c.exr"), rtol=1e-5)
    assert exported.visibility == int(Visibility.ALL) and not warnings
    world.cycles_visibility.diffuse = False
    assert export_world(world, []).visibility == int(Visibility.ALL & ~Visibility.DIFFUSE)
    world.cycles_visibility.diffuse, world.cycles_visibility.scatter = True, False
    assert export_world(world, []).visibility == int(Visibility.ALL & ~Visibility.VOLUME_SCATTER)
    background.inputs["Strength"].default_value = -1
    assert export_world(world, warnings).radiance == (0, 0, 0) and "Sky" in warnings.pop()
    sky = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    world.node_tree.links.new(sky.outputs[0], background.inputs["Color"])
    exported = export_world(world, warnings)
    assert exported.radiance == (0, 0, 0) and "environment" in exported.program.ops
