"""Run of one op at many points, with operands for each point."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData, op_named
from raybatch_addon.core.programs.point import ShadingPoint
from tests.support.under_test import DEVICE

_REGISTERS = 48


@functools.cache
def _one_of(names: tuple[str, ...]) -> wp.Function:
    """Function (index, data, stack, pc, point): the op of this index among `names`."""
    last, index = op_named(names[-1]).function, len(names) - 1
    if index == 0:

        @wp.func
        def run_only(which: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
            last(data, stack, pc, point)

        return run_only
    before = _one_of(names[:-1])

    @wp.func
    def run_one(which: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        if which == index:
            last(data, stack, pc, point)
        else:
            before(which, data, stack, pc, point)

    return run_one


@functools.cache
def _kernel(names: tuple[str, ...]):
    function = _one_of(names)
    registers = _REGISTERS

    @wp.kernel(**KERNEL_OPTIONS)
    def run(which: int, data: NodeData, values: wp.array2d(dtype=float), out: wp.array2d(dtype=float)):
        i = wp.tid()
        stack = wp.zeros(registers, dtype=float)
        for k in range(values.shape[1]):
            stack[k] = values[i, k]
        function(which, data, stack, 0, ShadingPoint())
        for k in range(out.shape[1]):
            out[i, k] = stack[values.shape[1] + k]

    return run


def run_op(
    name: str, immediates: Sequence[int], operands: Sequence, skip: str = "", device=DEVICE, among: Sequence[str] = ()
) -> tuple[np.ndarray, ...]:
    """Outputs of the op, float32: [n] for a number, [n, 3] for a vector.

    Outputs whose letters are in `skip` are not wanted, and 0. `operands` are the `n` and `v` words in order: arrays
    [n], [n, 3], or values that broadcast to such. `among`: ops that one kernel is compiled for, this one with them.
    """
    signature = op_named(name).signature
    letters = [letter for letter in signature if letter in "nv"]
    shapes = [np.shape(each) for each in operands]
    count = max([1, *(s[0] for s, letter in zip(shapes, letters) if len(s) == (2 if letter == "v" else 1))])
    columns, words, at, left = [], [0], 0, list(immediates)
    filled = [
        np.broadcast_to(np.asarray(each, np.float32), (count, 3) if letter == "v" else (count,))
        for each, letter in zip(operands, letters)
    ]
    assert len(filled) == len(letters) == len(operands)
    remaining = list(filled)
    for letter in signature:
        if letter in "nv":
            columns.append(remaining.pop(0).reshape(count, -1))
        words.append(left.pop(0) if letter == "i" else -1 if letter in skip else at)
        if letter != "i" and letter not in skip:
            at += 3 if letter in "vV" else 1
    values = np.ascontiguousarray(np.concatenate(columns, 1))
    data = NodeData()
    data.code = wp.array(words, dtype=int, device=device)
    out = wp.zeros((count, max(at - values.shape[1], 1)), dtype=float, device=device)
    names = tuple(among) or (name,)
    inputs = [names.index(name), data, wp.array(values, dtype=float, device=device), out]
    wp.launch(_kernel(names), count, inputs, device=device)
    found, results, k = out.numpy(), [], 0
    for letter in signature:
        if letter in "NV":
            width = 3 if letter == "V" else 1
            part = np.zeros((count, width), np.float32) if letter in skip else found[:, k : k + width]
            k += 0 if letter in skip else width
            results.append(part if width == 3 else part[:, 0])
    return tuple(results)
