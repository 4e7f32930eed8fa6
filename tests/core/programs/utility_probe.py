"""Runs of utility ops at many points, on the device and folded on the host."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs import ops  # noqa: F401  (registers the ops)
from raybatch_addon.core.programs.op import NodeData, as_python, op_named, op_numbers
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.programs.run import END, LENGTH_SHIFT, make_run
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.shading.bsdf.materials import ClosureRecord
from tests.support.under_test import DEVICE

OPS = (
    "blackbody",
    "bright_contrast",
    "clamp",
    "color_ramp",
    "combine_color",
    "combine_xyz",
    "curves",
    "float_curve",
    "gamma",
    "hue_saturation",
    "invert",
    "light_falloff",
    "map_range",
    "map_range_vector",
    "mapping",
    "math",
    "mix_color",
    "mix_float",
    "mix_vector",
    "normal",
    "radial_tiling",
    "separate_color",
    "separate_xyz",
    "vector_math",
    "vector_rotate",
    "wavelength",
)
REGISTERS = 32


@functools.cache
def _kernel():
    run = make_run(ProgramFeatures(OPS, REGISTERS, 1))

    @wp.kernel(**KERNEL_OPTIONS)
    def probe(data: NodeData, length: float, values: wp.array2d(dtype=float), out: wp.array2d(dtype=float)):
        i = wp.tid()
        stack = wp.zeros(wp.static(REGISTERS), dtype=float)
        closures = wp.zeros(1, dtype=ClosureRecord)
        for k in range(values.shape[1]):
            stack[k] = values[i, k]
        point = ShadingPoint()
        point.ray_length = length
        run(data, stack, 0, point, closures)
        for k in range(out.shape[1]):
            out[i, k] = stack[values.shape[1] + k]

    return probe


def _layout(name: str, immediates: Sequence[int]) -> tuple[list[int], int, int]:
    """Words of an instruction that reads the first registers and writes the next; floats read, and written."""
    op = op_named(name)
    words, at, left = [], 0, list(immediates)
    for letter in op.inputs:
        if letter in "nv":
            words.append(at)
            at += 3 if letter == "v" else 1
        else:
            words.append(0 if letter == "t" else left.pop(0))
    assert not left, name
    read = at
    for letter in op.outputs:
        words.append(at)
        at += 3 if letter == "V" else 1
    return words, read, at - read


def points_of(operands: Sequence) -> np.ndarray:
    """Operands ([n] or [n, 3] each) as one array, float32, shape [n, width]."""
    return np.ascontiguousarray(
        np.concatenate([np.asarray(each, np.float32).reshape(len(each), -1) for each in operands], 1)
    )


def on_device(
    name: str, immediates: Sequence[int], values: np.ndarray, table: Sequence[float] = (), length: float = 0.0
) -> np.ndarray:
    """Results of the op for `values` [n, width], its number and vector operands side by side: [n, width of outputs]."""
    words, read, written = _layout(name, immediates)
    assert values.shape[1] == read, name
    data = NodeData()
    data.code = wp.array([op_numbers()[name] | (len(words) + 1) << LENGTH_SHIFT, *words, END], dtype=int, device=DEVICE)
    data.constants = wp.array(np.asarray(table, np.float32), dtype=float, device=DEVICE)
    out = wp.zeros((len(values), written), dtype=float, device=DEVICE)
    wp.launch(_kernel(), len(values), [data, length, wp.array(values, dtype=float, device=DEVICE), out], device=DEVICE)
    return out.numpy()


def on_host(
    name: str, immediates: Sequence[int], values: np.ndarray, table: Sequence[float] = (), inputs=None, point=None
) -> np.ndarray:
    """The same results, folded on the host.

    `inputs` and `point` hold the scene's data for ops that are not folded.
    """
    words, read, written = _layout(name, immediates)
    function = as_python(op_named(name).function)
    constants = [float(np.float32(x)) for x in table]
    rows = []
    for row in values:
        stack = [float(x) for x in row] + [0.0] * written
        function(SimpleNamespace(code=[0, *words], constants=constants, inputs=inputs), stack, 0, point)
        rows.append(stack[read:])
    with np.errstate(over="ignore"):
        return np.array(rows, np.float64).astype(np.float32)
