"""Ops of utility nodes give the same folded on the host as on the device.

Operands are ordinary numbers, and numbers at the edges of every domain.
"""

import itertools
import math

import numpy as np
import pytest

from raybatch_addon.core.programs.op import op_named
from raybatch_addon.core.programs.ops.values.color import ColorModel
from raybatch_addon.core.programs.ops.values.curves import CURVE_SIZE
from raybatch_addon.core.programs.ops.values.map_range import RangeInterpolation
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.programs.ops.values.mixing import BlendMode
from raybatch_addon.core.programs.ops.values.ramp import RAMP_SIZE
from raybatch_addon.core.programs.ops.values.rotate import MappingKind, RotationKind
from raybatch_addon.core.programs.ops.values.spectrum import blackbody_table, wavelength_table
from raybatch_addon.core.programs.ops.values.vector_math import VectorOperation
from tests.core.programs.utility_probe import on_device, on_host

EDGES = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.0, 3.0, 1e-20, -1e-20, 1e7, -1e7]
NOT_NUMBERS = [float("nan"), float("inf"), float("-inf"), 3e38, -3e38]
FLAGS = (0, 1)
CASES = [
    *(("math", (each, 0)) for each in MathOperation),
    ("math", (MathOperation.TANGENT, 1)),
    *(("clamp", (flag,)) for flag in FLAGS),
    *(("vector_math", (each,)) for each in VectorOperation),
    *(("mix_float", (flag,)) for flag in FLAGS),
    *(("mix_vector", (flag,)) for flag in FLAGS),
    *(("mix_color", (each, flag, 1 - flag)) for each, flag in itertools.product(BlendMode, FLAGS)),
    *(("combine_color", (each,)) for each in ColorModel),
    *(("separate_color", (each,)) for each in ColorModel),
    ("combine_xyz", ()),
    ("separate_xyz", ()),
    ("hue_saturation", ()),
    ("bright_contrast", ()),
    ("gamma", ()),
    ("invert", ()),
    *(("map_range", (each, flag)) for each, flag in itertools.product(RangeInterpolation, FLAGS)),
    *(("map_range_vector", (each, flag)) for each, flag in itertools.product(RangeInterpolation, FLAGS)),
    *(("mapping", (each,)) for each in MappingKind),
    *(("vector_rotate", (each, flag)) for each, flag in itertools.product(RotationKind, FLAGS)),
    ("normal", ()),
    *(("radial_tiling", (flag,)) for flag in FLAGS),
    *(("color_ramp", (flag,)) for flag in FLAGS),
    *(("curves", (flag,)) for flag in FLAGS),
    *(("float_curve", (flag,)) for flag in FLAGS),
    ("wavelength", ()),
    ("blackbody", ()),
]
# steps: rounding of the operands decides on which side of a step a number falls
STEPS = {
    ("math", each)
    for each in (
        MathOperation.FLOOR,
        MathOperation.CEIL,
        MathOperation.ROUND,
        MathOperation.FRACT,
        MathOperation.SNAP,
        MathOperation.WRAP,
        MathOperation.MODULO,
        MathOperation.FLOORED_MODULO,
        MathOperation.PINGPONG,
    )
}

# sometimes beyond float32: infinite, but never NaN
OVERFLOWING = ("POWER", "EXPONENT", "SINH", "COSH", "STEPPED", "gamma")


def width_of(name: str) -> int:
    return sum({"n": 1, "v": 3}.get(letter, 0) for letter in op_named(name).inputs)


def table_of(name: str) -> list[float]:
    rng = np.random.default_rng(7)
    sizes = {"color_ramp": 4 * RAMP_SIZE, "curves": 3 * CURVE_SIZE, "float_curve": CURVE_SIZE}
    if name in sizes:
        return (np.linspace(-1, 2, sizes[name]) + rng.uniform(-0.01, 0.01, sizes[name])).tolist()
    return {"wavelength": wavelength_table, "blackbody": blackbody_table}.get(name, list)()


def values_of(name: str, count: int, choices: list[float] | None = None) -> np.ndarray:
    rng = np.random.default_rng(11)
    values = rng.choice(choices, (count, width_of(name))) if choices else rng.uniform(-2, 3, (count, width_of(name)))
    if "curve" in name:
        values[:, -2:] = -0.5, 1.5  # begin and end of the curves
    if name == "radial_tiling" and not choices:
        values[:, 3:] = np.stack([np.abs(values[:, 3]) * 3 + 2.5, np.abs(values[:, 4]) * 0.5], 1)
    if name == "wavelength":
        values = values * 100 + 500
    if name == "blackbody":
        values = values * 4000 + 4000
    return np.clip(values, -3.4e38, 3.4e38).astype(np.float32)


def name_of_case(case) -> str:
    return "-".join([case[0], *(getattr(each, "name", str(each)) for each in case[1])])


@pytest.mark.parametrize("case", CASES, ids=name_of_case)
def test_folded_on_the_host_as_on_the_device(case):
    name, immediates = case
    values, table = values_of(name, 200), table_of(name)
    there, here = on_device(name, immediates, values, table), on_host(name, immediates, values, table)
    apart = np.abs(there - here) / np.maximum(1, np.abs(here))
    steps = (name, immediates[0]) in STEPS if immediates else False
    # steps and hues may be approached from either side, in very few cases; nothing else may differ
    assert np.isfinite(here).all()
    assert np.quantile(apart, 0.99) <= 2e-6
    assert steps or apart.max() <= 2e-4, values[apart.max(1).argmax()]


@pytest.mark.parametrize("case", CASES, ids=name_of_case)
def test_edges_of_domains_give_finite_numbers(case):
    name, immediates = case
    values, table = values_of(name, 400, EDGES), table_of(name)
    there, here = on_device(name, immediates, values, table), on_host(name, immediates, values, table)
    if name in OVERFLOWING or (immediates and getattr(immediates[0], "name", "") in OVERFLOWING):
        assert not np.isnan(there).any() and not np.isnan(here).any()
        return
    assert np.isfinite(there).all(), values[~np.isfinite(there).all(-1)][:3]
    assert np.isfinite(here).all()


@pytest.mark.parametrize("case", CASES, ids=name_of_case)
def test_numbers_that_are_none_harm_nobody(case):
    name, immediates = case
    values = values_of(name, 100, EDGES[:6] + NOT_NUMBERS)
    width = sum({"N": 1, "V": 3}[letter] for letter in op_named(name).outputs)
    assert on_device(name, immediates, values, table_of(name)).shape == (100, width)


@pytest.mark.parametrize("sides", [2.3, 3.0, 3.6, 5.7, 8.0])
@pytest.mark.parametrize("roundness", [0.0, 0.3, 1.0])
def test_radial_tiles_meet_where_segments_do(sides, roundness):
    angles = np.linspace(0, 2 * math.pi, 2000)[1:-1]
    rows = np.stack([np.cos(angles), np.sin(angles), 0 * angles, 0 * angles + sides, 0 * angles + roundness], 1).astype(
        np.float32
    )
    found = on_device("radial_tiling", (1,), rows)
    assert np.isfinite(found).all()
    assert np.abs(np.diff(found[:, 1])).max() < 0.02  # the coordinate out is continuous, all around
    if sides >= 3:  # with fewer sides corners take more than the sides have
        assert found[:, 0].min() > -1e-3 and found[:, 0].max() < 1 + 1e-3
