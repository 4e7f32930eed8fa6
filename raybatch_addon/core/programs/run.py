"""The interpreter: runs programs with the ops that a scene needs, and no others."""

import functools
from collections.abc import Callable
from types import SimpleNamespace

import warp as wp

from ..device.codegen.local_arrays import Unset
from ..scene.program import ProgramFeatures
from ..shading.bsdf.materials import ClosureRecord, address_of
from .op import NodeData, op_named, op_numbers
from .point import ShadingPoint

END = 0
# The low bits of an instruction are the op, the bits above count its words
LENGTH_SHIFT = 16
_POINT_FLOATS = ShadingPoint.numpy_dtype()["itemsize"] // 4


@functools.cache
def make_run(features: ProgramFeatures) -> wp.Function:
    """Function (data, stack, first: int, point, closures) -> int that runs the program at word `first`.

    It returns how many closures the program made. `stack` is a local array of `register_count` floats, `closures` one
    of `closure_count` records. Where `features.apart`, `data` has to be stored (`store_programs`).
    """
    interpret = _make_interpreter(features.ops, features.apart)

    def run(
        data: NodeData,
        stack: wp.array(dtype=float),
        first: int,
        point: ShadingPoint,
        closures: wp.array(dtype=ClosureRecord),
    ) -> int:
        return interpret(data.code, data, stack, first, point, closures)

    def run_stored(
        data: NodeData,
        stack: wp.array(dtype=float),
        first: int,
        point: ShadingPoint,
        closures: wp.array(dtype=ClosureRecord),
    ) -> int:
        floats = wp.zeros(wp.static(_POINT_FLOATS), dtype=Unset)
        points = wp.array(ptr=address_of(floats), shape=(1,), dtype=ShadingPoint)
        points[0] = point
        stored = wp.array(ptr=data.stored, shape=(1,), dtype=NodeData)
        return interpret(data.code, stored, stack, first, points, closures)

    return wp.func(run_stored if features.apart else run)


# How ops are passed `data` and `point`. Inlined, as in kernels that are specialised on a scene: by value. Where the
# interpreter holds all ops, each is a function of its own, since a compiler's time grows faster than a function's
# length; and as Warp passes structs by value and a `NodeData` has two kilobytes, it is passed arrays of one struct and
# reads what it needs.
_BY_VALUE = SimpleNamespace(data=NodeData, point=ShadingPoint)
_STORED = SimpleNamespace(data=wp.array(dtype=NodeData), point=wp.array(dtype=ShadingPoint))


@functools.cache
def _make_interpreter(names: tuple[str, ...], apart: bool) -> wp.Function:
    """Function (code, data, stack, first: int, point, closures) -> int, with the ops called `names`: the same one for
    all that run these, so that a kernel of several stages has its code once.
    """
    numbers, types = op_numbers(), _STORED if apart else _BY_VALUE
    ops = [(numbers[name], op_named(name)) for name in sorted(names, key=numbers.__getitem__)]
    values = [(number, op.function) for number, op in ops if not op.makes_closures]
    makers = [(number, op.function) for number, op in ops if op.makes_closures]
    if apart:
        values = [(number, _value_apart(number, function)) for number, function in values]
        makers = [(number, _closure_apart(number, function)) for number, function in makers]
    compute, make = _value_tree(values, types), _closure_tree(makers, types)

    @wp.func(inline=False if apart else None)
    def interpret(
        code: wp.array(dtype=int),
        data: types.data,
        stack: wp.array(dtype=float),
        first: int,
        point: types.point,
        closures: wp.array(dtype=ClosureRecord),
    ) -> int:
        count = int(0)
        pc = int(first)
        while True:
            word = code[pc]
            op = word & wp.static((1 << LENGTH_SHIFT) - 1)
            if op == wp.static(END):
                break
            compute(op, data, stack, pc, point)
            count = make(op, data, stack, pc, point, closures, count)
            pc += word >> wp.static(LENGTH_SHIFT)
        return count

    return interpret


