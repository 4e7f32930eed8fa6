"""Bumped normals against the gradient of a height, and attributes as programs read them."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.inputs_data import upload_inputs
from raybatch_addon.core.programs.op import NodeData
from raybatch_addon.core.programs.ops.inputs.attributes import attribute_value, attribute_width
from raybatch_addon.core.programs.ops.inputs.bump import bumped
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.scene.description import Attribute, Camera, CameraKind, Frame, Instances, Mesh, Scene
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def bump_probe(
    normal: wp.vec3, steps: wp.array(dtype=wp.vec3), rises: wp.vec2, strength: float, out: wp.array(dtype=wp.vec3)
):
    out[0] = bumped(normal, steps[0], steps[1], rises[0], rises[1], strength)


def bump(normal, x, y, rise_x, rise_y, strength=1.0):
    out = wp.zeros(1, dtype=wp.vec3, device=DEVICE)
    steps = wp.array([x, y], dtype=wp.vec3, device=DEVICE)
    wp.launch(bump_probe, 1, [wp.vec3(*normal), steps, wp.vec2(rise_x, rise_y), strength, out], device=DEVICE)
    return out.numpy()[0]


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
@pytest.mark.parametrize("length", [1e-4, 1.0, 30.0])
def test_a_slope_bends_the_normal_by_its_gradient(angle, length):
    """The steps may be turned by any angle, either way round."""
    x = length * np.array([np.cos(angle), np.sin(angle), 0])
    y = length * np.array([-np.sin(angle), np.cos(angle), 0])
    gradient = np.array([0.3, -0.7, 0])
    expected = (np.array([0, 0, 1]) - gradient) / np.linalg.norm([0.3, 0.7, 1])
    for a, b in ((x, y), (y, x)):
        assert bump((0, 0, 1), a, b, gradient @ a, gradient @ b) == pytest.approx(expected, abs=1e-5)


def test_strength_mixes_with_the_normal():
    bent = bump((0, 0, 1), (1, 0, 0), (0, 1, 0), 0.5, 0.0)
    half = bump((0, 0, 1), (1, 0, 0), (0, 1, 0), 0.5, 0.0, 0.5)
    expected = bent + (0, 0, 1)
    assert half == pytest.approx(expected / np.linalg.norm(expected), abs=1e-6)
    assert bump((0, 0, 1), (1, 0, 0), (0, 1, 0), 0.5, 0.0, 0.0) == pytest.approx((0, 0, 1))


def test_steps_without_area_leave_the_normal():
    assert bump((0, 0, 1), (1, 0, 0), (1, 0, 0), 0.0, 0.0) == pytest.approx((0, 0, 1))


def scene_of(*attributes: Attribute, mirrored: bool = False) -> Scene:
    mesh = Mesh("Mesh", np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), attributes=attributes)
    matrix = np.eye(4, dtype=np.float32)[None, :3].copy()
    matrix[0, 0, 0] = -1 if mirrored else 1
    none = np.zeros(1, np.int32)
    return Scene(
        Camera(CameraKind.PERSPECTIVE, np.eye(4, dtype=np.float32)[:3], (-1, 1, -1, 1)),
        Frame(4, 4),
        (mesh,),
        Instances(none, matrix, none, none, none),
        attributes=(("GEOMETRY", "first"), ("GEOMETRY", "second")),
    )


@wp.kernel(**KERNEL_OPTIONS)
def attribute_probe(data: NodeData, out: wp.array(dtype=wp.vec4), widths: wp.array(dtype=int)):
    i = wp.tid()
    point = ShadingPoint()
    widths[i] = attribute_width(data, point, i)
    if widths[i] > 0:
        out[i] = attribute_value(data, point, i, widths[i], wp.vec2(0.25, 0.5))


def read(scene: Scene):
    data = NodeData()
    data.inputs = upload_inputs(scene, ("attribute",), DEVICE)
    out, widths = wp.zeros(2, dtype=wp.vec4, device=DEVICE), wp.zeros(2, dtype=int, device=DEVICE)
    wp.launch(attribute_probe, 2, [data, out, widths], device=DEVICE)
    return out.numpy(), widths.numpy()


@pytest.mark.parametrize("mirrored", [False, True])
def test_attributes_are_interpolated_between_the_corners_of_the_geometry(mirrored):
    """A mirrored mesh has its last two corners exchanged."""
    corners = np.array([[[1, 10], [2, 20], [4, 40]]], np.float32)
    values, widths = read(scene_of(Attribute("GEOMETRY", "first", corners), mirrored=mirrored))
    assert widths.tolist() == [2, 0]
    weights = (0.25, 0.5, 0.25) if mirrored else (0.25, 0.25, 0.5)
    assert values[0] == pytest.approx((*(weights @ corners[0]), 0, 0))


def test_attributes_of_triangles_are_the_same_all_over_them():
    values, widths = read(scene_of(Attribute("GEOMETRY", "second", np.array([[3, 4, 5, 6]], np.float32))))
    assert widths.tolist() == [0, 4]
    assert values[1] == pytest.approx((3, 4, 5, 6))
