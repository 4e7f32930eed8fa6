"""The interpreter: runs programs with the ops that a scene needs, and no others."""

import functools
from collections.abc import Callable

import warp as wp

from ..scene.program import ProgramFeatures
from ..shading.bsdf.materials import ClosureRecord
from .op import NodeData, op_named, op_numbers
from .point import ShadingPoint

END = 0
# The low bits of an instruction are the op, the bits above count its words
LENGTH_SHIFT = 16


@functools.cache
def make_run(features: ProgramFeatures) -> wp.Function:
    """Function (data, stack, first: int, point, closures) -> int that runs the program at word `first`.

    It returns how many closures the program made. `stack` is a local array of `register_count` floats, `closures` one
    of `closure_count` records.
    """
    numbers = op_numbers()
    ops = [(numbers[name], op_named(name)) for name in sorted(features.ops)]
    compute = _value_tree([(number, op.function) for number, op in ops if not op.makes_closures])
    make = _closure_tree([(number, op.function) for number, op in ops if op.makes_closures])

    @wp.func(inline=False if features.apart else None)
    def run(
        data: NodeData,
        stack: wp.array(dtype=float),
        first: int,
        point: ShadingPoint,
        closures: wp.array(dtype=ClosureRecord),
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
    op: int,
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    return count


# Functions form a tree whose leaves are ops. Each refers to the next by name, so that Warp sees all of them when it
# hashes a kernel. It does not see what `wp.static` picks from a list in a loop: kernels with other ops, or with ops
# that were changed, would be taken for the same. A tree, because Warp generates the code of a function within that of
# its caller: a chain of all ops is too deep for Python.
def _value_tree(ops: list[tuple[int, wp.Function]]) -> wp.Function:
    if not ops:
        return _no_value
    number, function = ops[0]

    def leaf(op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        if op == wp.static(number):
            function(data, stack, pc, point)

    if len(ops) == 1:
        return _named(leaf, "value", ops)
    half = len(ops) // 2
    middle, before, after = ops[half][0], _value_tree(ops[:half]), _value_tree(ops[half:])

    def branch(op: int, data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        if op < wp.static(middle):
            before(op, data, stack, pc, point)
        else:
            after(op, data, stack, pc, point)

    return _named(branch, "values", ops)


def _closure_tree(ops: list[tuple[int, wp.Function]]) -> wp.Function:
    if not ops:
        return _no_closure
    number, function = ops[0]

    def leaf(
        op: int,
        data: NodeData,
        stack: wp.array(dtype=float),
        pc: int,
        point: ShadingPoint,
        closures: wp.array(dtype=ClosureRecord),
        count: int,
    ) -> int:
        if op == wp.static(number):
            return function(data, stack, pc, point, closures, count)
        return count

    if len(ops) == 1:
        return _named(leaf, "closure", ops)
    half = len(ops) // 2
    middle, before, after = ops[half][0], _closure_tree(ops[:half]), _closure_tree(ops[half:])

    def branch(
        op: int,
        data: NodeData,
        stack: wp.array(dtype=float),
        pc: int,
        point: ShadingPoint,
        closures: wp.array(dtype=ClosureRecord),
        count: int,
    ) -> int:
        if op < wp.static(middle):
            return before(op, data, stack, pc, point, closures, count)
        return after(op, data, stack, pc, point, closures, count)

    return _named(branch, "closures", ops)


def _named(body: Callable, kind: str, ops: list[tuple[int, wp.Function]]) -> wp.Function:
    """`body` as a Warp function with a name of its own: Warp takes functions of one name for the same."""
    body.__name__ = f"{kind}_{ops[0][0]}_to_{ops[-1][0]}"
    body.__qualname__ = f"make_run.{body.__name__}"
    return wp.func(body)
