"""Builder of programs: values in, instructions out, constants folded, registers shared.

Values are computed once and never change (static single assignment). `finish` assigns registers to them by the order of
their last uses.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from ctypes import c_float
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from ..device.devices import start_warp
from ..scene.program import Instruction, Program
from ..shading.bsdf.materials import ClosureRecord
from .op import Op, as_python, op_named

Constant = float | tuple[float, float, float]


def three_numbers(numbers: Sequence[float]) -> tuple[float, float, float]:
    """The first three of one to four `numbers`; 0 stands for those that are not there."""
    x, y, z = (*(float(each) for each in numbers[:3]), 0.0, 0.0)[:3]
    return x, y, z


@dataclass(frozen=True, eq=False)
class Value:
    """A number (width 1) or vector (width 3) of a program: a constant, or the result of an instruction."""

    width: int
    constant: tuple[float, ...] | None = None

    @property
    def known(self) -> bool:
        """Whether the value is a constant."""
        return self.constant is not None

    @staticmethod
    def of(value: Value | Constant) -> Value:
        """`value` as a `Value`; numbers that are not finite in float32 become 0."""
        if isinstance(value, Value):
            return value
        plain = tuple(float(c) for c in value) if hasattr(value, "__len__") else (float(value),)
        if len(plain) not in (1, 3):
            raise ValueError(f"a value has 1 or 3 numbers, not {len(plain)}")
        return Value(len(plain), tuple(_single(c) for c in plain))

    def number(self) -> float:
        """The constant, of width 1."""
        return self.constant[0]


def _single(x: float) -> float:
    single = c_float(x).value  # rounds as NumPy does, in a tenth of the time
    return single if math.isfinite(single) else 0.0


def _is_finite(x: float) -> bool:
    """Whether `x` is finite in float32."""
    return math.isfinite(c_float(x).value)


def _bits(values: Sequence[float]) -> bytes:
    """Bytes by which constants are distinguished: 0 is not -0, as hashes and signs see it."""
    return np.array(values, np.float32).tobytes()


def _key(operand: Value | int) -> Hashable:
    """Key of an operand: operands with the same key are the same."""
    if not isinstance(operand, Value):
        return operand
    return _bits(operand.constant) if operand.known else id(operand)


@dataclass
class _Step:
    op: Op
    inputs: list[Value | int]  # ints: immediates, images, attributes, offsets of tables
    outputs: list[Value]


class ProgramBuilder:
    """Steps of one program, as they are added."""

    def __init__(self, constants: Sequence[float] = ()) -> None:
        """A program without steps. `constants`: those of a program that it is made of; its tables keep their places."""
        start_warp()  # functions of Warp that ops call when they are folded would do it, and not as quietly
        self._steps: list[_Step] = []
        self._same: dict[tuple, tuple[Value, ...]] = {}  # results by op and operands: each is computed once
        self._constants: list[float] = [float(value) for value in constants]
        self._offsets: dict[bytes, int] = {}

    def value(self, name: str, *operands) -> Value | tuple[Value, ...]:
        """Result of the op `name` for `operands`, one for each letter of its inputs.

        The result is a `Value`, or a tuple with one for each output. With constants alone the op is run at once.
        """
        op = op_named(name)
        inputs = self._inputs(op, operands)
        if op.foldable and all(not isinstance(each, Value) or each.known for each in inputs):
            folded = self._run(op, inputs)
            if folded is not None:
                return folded[0] if len(folded) == 1 else folded
        key = (name, *(_key(each) for each in inputs))
        if key not in self._same:
            outputs = [Value(3 if letter == "V" else 1) for letter in op.outputs]
            self._steps.append(_Step(op, inputs, outputs))
            self._same[key] = tuple(outputs)
        outputs = self._same[key]
        return outputs[0] if len(outputs) == 1 else outputs

    def closure(self, name: str, *operands) -> None:
        """Add a closure; the first operand is its weight."""
        op = op_named(name)
        self._steps.append(_Step(op, self._inputs(op, operands), []))

    @property
    def step_count(self) -> int:
        """Number of steps so far, including those that nothing needs."""
        return len(self._steps)

    def drop_closures(self, first: int) -> None:
        """Remove the closures of all steps from number `first` on."""
        self._steps[first:] = [step for step in self._steps[first:] if not step.op.makes_closures]

    def table(self, values: Sequence[float]) -> int:
        """Offset of `values` among the constants."""
        return self._offset_of(tuple(_single(float(v)) for v in values))

    def constant_closures(self) -> list[ClosureRecord] | None:
        """The closures if all of them are constant, else None."""
        steps = self._needed()
        if not all(
            step.op.makes_closures and step.op.foldable and all(_is_known(each) for each in step.inputs)
            for step in steps
        ):
            return None
        closures = _Closures([None] * sum(step.op.closures_most for step in steps))
        count = 0
        for step in steps:
            data, words = self._host_words(step.op, step.inputs)
            count = as_python(step.op.function)(
                SimpleNamespace(code=[0, *words], constants=data), [], 0, None, closures, count
            )
        return list(closures[:count])

    def finish(self) -> Program:
        """The program of all closures so far, without those that are known to be black.

        Kernels are compiled and their arrays measured as if black closures were there: a constant that changes changes
        no kernel.
        """
        needed = self._needed()
        most = _Registers(needed)
        for i, step in enumerate(needed):
            for each in step.outputs:
                most.take(each)
            most.free_after(i)
        steps = self._needed(seen=True)
        registers = _Registers(steps)
        instructions = []
        for i, step in enumerate(steps):
            words = [self._word(each, registers) for each in step.inputs]
            # outputs are assigned before inputs are freed: an op may write one before it has read all
            words += [registers.take(each) for each in step.outputs]
            registers.free_after(i)
            instructions.append(Instruction(step.op.name, tuple(words)))
        ops = {step.op.name for step in needed}
        return Program(
            tuple(instructions),
            np.array(self._constants, np.float32),
            max(most.count, registers.count),
            sum(step.op.closures_most for step in needed),
            tuple(sorted(ops)),
        )

    def _needed(self, seen: bool = False) -> list[_Step]:
        """The steps that closures depend on, in order; with `seen` without closures that are known to be black."""
        wanted: set[int] = set()
        steps = []
        black = self._black() if seen else set()
        for step in reversed(self._steps):
            if seen and step.op.makes_closures and _is_black(step.inputs[0], black):
                continue
            if step.op.makes_closures or any(id(each) in wanted for each in step.outputs):
                wanted.update(id(each) for each in step.inputs if isinstance(each, Value))
                steps.append(step)
        return steps[::-1]

    def _black(self) -> set[int]:
        """Ids of values that are black wherever the program runs, since a constant makes them so: emission whose
        strength is 0, or the share of a shader that a factor leaves out.
        """
        black: set[int] = set()
        for step in self._steps:
            if step.op.name == "multiply_colors":
                is_black = [any(_is_black(each, black) for each in step.inputs)]
            elif step.op.name == "mix_weights":
                weight, share = step.inputs
                share = share.constant[0] if share.known else math.nan
                is_black = [_is_black(weight, black) or share >= 1, _is_black(weight, black) or share <= 0]
            else:
                continue
            black.update(id(each) for each, known in zip(step.outputs, is_black) if known)
        return black

    def _inputs(self, op: Op, operands: Sequence) -> list[Value | int]:
        letters = op.inputs
        if len(letters) != len(operands):
            raise ValueError(f"the op {op.name!r} takes {len(letters)} operands ({letters}), not {len(operands)}")
        inputs: list[Value | int] = []
        for letter, operand in zip(letters, operands):
            if letter in "nv":
                value = Value.of(operand)
                if value.width != (3 if letter == "v" else 1):
                    raise ValueError(
                        f"the op {op.name!r} takes a {'vector' if letter == 'v' else 'number'} where it was given "
                        "another"
                    )
                inputs.append(value)
            elif letter == "t":
                inputs.append(operand if isinstance(operand, int) else self.table(operand))
            else:
                inputs.append(int(operand))
        return inputs

    def _run(self, op: Op, inputs: list[Value | int]) -> tuple[Value, ...] | None:
        """Outputs of `op`, run on the host; None if it cannot be run there."""
        constants, words = self._host_words(op, inputs)
        offset, outputs = 0, []
        for letter in op.outputs:
            outputs.append(offset)
            offset += 3 if letter == "V" else 1
        stack = [0.0] * offset
        data = SimpleNamespace(code=[0, *words, *outputs], constants=constants)
        try:
            as_python(op.function)(data, stack, 0, None)
        except (
            ArithmeticError,
            AttributeError,
            TypeError,
            RuntimeError,
            ValueError,
        ):  # the op fails on Python objects, or on these values; the device can run it
            return None
        # infinity stays infinity on the device, but constants are finite
        if not all(_is_finite(number) for number in stack):
            return None
        return tuple(
            Value.of(stack[at : at + 3] if letter == "V" else stack[at]) for at, letter in zip(outputs, op.outputs)
        )

    def _host_words(self, op: Op, inputs: list[Value | int]) -> tuple[list[float], list[int]]:
        """Constants and words through which the host reads `inputs`, all of them constant."""
        # tables are read from the front of the constants, which an op without tables does without
        constants = list(self._constants) if "t" in op.inputs else []
        words = []
        for each in inputs:
            if isinstance(each, Value):
                words.append(-1 - len(constants))
                constants += each.constant
            else:
                words.append(each)
        return constants, words

    def _word(self, operand: Value | int, registers: _Registers) -> int:
        if not isinstance(operand, Value):
            return operand
        return -1 - self._offset_of(operand.constant) if operand.known else registers.first[id(operand)]

    def _offset_of(self, values: tuple[float, ...]) -> int:
        key = _bits(values)
        if key not in self._offsets:
            self._offsets[key] = len(self._constants)
            self._constants += values
        return self._offsets[key]


class _Closures(list):
    """Closures as ops write them on the host: a list with an array's shape."""

    @property
    def shape(self) -> tuple[int]:
        return (len(self),)


