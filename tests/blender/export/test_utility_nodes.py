"""Utility nodes against Cycles, number by number at 1,024 points.

Operands are ordinary numbers, and numbers at the edges of every domain.
"""

import itertools

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.programs.ops.values.color import ColorModel
from raybatch_addon.core.programs.ops.values.map_range import RangeInterpolation
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.programs.ops.values.mixing import BlendMode
from raybatch_addon.core.programs.ops.values.rotate import MappingKind, RotationKind
from raybatch_addon.core.programs.ops.values.spectrum import blackbody_table, wavelength_table
from raybatch_addon.core.programs.ops.values.vector_math import VectorOperation
from tests.blender.features.sheet import TOLERANCE
from tests.core.programs.utility_probe import on_device, points_of
from tests.support.cycles_points import COUNT

EDGES = [0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.0, 3.0, 0.25, -7.5]
LARGEST = 1e30  # beyond it pictures lose Cycles' values


def drawn(seed: int, width: int = 1) -> np.ndarray:
    """Random operands, half of them edges and half in between: [COUNT] or [COUNT, width]."""
    rng = np.random.default_rng(seed)
    edges, between = rng.choice(EDGES, (COUNT // 2, width)), rng.uniform(-2, 3, (COUNT - COUNT // 2, width))
    values = rng.permutation(np.concatenate([edges, between])).astype(np.float32)
    return values if width > 1 else values[:, 0]


def apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The largest difference, relative above 1, of two arrays."""
    usable = (np.abs(ours) < LARGEST) & (np.abs(theirs) < LARGEST)
    assert usable.mean() > 0.5
    return float(np.max(np.where(usable, np.abs(ours - theirs) / np.maximum(1, np.abs(theirs)), 0)))


def check(cycles, kind, op, immediates, inputs, output, at, table=(), **properties):
    """Compare the op with the node.

    `inputs` are by identifier, in the order of the op's operands; the output is the number or vector `at` (slice) of
    the op's outputs.
    """
    theirs = cycles.values(kind, inputs, output, **properties)
    operands = points_of([np.broadcast_to(each, (COUNT, *np.shape(each)[1:])) for each in inputs.values()])
    ours = on_device(op, immediates, operands, table)[:, at]
    error = apart(ours, theirs)
    assert error <= TOLERANCE, f"{op} {properties}: {error:.3g}"


@pytest.mark.parametrize("operation", MathOperation)
def test_math(cycles, operation):
    inputs = {"Value": drawn(1), "Value_001": drawn(2), "Value_002": drawn(3)}
    check(cycles, "ShaderNodeMath", "math", (operation, 0), inputs, "Value", slice(0, 1), operation=operation.name)


@pytest.mark.parametrize("operation", VectorOperation)
def test_vector_math(cycles, operation):
    inputs = {"Vector": drawn(1, 3), "Vector_001": drawn(2, 3), "Vector_002": drawn(3, 3), "Scale": drawn(4)}
    output, at = ("Value", slice(3, 4)) if operation >= VectorOperation.DOT_PRODUCT else ("Vector", slice(0, 3))
    check(cycles, "ShaderNodeVectorMath", "vector_math", (operation,), inputs, output, at, operation=operation.name)


@pytest.mark.parametrize("mode", BlendMode)
@pytest.mark.parametrize("clamp", [False, True])
def test_mixes_of_colors(cycles, mode, clamp):
    inputs = {"Factor_Float": drawn(1), "A_Color": drawn(2, 3), "B_Color": drawn(3, 3)}
    properties = {"data_type": "RGBA", "blend_type": mode.name, "clamp_factor": clamp, "clamp_result": clamp}
    check(cycles, "ShaderNodeMix", "mix_color", (mode, clamp, clamp), inputs, "Result_Color", slice(0, 3), **properties)


@pytest.mark.parametrize("interpolation, clamp", list(itertools.product(RangeInterpolation, [False, True])))
def test_map_range(cycles, interpolation, clamp):
    names = ("Value", "From Min", "From Max", "To Min", "To Max", "Steps")
    how = {"interpolation_type": interpolation.name, "clamp": clamp}
    inputs = {name: drawn(i) for i, name in enumerate(names)}
    check(cycles, "ShaderNodeMapRange", "map_range", (interpolation, clamp), inputs, "Result", slice(0, 1), **how)
    names = ("Vector", *(f"{name.replace(' ', '_')}_FLOAT3" for name in names[1:]))
    inputs = {name: drawn(i, 3) for i, name in enumerate(names)}
    how["data_type"] = "FLOAT_VECTOR"
    check(
        cycles, "ShaderNodeMapRange", "map_range_vector", (interpolation, clamp), inputs, "Vector", slice(0, 3), **how
    )


@pytest.mark.parametrize("ordered", [False, True])
def test_clamp(cycles, ordered):
    inputs = {"Value": drawn(1), "Min": drawn(2), "Max": drawn(3)}
    check(
        cycles,
        "ShaderNodeClamp",
        "clamp",
        (ordered,),
        inputs,
        "Result",
        slice(0, 1),
        clamp_type="RANGE" if ordered else "MINMAX",
    )


@pytest.mark.parametrize("model", ColorModel)
def test_colors_put_together_and_taken_apart(cycles, model):
    parts = {name: drawn(i) for i, name in enumerate(("Red", "Green", "Blue"))}
    check(cycles, "ShaderNodeCombineColor", "combine_color", (model,), parts, "Color", slice(0, 3), mode=model.name)
    for i, name in enumerate(parts):
        check(
            cycles,
            "ShaderNodeSeparateColor",
            "separate_color",
            (model,),
            {"Color": drawn(5, 3)},
            name,
            slice(i, i + 1),
            mode=model.name,
        )


def test_corrections_of_colors(cycles):
    color = drawn(7, 3)
    hue = {"Hue": drawn(1), "Saturation": drawn(2), "Value": drawn(3), "Fac": drawn(4), "Color": color}
    check(cycles, "ShaderNodeHueSaturation", "hue_saturation", (), hue, "Color", slice(0, 3))
    bright = {"Color": color, "Bright": drawn(1), "Contrast": drawn(2)}
    check(cycles, "ShaderNodeBrightContrast", "bright_contrast", (), bright, "Color", slice(0, 3))
    check(cycles, "ShaderNodeGamma", "gamma", (), {"Color": color, "Gamma": drawn(1) % 8}, "Color", slice(0, 3))
    check(cycles, "ShaderNodeInvert", "invert", (), {"Fac": drawn(1), "Color": color}, "Color", slice(0, 3))


def test_spectra(cycles):
    temperature, wavelength = (
        np.linspace(0, 14000, COUNT, dtype=np.float32),
        np.linspace(300, 850, COUNT, dtype=np.float32),
    )
    check(
        cycles,
        "ShaderNodeBlackbody",
        "blackbody",
        (),
        {"Temperature": temperature},
        "Color",
        slice(0, 3),
        blackbody_table(),
    )
    check(
        cycles,
        "ShaderNodeWavelength",
        "wavelength",
        (),
        {"Wavelength": wavelength},
        "Color",
        slice(0, 3),
        wavelength_table(),
    )


@pytest.mark.parametrize("kind", MappingKind)
def test_mapping(cycles, kind):
    inputs = {"Vector": drawn(1, 3), "Location": drawn(2, 3), "Rotation": drawn(3, 3), "Scale": drawn(4, 3)}
    check(cycles, "ShaderNodeMapping", "mapping", (kind,), inputs, "Vector", slice(0, 3), vector_type=kind.name)


@pytest.mark.parametrize("kind, invert", list(itertools.product(RotationKind, [False, True])))
def test_vector_rotate(cycles, kind, invert):
    inputs = {
        "Vector": drawn(1, 3),
        "Center": drawn(2, 3),
        "Axis": drawn(3, 3),
        "Angle": drawn(4),
        "Rotation": drawn(5, 3),
    }
    how = {"rotation_type": kind.name, "invert": invert}
    check(cycles, "ShaderNodeVectorRotate", "vector_rotate", (kind, invert), inputs, "Vector", slice(0, 3), **how)


@pytest.mark.parametrize("normalize", [False, True])
def test_radial_tiling(cycles, normalize):
    rng = np.random.default_rng(1)
    sides, roundness = (
        rng.choice([1.0, 3.0, 4.0, 2.7, 3.3, 5.5, 8.9], COUNT),
        rng.choice([-0.5, 0.0, 0.3, 0.8, 1.0], COUNT),
    )
    # two sides have no corners: rounded, they are rounding noise
    inputs = {"Vector": rng.uniform(-2, 2, (COUNT, 3)), "Sides": sides, "Roundness": np.where(sides > 2, roundness, 0)}
    inputs = {name: each.astype(np.float32) for name, each in inputs.items()}
    outputs = {
        "Segment Coordinates": slice(0, 3),
        "Segment ID": slice(3, 4),
        "Segment Width": slice(4, 5),
        "Segment Rotation": slice(5, 6),
    }
    for name, at in outputs.items():
        check(cycles, "ShaderNodeRadialTiling", "radial_tiling", (normalize,), inputs, name, at, normalize=normalize)
