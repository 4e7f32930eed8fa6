"""The interpreter: runs programs with the ops that a scene needs, and no others."""

import functools

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
    ops = [op_named(name) for name in features.ops]
    values = [(FIRST_OP + i, each.function) for i, each in enumerate(ops) if not each.makes_closures]
    makers = [(FIRST_OP + i, each.function) for i, each in enumerate(ops) if each.makes_closures]
    value_count, maker_count = len(values), len(makers)

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
            for i in range(wp.static(value_count)):
                if op == wp.static(values[i][0]):
                    wp.static(values[i][1])(data, stack, pc, point)
            for i in range(wp.static(maker_count)):
                if op == wp.static(makers[i][0]):
                    count = wp.static(makers[i][1])(data, stack, pc, point, closures, count)
            pc += word >> wp.static(LENGTH_SHIFT)
        return count

    return run