def _is_known(operand: Value | int) -> bool:
    return not isinstance(operand, Value) or operand.known


def _is_black(value: Value, black: set[int]) -> bool:
    return value.constant == (0.0, 0.0, 0.0) or id(value) in black


class _Registers:
    """Registers of values in the stack: each value keeps its own from its step to its last reader."""

    def __init__(self, steps: list[_Step]):
        self._last: dict[int, int] = {}
        for i, step in enumerate(steps):
            for each in step.inputs:
                if isinstance(each, Value) and not each.known:
                    self._last[id(each)] = i
        self._ends: dict[int, list[Value]] = {}
        self._free: list[bool] = []
        self.first: dict[int, int] = {}

    @property
    def count(self) -> int:
        """Size of the stack [floats]."""
        return len(self._free)

    def take(self, value: Value) -> int:
        """First register of `value`; -1 if nothing reads it."""
        if id(value) not in self._last:
            return -1
        at = next(
            (i for i in range(self.count) if all(self._free[i : i + value.width]) and i + value.width <= self.count),
            None,
        )
        if at is None:
            at = self.count
            while at > 0 and self._free[at - 1] and self.count - at < value.width - 1:
                at -= 1
            self._free += [True] * (at + value.width - self.count)
        self._free[at : at + value.width] = [False] * value.width
        self.first[id(value)] = at
        self._ends.setdefault(self._last[id(value)], []).append(value)
        return at

    def free_after(self, step: int) -> None:
        """Free the registers of values that `step` is the last to read."""
        for value in self._ends.pop(step, ()):
            at = self.first[id(value)]
            self._free[at : at + value.width] = [True] * value.width
