"""Whole pictures against Cycles' own renders of the same .blend, with Cycles made unbiased.

Every engine renders a scene twice, with seeds of its own; its picture is the mean of the two, whose variance in a
pixel is estimated by (first - second)^2 / 4. With A the picture by RayBatch and B that by Cycles, the expectation of
(A - B)^2 is their true difference squared plus both variances, so that

    relMSE = mean(((A - B)^2 - (A1 - A2)^2 / 4 - (B1 - B2)^2 / 4) / (B^2 + EPSILON))

estimates the difference without the noise; it may come out below zero.
"""

from dataclasses import dataclass

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import bmesh  # noqa: E402
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
    width, height = image.size
    pixels = pixels.reshape(height, width, -1)[..., :3].astype(float)
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
    assert means[1].min() > 0.02, "a picture in which there is something to see"
    figures = f"{request.node.name}: means {means[0]} and {means[1]} (ratio {means[0] / means[1]}), relMSE {error:.3g}"
    print(figures)
    assert np.abs(means[0] / means[1] - 1).max() < MEAN_TOLERANCE, figures
    assert error < REL_MSE, figures


# --- scenes


def shaded(obj, kind, distribution=None, **inputs):
    """`obj` with a material of one shader node."""
    tree, surface = node_tree(material_of(obj, f"{obj.name} material"))
    node = tree.nodes.new(kind)
    if distribution is not None:
        node.distribution = distribution
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], surface)
    return obj


def diffuse(obj, color):
    return shaded(obj, "ShaderNodeBsdfDiffuse", Color=(*color, 1))


def principled(obj, color, **inputs):
    return shaded(obj, "ShaderNodeBsdfPrincipled", Base_Color=(*color, 1), **inputs)


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


def floor():
    obj = add_grid("Floor", 1)
    obj.scale = (8, 8, 1)
    return diffuse(obj, (0.5, 0.4, 0.3))


# --- tests


def test_a_cornell_box(stage, tmp_path, request):
    cornell_box(stage)
    box("Tall", (-0.35, 0.3, -0.4), (0.6, 0.6, 1.2), 0.3, (0.73, 0.73, 0.73))
    box("Short", (0.35, -0.3, -0.7), (0.6, 0.6, 0.6), -0.3, (0.73, 0.73, 0.73))
    assert_alike(*both(tmp_path, 128), request)


def test_few_bounces_are_the_same_bounces(stage, tmp_path, request):
    """A limit that bites: what a bounce is and where the last one ends."""
    cornell_box(stage)
    stage.cycles.max_bounces = stage.raybatch.bounce_max = 1
    assert_alike(*both(tmp_path, 64), request)


def test_a_cornell_box_of_plastic_metal_and_glass(stage, tmp_path, request):
    cornell_box(stage)
    principled(ball("Plastic", (-0.55, 0.2, -0.65), 0.35), (0.2, 0.3, 0.8), Roughness=0.3)
    principled(ball("Metal", (0.5, 0.4, -0.6), 0.4), (0.95, 0.7, 0.3), Metallic=1.0, Roughness=0.25)
    principled(ball("Glass", (0.1, -0.4, -0.65), 0.35), (0.9, 1.0, 0.95), Transmission_Weight=1.0, Roughness=0.1)
    assert_alike(*both(tmp_path, 192), request)


COLOR = (0.8, 0.5, 0.2)
# Rough glass scatters once here: what Cycles adds for more loses up to 1 % of the light in a white furnace
SHADERS = [
    ("ShaderNodeBsdfAnisotropic", dict(Roughness=0.3)),
    ("ShaderNodeBsdfGlass", dict(Roughness=0.0, IOR=1.5)),
    ("ShaderNodeBsdfGlass", dict(Roughness=0.4, IOR=1.3, distribution="GGX")),
    ("ShaderNodeBsdfPrincipled", dict(Roughness=0.0, IOR=2.0)),
    ("ShaderNodeBsdfPrincipled", dict(Roughness=0.6, Metallic=0.5)),
    ("ShaderNodeBsdfPrincipled", dict(Roughness=0.2, Transmission_Weight=1.0)),
    ("ShaderNodeBsdfPrincipled", dict(Roughness=0.5, Transmission_Weight=0.5, Specular_IOR_Level=1.0)),
    ("ShaderNodeBsdfPrincipled", dict(Alpha=0.4)),
    ("ShaderNodeBsdfPrincipled", dict(Emission_Strength=0.5, Emission_Color=(0.2, 0.4, 1, 1))),
]


