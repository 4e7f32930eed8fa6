"""Images filtered over footprints: programs whose look-ups of images choose a level by the path's footprint.

A program is rewritten for a render that filters (`texture_filter`). Each `image` op gets its coordinates a second and
third time, one step aside along either axis of the surface: the same instructions, with other words where ops say where
they look (letter `s`). How far the coordinates change by the steps shows how large the path's footprint is in the
image, whatever leads from a UV map, or from the position, to the coordinates.

Look-ups stay at level 0, the image itself:

- where a normal is made of them: a footprint of a normal map has many normals, and the light of their mean is not the
  mean of their light (Toksvig, "Mipmapping Normal Maps", 2005);
- where their coordinates are read from textures: to run these three times would cost more than it gives;
- where their coordinates do not follow the surface (directions, constants), and in environments.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ..scene.description import Image, Scene
from ..scene.program import Instruction, Program
from ..settings.settings import RenderSettings
from ..shading.images.image_upload import UploadedImages
from ..shading.images.levels import FilteredImage, ImageLevels
from .builder import ProgramBuilder, Value
from .op import INPUTS, Op, op_named
from .ops.textures.image_levels import BOX, REGISTERS

# Ops at level 0: where their coordinates are among the words, and the ops that take their place
_COORDINATES = {"image": 5, "image_box": 5}
_AT = {"image": "image_at", "image_box": "image_box_at"}
_DIVIDE = {"image": 4, "image_box": 3, "image_at": 4, "image_box_at": 3}
# Ops that make normals, which are no means
_NORMAL_OPS = ("bump", "normal_map", "surface_normal")
LEVEL_OPS = ("image_level", *_AT.values())


def filtered_scene(scene: Scene, settings: RenderSettings) -> Scene:
    """`scene` with images of its materials filtered as `settings` say."""
    if settings.texture_filter == "OFF":
        return scene
    known: dict[int, Program] = {}
    for material in scene.materials:
        program = material.program
        if program is not None and id(program) not in known:
            known[id(program)] = with_footprints(program, settings.texture_filter_width)
    materials = tuple(
        material if material.program is None else dataclasses.replace(material, program=known[id(material.program)])
        for material in scene.materials
    )
    return dataclasses.replace(scene, materials=materials, images=_images(scene, known.values()))


def image_statistics(scene: Scene, uploaded: UploadedImages | None) -> dict[str, int]:
    """What a report says of the images of `scene`: how many, their memory, and where they are filtered how many of the
    look-ups in programs of materials are not.
    """
    counts = {"count": len(scene.images), "bytes": uploaded.bytes if uploaded else 0}
    programs = {id(m.program): m.program for m in scene.materials if m.program is not None}
    names = Counter(step.op for program in programs.values() for step in program.instructions)
    if uploaded and names["image_level"]:
        counts["level_bytes"] = uploaded.level_bytes
        # each has a level of its own, and only they
        filtered = counts["filtered_look_ups"] = names["image_level"]
        look_ups = (*_AT, *_AT.values(), "environment", "tiled_image", "tiled_image_box")
        counts["other_look_ups"] = sum(names[name] for name in look_ups) - filtered
    return counts


def with_footprints(program: Program, width: float) -> Program:
    """`program` with levels chosen for its look-ups of images; `width`: in widths of a path's footprint.

    The registers in front are those of `ops/textures/image_levels.py`. A program without images is as it was.
    """
    if _AT.keys().isdisjoint(program.ops):
        return program
    rewriting = _Rewriting(program, width)
    kept = steps_of_normals(program)
    for index, instruction in enumerate(program.instructions):
        rewriting.take(instruction, index not in kept)
    built = rewriting.builder.finish()
    return dataclasses.replace(
        program,
        instructions=tuple(_behind_registers(each) for each in built.instructions),
        constants=built.constants,
        register_count=max(program.register_count, built.register_count) + REGISTERS,
        ops=tuple(sorted({*program.ops, *built.ops, *LEVEL_OPS})),
    )


@dataclass(frozen=True)
class _Maker:
    """The step that makes a value."""

    value: Value
    name: str  # of the op
    operands: list[Value | int]
    place: int  # of the value among the op's outputs


class _Rewriting:
    """A program on its way to another builder."""

    def __init__(self, program: Program, width: float):
        self.builder = ProgramBuilder(program.constants)
        self._constants = program.constants
        self._share = width * width
        self._values: dict[int, Value] = {}  # what registers hold
        self._makers: dict[int, _Maker] = {}  # by identity of their values

    def take(self, instruction: Instruction, filters: bool) -> None:
        """Add the next instruction, or what takes its place if it `filters`."""
        op = op_named(instruction.op)
        words = [
            self._operand(letter, word) if letter in INPUTS else word
            for letter, word in zip(op.signature, instruction.words)
        ]
        if op.makes_closures:
            self.builder.closure(op.name, *words)
            return
        count = len(op.inputs)
        name, operands = op.name, words[:count]
        if filters:
            name, operands = self._filtered(name, operands)
        for register, value in zip(words[count:], self._add(name, operands)):
            if register >= 0:
                self._values[register] = value

    def _operand(self, letter: str, word: int) -> Value | int:
        if letter not in "nv":
            return word
        if word >= 0:
            return self._values[word]
        first = -1 - word
        if letter == "n":
            return Value.of(float(self._constants[first]))
        return Value.of(tuple(self._constants[first : first + 3].tolist()))

    def _add(self, name: str, operands: list[Value | int]) -> tuple[Value, ...]:
        made = self.builder.value(name, *operands)
        made = made if isinstance(made, tuple) else (made,)
        for place, value in enumerate(made):
            if not value.known:
                self._makers.setdefault(id(value), _Maker(value, name, operands, place))
        return made

    def _filtered(self, name: str, operands: list[Value | int]) -> tuple[str, list[Value | int]]:
        """The op `name`, or the one that looks up a level."""
        if name not in _AT:
            return name, operands
        at = _COORDINATES[name]
        coordinates = operands[at]
        if not isinstance(coordinates, Value) or not follows_surface(self._upstream(coordinates)):
            return name, operands
        here, along_x, along_y = (self._moved(coordinates, shift, {}) for shift in (0, 1, 2))
        projection = BOX if name == "image_box" else operands[3]
        (level,) = self._add("image_level", [operands[0], projection, self._share, here, along_x, along_y])
        return _AT[name], [*operands[:at], level, *operands[at:]]

    def _upstream(self, value: Value) -> Iterator[Op]:
        """The ops that `value` depends on."""
        waiting, seen = [value], set()
        while waiting:
            each = waiting.pop()
            if id(each) in seen or id(each) not in self._makers:
                continue
            seen.add(id(each))
            maker = self._makers[id(each)]
            yield op_named(maker.name)
            waiting += [operand for operand in maker.operands if isinstance(operand, Value)]

    def _moved(self, value: Value, shift: int, done: dict[int, Value]) -> Value:
        """`value` where all that it depends on looks `shift` aside; `done`: such values by what they were."""
        maker = self._makers.get(id(value))
        if maker is None:
            return value  # a constant
        if id(value) not in done:
            letters = op_named(maker.name).inputs
            moved = [
                shift if letter == "s" else self._moved(each, shift, done) if isinstance(each, Value) else each
                for letter, each in zip(letters, maker.operands)
            ]
            same = all(a is b if isinstance(b, Value) else a == b for a, b in zip(moved, maker.operands))
            done[id(value)] = value if same else self._add(maker.name, moved)[maker.place]
        return done[id(value)]


def steps_of_normals(program: Program) -> set[int]:
    """Indices of the instructions whose results reach ops that make normals."""
    found: set[int] = set()
    wanted: set[int] = set()  # registers whose last values before an instruction do
    for index in reversed(range(len(program.instructions))):
        step = program.instructions[index]
        signature = op_named(step.op).signature
        written = {word for letter, word in zip(signature, step.words) if letter in "NV"}
        if wanted & written:
            found.add(index)
        wanted -= written
        if index in found or step.op in _NORMAL_OPS:
            wanted |= {word for letter, word in zip(signature, step.words) if letter in "nv" and word >= 0}
    return found


def follows_surface(ops: Iterator[Op]) -> bool:
    """Whether coordinates made by `ops` follow the surface, and are cheap to compute again."""
    found = list(ops)
    textures = any(".textures." in op.function.func.__module__ for op in found)
    return not textures and any("s" in op.inputs for op in found)


def _behind_registers(instruction: Instruction) -> Instruction:
    signature = op_named(instruction.op).signature
    moves = (letter in "nvNV" and word >= 0 for letter, word in zip(signature, instruction.words))
    words = tuple(word + REGISTERS if move else word for move, word in zip(moves, instruction.words))
    return Instruction(instruction.op, words)


def _images(scene: Scene, programs: Iterable[Program]) -> tuple[Image, ...]:
    """The images of `scene`, with levels where programs ask for them. An image by whose alpha some look-ups divide and
    others do not has none, as it would need two sets: it is looked up as it is.
    """
    levels: dict[int, ImageLevels] = {}
    mixed: set[int] = set()
    for program in programs:
        for step in program.instructions:
            if step.op in _AT.values():
                wanted = ImageLevels.DIVIDED if step.words[_DIVIDE[step.op]] else ImageLevels.PLAIN
                if levels.setdefault(step.words[0], wanted) is not wanted:
                    mixed.add(step.words[0])
    return tuple(
        FilteredImage(image.name, image.pixels, image.encoding, image.tiles, levels[index])
        if index in levels and index not in mixed
        else image
        for index, image in enumerate(scene.images)
    )
