"""Values of utility ops, folded on the host; test_utility_ops.py compares devices."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.programs.ops.values.color import ColorModel
from raybatch_addon.core.programs.ops.values.curves import CURVE_SIZE
from raybatch_addon.core.programs.ops.values.map_range import RangeInterpolation
from raybatch_addon.core.programs.ops.values.math import MathOperation as M
from raybatch_addon.core.programs.ops.values.mixing import BlendMode
from raybatch_addon.core.programs.ops.values.ramp import RAMP_SIZE
from raybatch_addon.core.programs.ops.values.rotate import MappingKind, RotationKind
from raybatch_addon.core.programs.ops.values.spaces import Space, VectorKind
from raybatch_addon.core.programs.ops.values.spectrum import blackbody_table, wavelength_table
from raybatch_addon.core.programs.ops.values.vector_math import VectorOperation as V
from raybatch_addon.core.scene.geometry import mat34
from tests.core.programs.utility_probe import on_host

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-2, 2, (50, 3)).astype(np.float32)
NAN, INF = float("nan"), float("inf")


def one(name, immediates, *operands, **more):
    """The first outputs of an op."""
    row = np.concatenate([np.atleast_1d(np.asarray(each, np.float32)) for each in operands])
    return on_host(name, immediates, row[None], **more)[0]


@pytest.mark.parametrize(
    "operation, a, b, c, expected",
    [
        (M.DIVIDE, 1, 0, 0, 0),
        (M.POWER, -2, 3, 0, -8),
        (M.POWER, -2, 0.5, 0, 0),
        (M.POWER, 0, 0, 0, 1),
        (M.POWER, 0, -1, 0, 0),
        (M.POWER, -2, 4e9, 0, 0),
        (M.POWER, -2, NAN, 0, 0),
        (M.LOGARITHM, 8, 2, 0, 3),
        (M.LOGARITHM, -8, 2, 0, 0),
        (M.LOGARITHM, 8, 1, 0, 0),
        (M.SQRT, -4, 0, 0, 0),
        (M.SQRT, NAN, 0, 0, 0),
        (M.INVERSE_SQRT, 4, 0, 0, 0.5),
        (M.INVERSE_SQRT, 0, 0, 0, 0),
        (M.SIGN, -0.0, 0, 0, 0),
        (M.COMPARE, 1, 1.4, 0.5, 1),
        (M.COMPARE, 1, 1, -1, 1),
        (M.COMPARE, 1, 1.4, 0.3, 0),
        (M.ROUND, -0.5, 0, 0, 0),
        (M.TRUNC, -1.7, 0, 0, -1),
        (M.FRACT, -0.25, 0, 0, 0.75),
        (M.MODULO, -5.5, 2, 0, -1.5),
        (M.FLOORED_MODULO, -5.5, 2, 0, 0.5),
        (M.MODULO, 5, 0, 0, 0),
        (M.WRAP, 5.5, 2, -1, 2.5 - 3),
        (M.WRAP, 5, 2, 2, 2),
        (M.SNAP, 1.9, 0.5, 0, 1.5),
        (M.SNAP, 1.9, 0, 0, 0),
        (M.PINGPONG, 3.2, 2, 0, 0.8),
        (M.PINGPONG, 3, 0, 0, 0),
        (M.ARCSINE, 2, 0, 0, math.pi / 2),
        (M.ARCCOSINE, NAN, 0, 0, math.pi),
        (M.ARCTAN2, 0, 0, 0, 0),
        (M.ARCTAN2, 1, -1, 0, 0.75 * math.pi),
        (M.SMOOTH_MIN, 1, 3, 0, 1),
        (M.SMOOTH_MIN, 1, 1, 0.6, 0.9),
        (M.SMOOTH_MAX, 1, 1, 0.6, 1.1),
        (M.DEGREES, math.pi, 0, 0, 180),
        (M.MINIMUM, NAN, 2, 0, 2),
        (M.LESS_THAN, NAN, 2, 0, 0),
        (M.EXPONENT, 200, 0, 0, INF),
    ],
)
def test_numbers_within_and_beyond_domains(operation, a, b, c, expected):
    assert one("math", (operation, 0), a, b, c)[0] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_clamped_result_is_within_0_and_1():
    assert [one("math", (M.ADD, 1), x, 0, 0)[0] for x in (-2, 0.25, 7, NAN)] == [0, 0.25, 1, 0]
    assert [one("clamp", (0,), x, 2, -1)[0] for x in (-5, 0, 5)] == [-1, -1, -1]
    assert [one("clamp", (1,), x, 2, -1)[0] for x in (-5, 0, 5)] == [-1, 0, 2]


@pytest.mark.parametrize(
    "operation, a, b, c, scale, expected",
    [
        (V.DIVIDE, (1, 2, 3), (2, 0, -1), (0, 0, 0), 0, (0.5, 0, -3)),
        (V.NORMALIZE, (0, 0, 0), (0, 0, 0), (0, 0, 0), 0, (0, 0, 0)),
        (V.PROJECT, (1, 2, 3), (0, 0, 0), (0, 0, 0), 0, (0, 0, 0)),
        (V.PROJECT, (1, 2, 3), (0, 2, 0), (0, 0, 0), 0, (0, 2, 0)),
        (V.REFLECT, (1, -1, 0), (0, 5, 0), (0, 0, 0), 0, (1, 1, 0)),
        (V.REFRACT, (1, 0, 0), (0, 1, 0), (0, 0, 0), 1.5, (0, 0, 0)),
        (V.REFRACT, (0, -1, 0), (0, 2, 0), (0, 0, 0), 0.7, (0, -1, 0)),
        (V.FACEFORWARD, (1, 2, 3), (0, 0, 1), (0, 0, 1), 0, (-1, -2, -3)),
        (V.MODULO, (-5.5, 5.5, 1), (2, -2, 0), (0, 0, 0), 0, (-1.5, 1.5, 0)),
        (V.WRAP, (5.5, 1, 3), (2, 1, 4), (-1, 1, 0), 0, (-0.5, 1, 3)),
        (V.SNAP, (1.9, -0.2, 1), (0.5, 0.5, 0), (0, 0, 0), 0, (1.5, -0.5, 0)),
        (V.POWER, (-2, -2, 0), (3, 0.5, 0), (0, 0, 0), 0, (-8, 0, 1)),
        (V.CROSS_PRODUCT, (1, 0, 0), (0, 1, 0), (0, 0, 0), 0, (0, 0, 1)),
        (V.SIGN, (-3, 0, 2), (0, 0, 0), (0, 0, 0), 0, (-1, 0, 1)),
        (V.LENGTH, (3, 4, 0), (0, 0, 0), (0, 0, 0), 0, (0, 0, 0, 5)),
        (V.DISTANCE, (3, 4, 1), (0, 0, 1), (0, 0, 0), 0, (0, 0, 0, 5)),
    ],
)
def test_vectors_within_and_beyond_domains(operation, a, b, c, scale, expected):
    assert one("vector_math", (operation,), a, b, c, scale)[: len(expected)] == pytest.approx(
        expected, rel=1e-6, abs=1e-6
    )


@pytest.mark.parametrize("model", [ColorModel.HSV, ColorModel.HSL])
def test_colors_come_back_from_other_models(model):
    colors = RNG.uniform(0, 1, (100, 3)).astype(np.float32)
    assert on_host("combine_color", (model,), on_host("separate_color", (model,), colors)) == pytest.approx(
        colors, abs=2e-6
    )
    assert one("separate_color", (model,), (0, 0, 0)) == pytest.approx((0, 0, 0))


def test_blend_modes_at_their_corners():
    def mixed(mode, a, b, t=1.0):
        return one("mix_color", (mode, 1, 0), t, (a,) * 3, (b,) * 3)[0]

    assert (
        mixed(BlendMode.BURN, 0.5, 0) == 0 and mixed(BlendMode.DODGE, 0.5, 1) == 1 and mixed(BlendMode.DODGE, 0, 1) == 0
    )
    assert mixed(BlendMode.DIVIDE, 0.5, 0) == 0.5 and mixed(BlendMode.DIVIDE, 0.5, 2) == 0.25
    assert mixed(BlendMode.SCREEN, 0.5, 0.5) == 0.75 and mixed(BlendMode.EXCLUSION, 2, 2) == 0
    assert mixed(BlendMode.LINEAR_LIGHT, 0.25, 1) == 1.25
    assert mixed(BlendMode.MIX, 0, 1, 7) == 1
    assert one("mix_color", (BlendMode.HUE, 1, 0), 1, (0.25, 0.5, 0.75), (0.3, 0.3, 0.3)) == pytest.approx(
        (0.25, 0.5, 0.75)
    )
    assert one("mix_color", (BlendMode.COLOR, 1, 0), 1, (0.2, 0.2, 0.8), (0.5, 0.25, 0.25)) == pytest.approx(
        (0.8, 0.4, 0.4)
    )


@pytest.mark.parametrize(
    "interpolation, clamp, x, expected",
    [
        (RangeInterpolation.LINEAR, 0, 3, 5),
        (RangeInterpolation.LINEAR, 1, 3, 4),
        (RangeInterpolation.STEPPED, 0, 1.1, 3),
        (RangeInterpolation.SMOOTHSTEP, 0, 1, 3),
        (RangeInterpolation.SMOOTHSTEP, 0, 5, 4),
        (RangeInterpolation.SMOOTHERSTEP, 0, -5, 2),
    ],
)
def test_ranges(interpolation, clamp, x, expected):
    assert one("map_range", (interpolation, clamp), x, 0, 2, 2, 4, 2)[0] == pytest.approx(expected)
    assert one("map_range", (interpolation, clamp), x, 1, 1, 2, 4, 2)[0] == (2 if clamp else 0)
    assert one("map_range_vector", (interpolation, clamp), *((each,) * 3 for each in (x, 0, 2, 2, 4, 2)))[
        2
    ] == pytest.approx(expected)


def test_tables_go_on_or_end():
    line = np.linspace(1, 3, CURVE_SIZE)
    for x, straight, ended in ((-1, -1, 1), (0.25, 1.5, 1.5), (2, 5, 3), (NAN, None, None)):
        if straight is not None:
            assert one("float_curve", (1,), 1, x, 0, 1, table=line)[0] == pytest.approx(straight, abs=1e-4)
            assert one("float_curve", (0,), 1, x, 0, 1, table=line)[0] == pytest.approx(ended, abs=1e-5)
    ramp = np.repeat(np.arange(RAMP_SIZE), 4)
    assert one("color_ramp", (1,), 0.5 + 0.25 / 256, table=ramp) == pytest.approx((128.25,) * 4)
    assert one("color_ramp", (0,), 0.5 + 0.75 / 256, table=ramp) == pytest.approx((128,) * 4)
    assert one("color_ramp", (1,), NAN, table=ramp) == pytest.approx((0,) * 4)
    assert one("color_ramp", (1,), INF, table=ramp) == pytest.approx((256,) * 4)


def test_spectra():
    white = one("blackbody", (), 6504, table=blackbody_table())
    assert white == pytest.approx((1.0, 1.0, 1.0), abs=0.05)
    temperatures = np.linspace(700, 13000, 400, dtype=np.float32)[:, None]
    colors = on_host("blackbody", (), temperatures, blackbody_table())
    # the pieces of the fit meet, all of luminance 1
    assert np.abs(np.diff(colors, axis=0)).max() < 0.15 and colors.min() >= 0
    assert colors[temperatures[:, 0] > 2000] @ (0.2126, 0.7152, 0.0722) == pytest.approx(1, abs=0.01)
    hidden = on_host("wavelength", (), np.array([[300], [374], [781], [NAN], [INF]], np.float32), wavelength_table())
    assert (hidden == 0).all()
    red, green, blue = on_host("wavelength", (), np.array([[650], [530], [450]], np.float32), wavelength_table())
    assert red.argmax() == 0 and green.argmax() == 1 and blue.argmax() == 2


def test_texture_mapping_undoes_point_mapping():
    how = (0.3, -1.0, 2.0), (0.4, 1.1, -0.7), (1.5, -0.5, 2.0)
    rows = np.concatenate([POINTS, np.tile(np.concatenate(how).astype(np.float32), (len(POINTS), 1))], 1)
    there = on_host("mapping", (MappingKind.POINT,), rows)
    assert on_host("mapping", (MappingKind.TEXTURE,), np.concatenate([there, rows[:, 3:]], 1)) == pytest.approx(
        POINTS, abs=1e-5
    )
    assert one("mapping", (MappingKind.TEXTURE,), (1, 2, 3), (0, 0, 0), (0, 0, 0), (1, 0, 2)) == pytest.approx(
        (1, 0, 1.5)
    )
    assert one("mapping", (MappingKind.NORMAL,), (0, 0, 0), (0, 0, 0), (1, 0, 0), (1, 1, 1)) == pytest.approx((0, 0, 0))


@pytest.mark.parametrize("kind", RotationKind)
def test_a_rotation_and_its_inverse(kind):
    how = np.array([0.2, -0.1, 0.4, 0.3, -1.0, 0.5, 0.9, 0.3, 1.2, -0.8], np.float32)
    rows = np.concatenate([POINTS, np.tile(how, (len(POINTS), 1))], 1)
    there = on_host("vector_rotate", (kind, 0), rows)
    assert np.linalg.norm(there - how[:3], axis=1) == pytest.approx(np.linalg.norm(POINTS - how[:3], axis=1), abs=1e-5)
    assert on_host("vector_rotate", (kind, 1), np.concatenate([there, rows[:, 3:]], 1)) == pytest.approx(
        POINTS, abs=1e-5
    )


def test_an_axis_without_length_turns_nothing():
    assert one(
        "vector_rotate", (RotationKind.AXIS_ANGLE, 0), (1, 2, 3), (1, 1, 1), (0, 0, 0), 1, (0, 0, 0)
    ) == pytest.approx((1, 2, 3))


def test_falloff_of_light():
    assert one("light_falloff", (), 2, 0, point=SimpleNamespace(ray_length=3.0)) == pytest.approx((2, 6, 18))
    assert one("light_falloff", (), 2, 1, point=SimpleNamespace(ray_length=3.0)) == pytest.approx((1.8, 5.4, 16.2))
    assert one(
        "light_falloff", (), 2, 1, point=SimpleNamespace(ray_length=float(np.finfo(np.float32).max))
    ) == pytest.approx((2, 2, 2))
    assert one("light_falloff", (), 2, 1, point=SimpleNamespace(ray_length=INF)) == pytest.approx((2, 2, 2))


def affine(matrix):
    return mat34(*np.asarray(matrix, np.float64)[:3].ravel().tolist())


@pytest.mark.parametrize("kind", VectorKind)
def test_vectors_from_space_to_space_and_back(kind):
    to_world, turned = np.eye(4), np.eye(4)
    to_world[:3] = [[1.2, 0.3, 0, 2], [-0.3, 0.8, 0.1, -1], [0, 0, 2, 0.5]]
    c, s = math.cos(0.7), math.sin(0.7)
    turned[:3] = [[c, -s, 0, 1], [0, 0, 1, 3], [-s, -c, 0, 2]]
    inputs = SimpleNamespace(
        to_world=[affine(to_world)], to_object=[affine(np.linalg.inv(to_world))], to_camera=affine(turned)
    )
    normal = np.linalg.inv(to_world[:3, :3]).T @ POINTS.T
    expected = {
        VectorKind.POINT: (np.c_[POINTS, np.ones(len(POINTS))] @ to_world.T)[:, :3],
        VectorKind.VECTOR: POINTS @ to_world[:3, :3].T,
        VectorKind.NORMAL: (normal / np.linalg.norm(normal, axis=0)).T,
    }[kind]
    met, missed = SimpleNamespace(instance=0, primitive=-1), SimpleNamespace(instance=-1, primitive=-1)

    def moved(source, target, points, point=met):
        return on_host("vector_transform", (kind, source, target), points, inputs=inputs, point=point)

    assert moved(Space.OBJECT, Space.WORLD, POINTS) == pytest.approx(expected, abs=1e-5)
    start = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True) if kind == VectorKind.NORMAL else POINTS
    for source in Space:
        for target in Space:
            assert moved(target, source, moved(source, target, start)) == pytest.approx(start, abs=2e-5)
    through = moved(Space.WORLD, Space.CAMERA, moved(Space.OBJECT, Space.WORLD, start))
    assert moved(Space.OBJECT, Space.CAMERA, start) == pytest.approx(through, abs=1e-5)
    assert (moved(Space.OBJECT, Space.WORLD, start, missed) == start).all()


def test_radial_tiles_of_a_square():
    def tile(x, y, roundness=0.0, normalize=0, sides=4):
        return one("radial_tiling", (normalize,), (x, y, 0), sides, roundness)

    half = math.sqrt(0.5)
    # the middle of the first side; a point next to it; the corner
    assert tile(half, half) == pytest.approx((0, 0, 0, 0, 1, math.pi / 4), abs=1e-6)
    assert tile(0.9 * half, 1.1 * half) == pytest.approx((0.1, 0, 0, 0, 1, math.pi / 4), abs=1e-6)
    assert tile(1.2 * half, 0.8 * half, normalize=1)[:2] == pytest.approx((0.4, 1), abs=1e-6)
    assert tile(-0.3, -0.4)[3] == 2
    assert tile(0, 0, normalize=1)[:2] == pytest.approx((0.5, 0))
    # fully rounded, the polygon is a circle
    assert tile(0.6, 0.8, 1.0)[:2] == pytest.approx((math.atan2(0.8, 0.6) - math.pi / 4, 0), abs=1e-6)
