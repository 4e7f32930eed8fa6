"""The interpreter: runs programs with the ops that a scene needs, and no others."""

import functools
from collections.abc import Callable

import warp as wp

from ...scene.program import ProgramFeatures
from ..materials import ClosureRecord
from .op import NodeData, op_named
from .point import ShadingPoint

# Ops are numbered by their place in `ProgramFeatures.ops`, from this on
FIRST_OP = 1
END = 0
# A word of code is the op, and above that how many words the instruction has
LENGTH_SHIFT = 16


@functools.cache
def make_run(features: ProgramFeatures) -> wp.Function:
    """Function (data, stack, first: int, point, closures) -> int: runs the program at word `first`; how many closures it made.

    `stack` is a local array of `register_count` floats, `closures` one of `closure_count` records.
    """
    number_of = {name: FIRST_OP + i for i, name in enumerate(features.ops)}
    ops = [op_named(name) for name in features.ops]
    compute = _no_value
    make = _no_closure
    for each in ops:
        if each.makes_closures:
            make = _or_closure(number_of[each.name], each.function, make)
        else:
            compute = _or_value(number_of[each.name], each.function, compute)

    @wp.func
    def run(
        data: NodeData, stack: wp.array(dtype=float), first: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord)
    ) -> int:
        count = int(0)
        pc = int(first)
        while True:
            word = data.code[pc]
            op = word & wp.static((1 << LENGTH_SHIFT) - 1)
            if op == wp.static(END):
                break
            compute(op, data, stack, pc, point)
            count = make(op, data, stack, pc, point, closures, count)
            pc += word >> wp.static(LENGTH_SHIFT)
        return count

    return run


@wp.func
def _no_value(op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    pass


@wp.func
def _no_closure(
    op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    return count


# A chain of functions, one an op: each refers to the next by name, so that Warp sees all of them when it hashes a kernel. It does not see what
# `wp.static` picks from a list in a loop: kernels with other ops, or with ops that were changed, would be taken for the same.
def _or_value(number: int, function: wp.Function, others: wp.Function) -> wp.Function:
    def step(op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        if op == wp.static(number):
            function(data, stack, pc, point)
        else:
            others(op, data, stack, pc, point)

    return _named(step, number)


def _or_closure(number: int, function: wp.Function, others: wp.Function) -> wp.Function:
    def step(
        op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
    ) -> int:
        if op == wp.static(number):
            return function(data, stack, pc, point, closures, count)
        return others(op, data, stack, pc, point, closures, count)

    return _named(step, number)


def _named(step: Callable, number: int) -> wp.Function:
    """`step` as a Warp function of a name of its own: those of one name would be taken for each other."""
    step.__name__ = f"step_{number}"
    step.__qualname__ = f"make_run.{step.__name__}"
    return wp.func(step)
