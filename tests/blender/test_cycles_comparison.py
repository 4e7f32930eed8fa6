"""Whole pictures against Cycles' own renders of the same .blend, with Cycles made unbiased."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.features.build import ball, box, diffuse, floor, lamp, look, principled, quad, shaded
from tests.blender.features.compare import add_world, both_reopened, figures_of, set_alike
from tests.support.blender_builders import add_object

MEAN_TOLERANCE = 0.01
REL_MSE = 2e-3


@pytest.fixture
def stage(scene):
    """The empty scene with the same settings for both engines."""
    set_alike(scene)
    return scene


def assert_alike(ours, theirs, request):
    found = figures_of(ours, theirs)
    assert ours.warnings == []
    assert found.theirs.min() > 0.02, "a picture in which there is something to see"
    figures = (
        f"{request.node.name}: means {found.ours} and {found.theirs} (ratio {found.ratios}), relMSE {found.rel_mse:.3g}"
    )
    print(figures)
    assert found.noise < MEAN_TOLERANCE / 3, figures
    assert found.mean_error < MEAN_TOLERANCE, figures
    assert found.rel_mse < REL_MSE, figures


# --- scenes


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


def test_a_cornell_box(stage, tmp_path, request, examples):
    cornell_box(stage)
    box("Tall", (-0.35, 0.3, -0.4), (0.6, 0.6, 1.2), 0.3, (0.73, 0.73, 0.73))
    box("Short", (0.35, -0.3, -0.7), (0.6, 0.6, 0.6), -0.3, (0.73, 0.73, 0.73))
    assert_alike(*both_reopened(tmp_path, examples(128)), request)


def test_few_bounces_are_the_same_bounces(stage, tmp_path, request, examples):
    """A limit that has an effect: what counts as a bounce, and where the last one ends."""
    cornell_box(stage)
    stage.cycles.max_bounces = stage.raybatch.bounce_max = 1
    assert_alike(*both_reopened(tmp_path, examples(64)), request)


def test_a_cornell_box_of_plastic_metal_and_glass(stage, tmp_path, request):
    cornell_box(stage)
    principled(ball("Plastic", (-0.55, 0.2, -0.65), 0.35), (0.2, 0.3, 0.8), Roughness=0.3)
    principled(ball("Metal", (0.5, 0.4, -0.6), 0.4), (0.95, 0.7, 0.3), Metallic=1.0, Roughness=0.25)
    principled(ball("Glass", (0.1, -0.4, -0.65), 0.35), (0.9, 1.0, 0.95), Transmission_Weight=1.0, Roughness=0.1)
    assert_alike(*both_reopened(tmp_path, 192), request)


COLOR = (0.8, 0.5, 0.2)
# rough glass scatters once here: Cycles' addition for more bounces loses up to 1 % of the light in a white furnace
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
    ours, theirs = both_reopened(tmp_path, 192)
    assert_alike(ours, theirs, request)
    for i, (kind, inputs) in enumerate(SHADERS):
        cell = slice(20 * (i // 3), 20 * (i // 3) + 20), slice(20 * (i % 3), 20 * (i % 3) + 20)
        ratio = ours.mean[cell].mean((0, 1)) / theirs.mean[cell].mean((0, 1))
        noise = np.sqrt((ours.variance + theirs.variance)[cell].sum((0, 1))) / theirs.mean[cell].sum((0, 1))
        print(f"    {kind} {inputs}: ratio {ratio}, noise {noise}")
        assert (np.abs(ratio - 1) < MEAN_TOLERANCE + 2 * noise).all(), (kind, inputs, ratio, noise)


def test_lights_of_all_kinds_together(stage, tmp_path, request, examples):
    floor()
    box("Box", (0, 0, 0.5), (1, 1, 1), 0.4, (0.7, 0.7, 0.7))
    lamp("POINT", (-1.5, -1, 1.5), energy=60.0, shadow_soft_size=0.2, color=(1, 0.5, 0.3))
    lamp("SPOT", (2, -1, 3), target=(0.5, 0, 0), energy=300.0, shadow_soft_size=0.1, spot_size=0.7, spot_blend=0.4)
    lamp("SUN", (0, 0, 5), target=(1.5, 3, 0), energy=0.5, angle=0.2, color=(0.4, 0.6, 1))
    lamp("AREA", (-0.5, 1.5, 2), target=(0, 0, 0), energy=40.0, shape="DISK", size=0.8)
    look(stage, (0, -6, 4), (0, 0, 0.3))
    assert_alike(*both_reopened(tmp_path, examples(128)), request)


def test_a_smooth_sphere_of_few_faces_under_the_world_alone(stage, tmp_path, request, examples):
    add_world(stage, 1.0, (0.3, 0.6, 1.0))
    floor()
    diffuse(ball("Ball", (0, 0, 1), 1.0, segments=12, rings=6), (0.8, 0.5, 0.2))
    look(stage, (0, -5, 2), (0, 0, 0.8))
    assert_alike(*both_reopened(tmp_path, examples(128)), request)


def test_instances_of_a_collection(stage, tmp_path, request, examples):
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
    assert_alike(*both_reopened(tmp_path, examples(128)), request)


def test_depth_of_field(stage, tmp_path, request, examples):
    add_world(stage, 0.3)
    floor()
    for i, y in enumerate((-2.5, 0, 3)):
        shaded(
            ball(f"Ball {i}", (0.8 * i - 0.8, y, 0.5), 0.5),
            "ShaderNodeEmission",
            Color=((1, 0.2, 0.1, 1), (0.2, 1, 0.1, 1), (0.1, 0.2, 1, 1))[i],
        )
    look(stage, (0, -6, 1.5), (0, 0, 0.5))
    dof = stage.camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop, dof.aperture_blades = True, 6.1, 0.1, 5
    assert_alike(*both_reopened(tmp_path, examples(128)), request)
