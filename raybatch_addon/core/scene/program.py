"""Shader graphs as small programs, which the export builds and the interpreter of `programs/run.py` runs.

A program is a list of instructions. Each has the name of an op and one word (int32) for each letter of the op's
signature (`programs/op.py`):

- `n`, `v`: a number, or three. A word w >= 0 is a register: the offset of its first float; w < 0 is the constant at
  index -1 - w.
- `i`: the value itself. `s`: where the op looks, at the point (0) or one step aside along x (1) or y (2). `t`: the
  index of a table's first constant. `m`: an image. `a`: an attribute.
- `N`, `V`: the register that is written; -1: not wanted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field
from enum import IntEnum

import numpy as np


@dataclass(frozen=True)
class Instruction:
    """One step of a program."""

    op: str
    words: tuple[int, ...]


@dataclass(frozen=True)
class Program:
    """A program that makes a surface's closures, or the radiance of a world or light."""

    instructions: tuple[Instruction, ...] = ()
    constants: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))  # float32, shape [n]
    register_count: int = 0  # size of the stack [floats]
    closure_count: int = 0  # most closures that it makes
    # Names of all ops that the graph's nodes may need when values change; kernels are compiled for these. Includes the
    # ops of `instructions`.
    ops: tuple[str, ...] = ()
    _: KW_ONLY
    # of a render: answers that rays give to any program, in the last registers; and what asks for them
    answer_count: int = 0
    requests: Program | None = None
    fetches: Program | None = None  # what asks for tiles of images that are not whole on the device

    @property
    def may_emit(self) -> bool:
        """Whether some step emits. Where emission is known to be black there is none, though `ops` has it."""
        return any(step.op == "emission" for step in self.instructions)


@dataclass(frozen=True)
class ProgramFeatures:
    """Features that an interpreter is compiled for."""

    ops: tuple[str, ...] = ()  # sorted; empty: there is no program
    register_count: int = 1  # size of the stack [floats]
    closure_count: int = 1  # most closures of a material
    apart: bool = False  # the interpreter is compiled once, for all kernels of the general tier, and called
    answer_count: int = 0  # answers of rays at most; in the last registers
    flows: bool = False  # of volumes: some move by grids while the shutter is open; nothing to the interpreter

    def __bool__(self) -> bool:
        return bool(self.ops)


def program_features(programs: Iterable[Program | None], closure_count: int = 0) -> ProgramFeatures:
    """Features for `programs`, and for materials of up to `closure_count` closures without program.

    Sizes are rounded up, so that they grow rarely, and kernels are rarely compiled anew.
    """
    there = [program for program in programs if program is not None]
    if not there:
        return ProgramFeatures()
    ops = set().union(*(program.ops for program in there))
    ops.update(instruction.op for program in there for instruction in program.instructions)
    return ProgramFeatures(
        tuple(sorted(ops)),
        rounded_registers(max(program.register_count for program in there)),
        _rounded_up(max(closure_count, *(program.closure_count for program in there)), 4),
        answer_count=max(program.answer_count for program in there),
    )


def rounded_registers(count: int) -> int:
    """The size of the stack for programs of `count` registers at most."""
    return _rounded_up(count, 16)


def _rounded_up(count: int, least: int) -> int:
    return max(least, 1 << max(count - 1, 0).bit_length())


class ImageEncoding(IntEnum):
    """Meaning of an image's numbers."""

    LINEAR = 0  # linear RGB, or data that are no colour
    SRGB = 1  # the sRGB transfer function; decoded after interpolation, as Blender does


@dataclass(frozen=True)
class Image:
    """A picture that textures read.

    The bottom row comes first; alpha, where there is any, has been multiplied into the colours. With tiles (UDIM) it is
    many pictures: tile 1001 + 10 v + u covers texture coordinates u..u + 1, v..v + 1. A picture without pixels counts
    as missing, and so does a tile that is not there: magenta.
    """

    name: str
    # uint8 (255 is 1), float16 or float32, shape [height, width, channels] with 1 (grey), 3 (RGB) or 4 (RGBA) channels
    pixels: np.ndarray | None = None
    encoding: ImageEncoding = ImageEncoding.LINEAR
    tiles: tuple[tuple[int, np.ndarray | None], ...] | None = None  # tile number and its pixels, instead of `pixels`
