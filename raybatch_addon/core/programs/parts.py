"""Parts of programs: what some of their steps depend on, as programs of their own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from ..scene.program import Instruction, Program
from ..shading.bsdf.materials import TRANSPARENT_OPS
from .op import op_named


def steps_towards(
    instructions: Sequence[Instruction], is_aim: Callable[[Instruction], bool]
) -> tuple[Instruction, ...]:
    """The instructions for which `is_aim` holds, and those that they depend on, in order."""
    wanted: set[int] = set()  # registers whose last values before an instruction they depend on
    kept = []
    for step in reversed(instructions):
        signature = op_named(step.op).signature
        written = _registers(signature, step.words, "NV")
        if is_aim(step) or wanted & written:
            wanted = (wanted - written) | _registers(signature, step.words, "nv")
            kept.append(step)
    return tuple(kept[::-1])


def transparent_parts(programs: Sequence[Program | None]) -> list[Program | None]:
    """The part of each of `programs` that makes the closures that let light pass straight on, all that shadow rays ask
    for; None where there are no such closures. A program that occurs several times has one part.
    """
    known: dict[int, Program | None] = {}
    for program in programs:
        if program is not None and id(program) not in known:
            steps = steps_towards(program.instructions, lambda step: step.op in TRANSPARENT_OPS)
            known[id(program)] = dataclasses.replace(program, instructions=steps) if steps else None
    return [known[id(program)] if program is not None else None for program in programs]


def outputs_read(instructions: Sequence[Instruction], op: str) -> set[int]:
    """Numbers, from 0, of the outputs of `op` that later steps read."""
    written: dict[int, int] = {}  # by register
    found = set()
    for step in instructions:
        signature = op_named(step.op).signature
        found |= {written[register] for register in _registers(signature, step.words, "nv") if register in written}
        for register in _registers(signature, step.words, "NV"):
            written.pop(register, None)
        if step.op == op:
            outputs = [word for letter, word in zip(signature, step.words) if letter in "NV"]
            written |= {word: number for number, word in enumerate(outputs) if word >= 0}
    return found


def _registers(signature: str, words: tuple[int, ...], letters: str) -> set[int]:
    """The registers of operands with one of `letters`."""
    found: set[int] = set()
    for letter, word in zip(signature, words):
        if letter in letters and word >= 0:
            found.update(range(word, word + (3 if letter in "vV" else 1)))
    return found