def _value_apart(number: int, function: wp.Function) -> wp.Function:
    """An op that computes values as a function out of line."""

    def apart(data: _STORED.data, stack: wp.array(dtype=float), pc: int, point: _STORED.point):
        function(data[0], stack, pc, point[0])

    return _named(apart, "apart", [(number, function)], inline=False)


def _closure_apart(number: int, function: wp.Function) -> wp.Function:
    """An op that makes closures as a function out of line."""

    def apart(
        data: _STORED.data,
        stack: wp.array(dtype=float),
        pc: int,
        point: _STORED.point,
        closures: wp.array(dtype=ClosureRecord),
        count: int,
    ) -> int:
        return function(data[0], stack, pc, point[0], closures, count)

    return _named(apart, "closure_apart", [(number, function)], inline=False)


# Functions form a tree whose leaves are ops. Each refers to the next by name, so that Warp sees all of them when it
# hashes a kernel. It does not see what `wp.static` picks from a list in a loop: kernels with other ops, or with ops
# that were changed, would be taken for the same. A tree, because Warp generates the code of a function within that of
# its caller: a chain of all ops is too deep for Python.
def _value_tree(ops: list[tuple[int, wp.Function]], types: SimpleNamespace) -> wp.Function:
    if not ops:

        def nothing(op: int, data: types.data, stack: wp.array(dtype=float), pc: int, point: types.point):
            pass

        return _named(nothing, "no_value", [(END, None)])
    number, function = ops[0]

    def leaf(op: int, data: types.data, stack: wp.array(dtype=float), pc: int, point: types.point):
        if op == wp.static(number):
            function(data, stack, pc, point)

    if len(ops) == 1:
        return _named(leaf, "value", ops)
    half = len(ops) // 2
    middle, before, after = ops[half][0], _value_tree(ops[:half], types), _value_tree(ops[half:], types)

    def branch(op: int, data: types.data, stack: wp.array(dtype=float), pc: int, point: types.point):
        if op < wp.static(middle):
            before(op, data, stack, pc, point)
        else:
            after(op, data, stack, pc, point)

    return _named(branch, "values", ops)


def _closure_tree(ops: list[tuple[int, wp.Function]], types: SimpleNamespace) -> wp.Function:
    if not ops:

        def nothing(
            op: int,
            data: types.data,
            stack: wp.array(dtype=float),
            pc: int,
            point: types.point,
            closures: wp.array(dtype=ClosureRecord),
            count: int,
        ) -> int:
            return count

        return _named(nothing, "no_closure", [(END, None)])
    number, function = ops[0]

    def leaf(
        op: int,
        data: types.data,
        stack: wp.array(dtype=float),
        pc: int,
        point: types.point,
        closures: wp.array(dtype=ClosureRecord),
        count: int,
    ) -> int:
        if op == wp.static(number):
            return function(data, stack, pc, point, closures, count)
        return count

    if len(ops) == 1:
        return _named(leaf, "closure", ops)
    half = len(ops) // 2
    middle, before, after = ops[half][0], _closure_tree(ops[:half], types), _closure_tree(ops[half:], types)

    def branch(
        op: int,
        data: types.data,
        stack: wp.array(dtype=float),
        pc: int,
        point: types.point,
        closures: wp.array(dtype=ClosureRecord),
        count: int,
    ) -> int:
        if op < wp.static(middle):
            return before(op, data, stack, pc, point, closures, count)
        return after(op, data, stack, pc, point, closures, count)

    return _named(branch, "closures", ops)


def _named(body: Callable, kind: str, ops: list[tuple], inline: bool | None = None) -> wp.Function:
    """`body` as a Warp function with a name of its own: Warp takes functions of one name for the same."""
    body.__name__ = f"{kind}_{ops[0][0]}_to_{ops[-1][0]}"
    body.__qualname__ = f"make_run.{body.__name__}"
    return wp.func(body, inline=inline)
