"""Whole pictures against Cycles' own renders of the same .blend, with Cycles made unbiased.

Every engine renders a scene twice, with seeds of its own; its picture is the mean of the two, whose variance in a
pixel is estimated by (first - second)^2 / 4. With A the picture by RayBatch and B that by Cycles, the expectation of
(A - B)^2 is their true difference squared plus both variances, so that

    relMSE = mean(((A - B)^2 - (A1 - A2)^2 / 4 - (B1 - B2)^2 / 4) / (B^2 + EPSILON))

estimates the difference without the noise; it may come out below zero.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_builders import add_grid, add_mesh, add_object, material_of, node_tree  # noqa: E402
from mathutils import Vector  # noqa: E402

from raybatch_addon import frame, reports  # noqa: E402

MEAN_TOLERANCE = 0.01
REL_MSE = 2e-3
EPSILON = 1e-2  # keeps what is nearly black from counting most
BOUNCES = 6


@dataclass
class Picture:
    """Two independent renders of one engine: float64 [height, width, 3]."""

    first: np.ndarray
    second: np.ndarray

    @property
    def mean(self):
        return (self.first + self.second) / 2

    @property
    def variance(self):
        return (self.first - self.second) ** 2 / 4


@pytest.fixture
def stage(scene):
    """The empty scene with everything set alike for both engines."""
    render, cycles, ours = scene.render, scene.cycles, scene.raybatch
    render.resolution_x = render.resolution_y = 64
    image = render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
    cycles.device, cycles.use_denoising, cycles.use_adaptive_sampling = "CPU", False, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    ours.pixel_filter, ours.filter_width = "BLACKMAN_HARRIS", 1.5
    for name in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
        setattr(cycles, f"{name}_bounces", BOUNCES)
    ours.bounce_max = ours.transparent_bounce_max = BOUNCES
    add_world(scene, 0.0)
    return scene


def add_world(scene, strength, color=(1, 1, 1)):
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = strength


def by_raybatch(scene, seed, samples):
    films = []

    def listen(_layer, _scene, film):
        films.append(film)

    scene.render.engine = "RAYBATCH"
    scene.raybatch.seed, scene.raybatch.sample_count = seed, samples
    frame.film_listeners.append(listen)
    try:
        bpy.ops.render.render()
    finally:
        frame.film_listeners.remove(listen)
    (film,) = films
    assert film.statistics["invalid_samples"] == 0 and reports.last().warnings == []
    return film.passes["Combined"][..., :3].astype(float)


def by_cycles(scene, seed, samples, path):
    scene.render.engine, scene.render.filepath = "CYCLES", str(path)
    scene.cycles.seed, scene.cycles.samples = seed, samples
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(*image.size[::-1], -1)[..., :3].astype(float)
    bpy.data.images.remove(image)
    return pixels


def both(folder, samples, cycles_samples=None):
    """The scene as it is, saved and opened again, by RayBatch and by Cycles; `samples` are those of each of the two renders."""
    blend = str(folder / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.ops.wm.open_mainfile(filepath=blend)
    scene = bpy.context.scene
    ours = Picture(*(by_raybatch(scene, seed, samples) for seed in (1, 2)))
    theirs = Picture(*(by_cycles(scene, seed, cycles_samples or samples, folder / f"{seed}.exr") for seed in (3, 4)))
    return ours, theirs


def rel_mse(ours, theirs):
    """As the module's head states it."""
    difference = (ours.mean - theirs.mean) ** 2 - ours.variance - theirs.variance
    return float((difference / (theirs.mean**2 + EPSILON)).mean())


def assert_alike(ours, theirs, request):
    means = ours.mean.mean((0, 1)), theirs.mean.mean((0, 1))
    error = rel_mse(ours, theirs)
    figures = f"{request.node.name}: means {means[0]} and {means[1]} (ratio {means[0] / means[1]}), relMSE {error:.3g}"
    print(figures)
    assert theirs.mean.mean() > 0.02, "a picture in which there is something to see"
    assert np.abs(means[0] / means[1] - 1).max() < MEAN_TOLERANCE, figures
    assert error < REL_MSE, figures