def test_materials_side_by_side(stage, tmp_path, request):
    """Nine balls seen from above; each must be right, not only their sum."""
    floor()
    add_world(stage, 1.0, (0.4, 0.5, 0.7))
    lamp("SUN", (0, 0, 5), target=(1, 2, 0), energy=1.5, angle=0.8)
    for i, (kind, inputs) in enumerate(SHADERS):
        obj = ball(f"Ball {i}", (2 * (i % 3) - 2, 2 * (i // 3) - 2, 1), 0.95)
        first = "Base_Color" if kind == "ShaderNodeBsdfPrincipled" else "Color"
        shaded(obj, kind, **{first: (*COLOR, 1)}, **inputs)
    stage.render.resolution_x = stage.render.resolution_y = 60
    stage.camera.data.type, stage.camera.data.ortho_scale = "ORTHO", 6
    ours, theirs = both(tmp_path, 192)
    assert_alike(ours, theirs, request)
    for i, (kind, inputs) in enumerate(SHADERS):
        cell = slice(20 * (i // 3), 20 * (i // 3) + 20), slice(20 * (i % 3), 20 * (i % 3) + 20)
        ratio = ours.mean[cell].mean((0, 1)) / theirs.mean[cell].mean((0, 1))
        noise = np.sqrt((ours.variance + theirs.variance)[cell].sum((0, 1))) / theirs.mean[cell].sum((0, 1))
        print(f"    {kind} {inputs}: ratio {ratio}, noise {noise}")
        assert (np.abs(ratio - 1) < MEAN_TOLERANCE + 2 * noise).all(), (kind, inputs, ratio, noise)


def test_lights_of_all_kinds_together(stage, tmp_path, request):
    floor()
    box("Box", (0, 0, 0.5), (1, 1, 1), 0.4, (0.7, 0.7, 0.7))
    lamp("POINT", (-1.5, -1, 1.5), energy=60.0, shadow_soft_size=0.2, color=(1, 0.5, 0.3))
    lamp("SPOT", (2, -1, 3), target=(0.5, 0, 0), energy=300.0, shadow_soft_size=0.1, spot_size=0.7, spot_blend=0.4)
    lamp("SUN", (0, 0, 5), target=(1.5, 3, 0), energy=0.5, angle=0.2, color=(0.4, 0.6, 1))
    lamp("AREA", (-0.5, 1.5, 2), target=(0, 0, 0), energy=40.0, shape="DISK", size=0.8)
    look(stage, (0, -6, 4), (0, 0, 0.3))
    assert_alike(*both(tmp_path, 128), request)


def test_a_smooth_sphere_of_few_faces_under_the_world_alone(stage, tmp_path, request):
    add_world(stage, 1.0, (0.3, 0.6, 1.0))
    floor()
    diffuse(ball("Ball", (0, 0, 1), 1.0, segments=12, rings=6), (0.8, 0.5, 0.2))
    look(stage, (0, -5, 2), (0, 0, 0.8))
    assert_alike(*both(tmp_path, 128), request)


def test_instances_of_a_collection(stage, tmp_path, request):
    add_world(stage, 0.5)
    floor()
    lamp("SUN", (0, 0, 5), target=(1, 2, 0), energy=2.0, angle=0.3)
    parts = bpy.data.collections.new("Parts")
    for obj in (box("Box", (0, 0, 0.4), (0.8, 0.8, 0.8), 0.2, (0.8, 0.2, 0.1)), ball("Ball", (0.2, 0, 1.1), 0.4)):
        stage.collection.objects.unlink(obj)
        parts.objects.link(obj)
    principled(bpy.data.objects["Ball"], (0.1, 0.7, 0.3), Roughness=0.4)
    for i, (x, y) in enumerate([(-1.5, 0), (0, 1), (1.5, -0.5)]):
        obj = add_object(f"Copy {i}", None)
        obj.instance_type, obj.instance_collection = "COLLECTION", parts
        obj.location, obj.rotation_euler, obj.scale = (x, y, 0), (0, 0, 0.7 * i), (1, 1 + 0.2 * i, 0.8 + 0.3 * i)
    look(stage, (0, -6, 3), (0, 0, 0.5))
    assert_alike(*both(tmp_path, 128), request)


def test_depth_of_field(stage, tmp_path, request):
    add_world(stage, 0.3)
    floor()
    for i, y in enumerate((-2.5, 0, 3)):
        shaded(ball(f"Ball {i}", (0.8 * i - 0.8, y, 0.5), 0.5), "ShaderNodeEmission", Color=((1, 0.2, 0.1, 1), (0.2, 1, 0.1, 1), (0.1, 0.2, 1, 1))[i])
    look(stage, (0, -6, 1.5), (0, 0, 0.5))
    dof = stage.camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop, dof.aperture_blades = True, 6.1, 0.1, 5
    assert_alike(*both(tmp_path, 128), request)
