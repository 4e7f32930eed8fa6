"""Ops: the steps of programs, and how they reach their operands.

An op has a name, a signature and a function. Files in `ops/` register theirs with `@op` (writes registers) or
`@closure_op` (adds closures); `run.py` compiles the ops that a scene needs into a kernel. Letters of signatures are
those of `core/scene/program.py`; outputs follow after `>`. An op's docstring lists its operands in the same order.
"""

import functools
import types
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from ..scene.geometry import Geometry
from ..shading.bsdf.albedo import AlbedoTables
from ..shading.images.textures import ImageTable
from .inputs_data import InputData

INPUTS, OUTPUTS = "isnvtma", "NV"


@wp.struct
class NodeData:
    """Programs on the device, with all data that ops read."""

    code: wp.array(dtype=int)  # programs one after the other; an instruction is op + (words << 16), and then its words
    constants: wp.array(dtype=float)
    # begin of each material's program in `code`, -1: it has none; [material_count]. Where materials ask for rays, those
    # of their requests follow; where some let light pass straight on, the parts that make such closures come last
    program_first: wp.array(dtype=int)
    geometry: Geometry
    images: ImageTable
    inputs: InputData
    albedo: AlbedoTables  # albedos for layers; arrays that no program needs are empty
    # address of this struct in the device's memory, where ops of the general tier read it; 0: it is not there
    stored: wp.uint64


@dataclass(frozen=True)
class Op:
    """A registered op."""

    name: str
    signature: str  # without ">"
    function: wp.Function
    closures_most: int  # most closures that it may add; 0: it computes values
    foldable: bool  # it may be run on the host, by `as_python`
    general: bool = True  # the general kernels have it

    @property
    def makes_closures(self) -> bool:
        """Whether the op adds closures instead of writing registers."""
        return self.closures_most > 0

    @property
    def inputs(self) -> str:
        """Letters of the inputs."""
        return "".join(letter for letter in self.signature if letter in INPUTS)

    @property
    def outputs(self) -> str:
        """Letters of the outputs."""
        return "".join(letter for letter in self.signature if letter in OUTPUTS)


_ops: dict[str, Op] = {}


def _register(
    name: str, signature: str, foldable: bool, closures_most: int, general: bool = True
) -> Callable[[wp.Function], wp.Function]:
    inputs, arrow, outputs = signature.partition(">")
    known = set(inputs) <= set(INPUTS) and set(outputs) <= set(OUTPUTS)
    if not known or (closures_most and (arrow or not inputs.startswith("v"))):
        raise ValueError(f"op {name!r}: signature {signature!r} is not valid")

    def register(function: wp.Function) -> wp.Function:
        if name in _ops and _ops[name].function.func.__module__ != function.func.__module__:
            raise ValueError(f"op {name!r} is there twice")
        _ops[name] = Op(name, inputs + outputs, function, closures_most, foldable, general)
        return function

    return register


def op(name: str, signature: str, foldable: bool = True, general: bool = True) -> Callable[[wp.Function], wp.Function]:
    """Register a function (data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint) as an op.

    Word k of the instruction, counted from 1 as in the signature, is `data.code[pc + k]`.
    """
    return _register(name, signature, foldable, 0, general)


def closure_op(
    name: str, signature: str, most: int = 1, foldable: bool = True, general: bool = True
) -> Callable[[wp.Function], wp.Function]:
    """Register a function (data, stack, pc, point, closures: wp.array(dtype=ClosureRecord), count: int) -> int.

    It appends at most `most` closures, never beyond the end of `closures`, and returns their new count. It appends none
    where its weight, the first operand, is 0.
    """
    return _register(name, signature, foldable, most, general)


def op_named(name: str) -> Op:
    """The op called `name`; raises `KeyError`."""
    return _ops[name]


# Ops of volumes alone have names that begin so
VOLUME_PREFIX = "volume_"
# and ops of images in tiles
TILED_PREFIX = "tiled_"
# The number of an op in code is its index in `op_names()` plus this; 0 ends a program
FIRST_OP = 1


@functools.cache
def op_numbers() -> dict[str, int]:
    """Numbers of all ops in the code of programs, by name: the same whatever ops a kernel is compiled for."""
    from . import ops  # noqa: F401 - files of ops register them

    return {name: FIRST_OP + i for i, name in enumerate(op_names())}


def op_names() -> list[str]:
    """Names of all ops, sorted; those that general kernels lack come last, and leave the others' numbers alone, and
    behind them those of images in tiles.
    """
    return sorted(_ops, key=lambda name: (not _ops[name].general, name.startswith(TILED_PREFIX), name))


@wp.func
def number(data: NodeData, stack: wp.array(dtype=float), at: int) -> float:
    """The number operand whose word is at `at`."""
    word = data.code[at]
    if word < 0:
        return data.constants[-1 - word]
    return stack[word]


@wp.func
def vector(data: NodeData, stack: wp.array(dtype=float), at: int) -> wp.vec3:
    """The vector operand whose word is at `at`."""
    word = data.code[at]
    if word < 0:
        first = -1 - word
        return wp.vec3(data.constants[first], data.constants[first + 1], data.constants[first + 2])
    return wp.vec3(stack[word], stack[word + 1], stack[word + 2])


@wp.func
def wanted(data: NodeData, at: int) -> bool:
    """Whether anything reads the output whose word is at `at`."""
    return data.code[at] >= 0


@wp.func
def put_number(data: NodeData, stack: wp.array(dtype=float), at: int, value: float):
    """Write the number output whose word is at `at`, if it is wanted."""
    word = data.code[at]
    if word >= 0:
        stack[word] = value


@wp.func
def put_vector(data: NodeData, stack: wp.array(dtype=float), at: int, value: wp.vec3):
    """Write the vector output whose word is at `at`, if it is wanted."""
    word = data.code[at]
    if word >= 0:
        stack[word] = value[0]
        stack[word + 1] = value[1]
        stack[word + 2] = value[2]


class _HostWarp(types.ModuleType):
    """Warp for Python code, with the functions that Warp itself offers to kernels alone."""

    def __getattr__(self, name: str):
        return getattr(wp, name)

    @staticmethod
    def where(condition, if_true, if_false):
        """`if_true` or `if_false`, as Warp's function of this name."""
        return if_true if condition else if_false


_host_warp = _HostWarp("warp")


@functools.cache
def as_python(function: wp.Function) -> Callable:
    """The body of a Warp function as a Python function, which calls other Warp functions' bodies in turn.

    Numbers are Python's, vectors Warp's; arrays may be lists, and structs any object with their attributes.
    """
    source = function.func
    names = dict(source.__globals__)
    for name, value in names.items():
        if value is wp:
            names[name] = _host_warp
    body = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__)
    cells = []
    for cell in source.__closure__ or ():
        value = cell.cell_contents
        cells.append(
            types.CellType(
                as_python(value) if _is_own(value) and value is not function else _host_warp if value is wp else value
            )
        )
    if cells:
        body = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__, tuple(cells))
    for name in source.__code__.co_names:
        value = names.get(name)
        if _is_own(value) and value is not function:
            names[name] = as_python(value)
    return body


def _is_own(value) -> bool:
    return isinstance(value, wp.Function) and not value.is_builtin()