# --- scenes


def diffuse(obj, color):
    tree, surface = node_tree(material_of(obj, f"{obj.name} diffuse"))
    node = tree.nodes.new("ShaderNodeBsdfDiffuse")
    node.inputs["Color"].default_value = (*color, 1)
    tree.links.new(node.outputs[0], surface)
    return obj


def principled(obj, color, **inputs):
    tree, surface = node_tree(material_of(obj, f"{obj.name} principled"))
    node = tree.nodes.new("ShaderNodeBsdfPrincipled")
    node.inputs["Base Color"].default_value = (*color, 1)
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], surface)
    return obj


def quad(name, corners, color):
    return diffuse(add_mesh(name, corners, [(0, 1, 2, 3)]), color)


def box(name, place, size, turn, color):
    h = 0.5
    corners = [(x, y, z) for x in (-h, h) for y in (-h, h) for z in (-h, h)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    obj = add_mesh(name, corners, faces)
    obj.location, obj.scale, obj.rotation_euler.z = place, size, turn
    return diffuse(obj, color)


def ball(name, place, radius, segments=32, rings=16):
    """A smooth UV sphere."""
    import bmesh

    mesh = bpy.data.meshes.new(name)
    shape = bmesh.new()
    bmesh.ops.create_uvsphere(shape, u_segments=segments, v_segments=rings, radius=radius)
    for face in shape.faces:
        face.smooth = True
    shape.to_mesh(mesh)
    shape.free()
    obj = add_object(name, mesh)
    obj.location = place
    return obj


def look(scene, eye, target, lens=35.0):
    camera = scene.camera
    camera.location, camera.data.lens = eye, lens
    camera.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y").to_euler()


def lamp(kind, place, target=None, **values):
    data = bpy.data.lights.new(kind.title(), kind)
    for name, value in values.items():
        setattr(data, name, value)
    obj = add_object(data.name, data)
    obj.location = place
    if target is not None:
        obj.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    return obj


def cornell_box(scene):
    """Walls from -1 to 1, open towards the camera at -y, and a square light below the ceiling."""
    white, red, green = (0.73, 0.73, 0.73), (0.65, 0.05, 0.05), (0.12, 0.45, 0.15)
    quad("Floor", [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)], white)
    quad("Ceiling", [(-1, -1, 1), (-1, 1, 1), (1, 1, 1), (1, -1, 1)], white)
    quad("Back", [(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)], white)
    quad("Left", [(-1, -1, -1), (-1, 1, -1), (-1, 1, 1), (-1, -1, 1)], red)
    quad("Right", [(1, -1, -1), (1, -1, 1), (1, 1, 1), (1, 1, -1)], green)
    lamp("AREA", (0, 0, 0.98), energy=40.0, shape="SQUARE", size=0.7, color=(1, 0.85, 0.6))
    look(scene, (0, -3.6, 0), (0, 0, 0), lens=42)


# --- tests


def test_a_cornell_box(stage, tmp_path, request):
    cornell_box(stage)
    box("Tall", (-0.35, 0.3, -0.4), (0.6, 0.6, 1.2), 0.3, (0.73, 0.73, 0.73))
    box("Short", (0.35, -0.3, -0.7), (0.6, 0.6, 0.6), -0.3, (0.73, 0.73, 0.73))
    assert_alike(*both(tmp_path, 256), request)


def test_a_cornell_box_of_plastic_metal_and_glass(stage, tmp_path, request):
    cornell_box(stage)
    principled(ball("Plastic", (-0.55, 0.2, -0.65), 0.35), (0.2, 0.3, 0.8), Roughness=0.3)
    principled(ball("Metal", (0.5, 0.4, -0.6), 0.4), (0.95, 0.7, 0.3), Metallic=1.0, Roughness=0.25)
    principled(ball("Glass", (0.1, -0.4, -0.65), 0.35), (0.9, 1.0, 0.95), Transmission_Weight=1.0, Roughness=0.1)
    assert_alike(*both(tmp_path, 512), request)
