"""Projections of image and environment textures against their geometry, and at the ends of the range of numbers."""

import numpy as np
import pytest

from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.description import Image
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from tests.core.programs.image_probe import run_image_op

RNG = np.random.default_rng(3)
SIZE = 256
# each texel holds its own coordinates, so that a look-up shows its position (away from the edges)
X, Y = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE, (np.arange(SIZE) + 0.5) / SIZE)
PLACES = Image("places", np.stack([X, Y, np.full_like(X, 0.5), np.full_like(X, 0.75)], 2).astype(np.float32))
SPECIAL = [0, -0.0, 0.5, 1, -1, 1e-45, 1e7, -1e7, 3e38, np.inf, -np.inf, np.nan]


def look(projection, points):
    return run_image_op("image", [PLACES], [0, Interpolation.LINEAR, Extension.EXTEND, projection, 0], points)


def look_box(points, normals, blend):
    return run_image_op(
        "image_box", [PLACES], [0, Interpolation.LINEAR, Extension.EXTEND, 0, -1], points, normals, constants=[blend]
    )


def look_around(projection, directions):
    return run_image_op("environment", [PLACES], [0, Interpolation.LINEAR, projection, 0], directions)


def inside(values):
    """Whether coordinates are more than a texel away from the edges."""
    return np.all((values > 1.5 / SIZE) & (values < 1 - 1.5 / SIZE), 1)


def assert_places(values, expected):
    good = inside(expected)
    assert np.count_nonzero(good) > len(good) / 2
    assert np.abs(values[good, :2] - expected[good]).max() < 1e-5
    assert np.allclose(values[:, 2:], (0.5, 0.75), atol=1e-6)


def test_flat_takes_x_and_y():
    points = RNG.random((300, 3))
    assert_places(look(Projection.FLAT, points), points[:, :2])


def test_sphere_is_longitude_and_latitude_around_the_middle_of_the_cube():
    points = RNG.random((300, 3))
    p = 2 * points - 1
    u = 0.5 - np.arctan2(p[:, 0], p[:, 1]) / (2 * np.pi)
    v = 1 - np.arccos(p[:, 2] / np.linalg.norm(p, axis=1)) / np.pi
    assert_places(look(Projection.SPHERE, points), np.stack([u, v], 1))


def test_tube_is_angle_and_height():
    points = RNG.random((300, 3))
    p = 2 * points - 1
    u = 0.5 - np.arctan2(p[:, 0], p[:, 1]) / (2 * np.pi)
    assert_places(look(Projection.TUBE, points), np.stack([u, points[:, 2]], 1))


@pytest.mark.parametrize("sign", [1, -1])
def test_box_looks_along_the_normal_without_mirroring(sign):
    points = RNG.random((100, 3))
    x, y, z = points.T
    for axis, (across, up, flips) in enumerate([(y, z, sign < 0), (x, z, sign > 0), (y, x, sign > 0)]):
        normals = np.zeros((100, 3))
        normals[:, axis] = sign
        assert_places(look_box(points, normals, 0.0), np.stack([1 - across if flips else across, up], 1))


def test_box_mixes_smoothly_by_the_normal():
    """The weights are continuous over the sphere of normals, and sum to 1."""
    image = Image("x only", np.full((1, 1, 4), 1, np.float32))
    turns = np.linspace(0, 2 * np.pi, 4001)
    for blend in (0.05, 0.5, 1.0):
        for tilt in (0.0, 0.4, 1.0):
            normals = np.stack([np.cos(turns), np.sin(turns), np.full_like(turns, tilt)], 1)
            points = np.tile([0.25, 0.5, 0.75], (len(turns), 1))
            values = run_image_op(
                "image_box",
                [PLACES],
                [0, Interpolation.LINEAR, Extension.EXTEND, 0, -1],
                points,
                np.abs(normals),
                constants=[blend],
            )
            assert np.abs(np.diff(values, axis=0)).max() < 0.02 / blend
            ones = run_image_op("image_box", [image], [0, 1, 0, 0, -1], points, normals, constants=[blend])
            assert np.allclose(ones, 1, atol=1e-5)


def test_equirectangular():
    d = RNG.normal(size=(400, 3))
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    u = 0.5 - np.arctan2(unit[:, 1], unit[:, 0]) / (2 * np.pi)
    v = 0.5 + np.arcsin(unit[:, 2]) / np.pi
    assert_places(look_around(EnvironmentProjection.EQUIRECTANGULAR, d), np.stack([u, v], 1))


def test_mirror_ball_shows_what_its_normal_reflects():
    d = RNG.normal(size=(400, 3))
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    values = look_around(EnvironmentProjection.MIRROR_BALL, d)
    x, z = 2 * values[:, 0] - 1, 2 * values[:, 1] - 1
    y = -np.sqrt(np.maximum(1 - x * x - z * z, 0))
    normal = np.stack([x, y, z], 1)
    view = np.array([0.0, 1.0, 0.0])
    reflected = view - 2 * (normal @ view)[:, None] * normal
    steep = unit[:, 1] < 0.9  # away from the edges of the ball, where image coordinates repeat
    assert np.abs(reflected - unit)[steep].max() < 1e-4 and np.count_nonzero(steep) > 300


@pytest.mark.parametrize("projection", Projection)
def test_special_coordinates_are_finite(projection):
    points = [(x, y, z) for x in SPECIAL for y in SPECIAL for z in SPECIAL]
    assert np.all(np.isfinite(look(projection, points)))


def test_special_directions_normals_and_blends_are_finite():
    points = np.array([(x, y, z) for x in SPECIAL for y in SPECIAL for z in SPECIAL])
    for projection in EnvironmentProjection:
        assert np.all(np.isfinite(look_around(projection, points)))
    for blend in (0.0, 1e-30, 0.5, 1.0, -1.0, 2.0, np.inf, np.nan):
        assert np.all(np.isfinite(look_box(points, points[::-1], blend)))
