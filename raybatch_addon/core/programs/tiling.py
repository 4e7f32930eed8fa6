"""Images beyond memory: programs whose look-ups find pictures in tiles, and the part of each that fetches them.

A scene is rewritten for a render whose images together take more than their budget. Images that surfaces alone look up
come in tiles then (`TiledImage`), since a path can wait before a surface is shaded; others are held whole. Each look-up
of an image in tiles becomes an op that finds them. What its coordinates depend on, and an op in front of it that asks
for its tiles, becomes a program of its own without closures (`Program.fetches`), which `wavefront/textures` runs first:
until no tile is missing nothing of the program itself is run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from ..errors import BudgetError
from ..host_memory import size_text
from ..scene.description import Image, Scene
from ..scene.notice import Notice, Weight
from ..scene.passes import OCCLUSION_PASS
from ..scene.program import Instruction, Program, rounded_registers
from ..shading.images.image_upload import device_bytes_of
from ..shading.images.levels import FilteredImage, ImageLevels
from ..shading.images.textures import Interpolation
from ..shading.images.tiled.pictures import TiledImage
from .op import op_named
from .parts import steps_towards

# Ops of images, and those that take their place
_TILED = {
    "image": "tiled_image",
    "image_at": "tiled_image",
    "image_box": "tiled_image_box",
    "image_box_at": "tiled_image_box",
}
_WANTS = {"tiled_image": "tiled_want", "tiled_image_box": "tiled_want_box"}
TILED_OPS = frozenset(_WANTS)
WANT_OPS = frozenset(_WANTS.values())
# Words in front of their level, or of where it is to be, and of what says whether tiles were fetched
_BEFORE_LEVEL = {"image": 5, "image_at": 5, "image_box": 5, "image_box_at": 5}
_SURE = {"tiled_image": 5, "tiled_image_box": 4}
# Registers behind all others of programs that fetch: what is done with tiles, and how many are missing
ACTION, MISSING, FETCH_REGISTERS = 0, 1, 2
# Tiles that a look-up reads at most along an axis: also where it goes around the end of a picture, whose last tile may
# be a column wide
_TILES_ACROSS = {Interpolation.CLOSEST: 1, Interpolation.LINEAR: 2, Interpolation.CUBIC: 3}
_NAMED_MOST = 4  # images that a warning names


def tiled_scene(scene: Scene, budget: int | None, slot_bytes: int, is_asked: bool = False) -> Scene:
    """`scene` with images in tiles that fill slots of `slot_bytes`, where all take more than `budget` bytes on the
    device (None: no limit), as far as surfaces alone look them up; what nobody looks up has no pixels. Where all fit it
    is as it was.

    `is_asked`: the budget is that of the setting; then it raises `BudgetError` where images that have to be whole
    take more. Else these are named by a warning, and are made smaller.
    """
    if budget is None or device_bytes_of(scene.images) <= budget:
        return scene
    held = held_images(scene)
    seen = {image for material in scene.materials for _, image in _images_of(material.program)}
    images = tuple(image if i in held or i in seen else _without_pixels(image) for i, image in enumerate(scene.images))
    tiled = {i for i, image in enumerate(images) if i not in held and _is_large(image, slot_bytes)}
    rest = device_bytes_of([image for i, image in enumerate(images) if i not in tiled])
    warnings = scene.warnings
    if rest > budget:
        names = _named(scene, held)
        if is_asked:
            raise BudgetError(
                f"texture_budget is {budget:,} bytes, and this scene needs {rest:,} at least, for images that cannot "
                f"be fetched tile by tile ({names}); raise it, or set it to 0"
            )
        text = (
            f"images that cannot be fetched tile by tile ({names}) take {size_text(rest)}, more than the "
            f"{size_text(budget)} that there are for images"
        )
        warnings = (*warnings, Notice(text, Weight.REPLACED, remedy="make these images smaller"))
    if not tiled:
        return dataclasses.replace(scene, images=images, warnings=warnings)
    programs = {id(m.program): m.program for m in scene.materials if m.program is not None}
    made = {key: _with_tiles(program, tiled) for key, program in programs.items()}
    register_count = rounded_registers(max(each.register_count for each in made.values()) + FETCH_REGISTERS)
    for key, program in made.items():
        if program is not programs[key]:
            made[key] = dataclasses.replace(program, fetches=fetch_part(program, register_count))
    return dataclasses.replace(
        scene,
        warnings=warnings,
        images=tuple(_in_tiles(image, slot_bytes) if i in tiled else image for i, image in enumerate(images)),
        materials=tuple(
            material if material.program is None else dataclasses.replace(material, program=made[id(material.program)])
            for material in scene.materials
        ),
    )


def images_of_displacement(scene: Scene, budget: int | None) -> tuple[Image, ...]:
    """The images of `scene`; where all take more than `budget` bytes, those that displacement does not look up without
    pixels.
    """
    if budget is None or device_bytes_of(scene.images) <= budget:
        return scene.images
    used = {image for material in scene.materials for _, image in _images_of(material.displacement)}
    return tuple(image if i in used else _without_pixels(image) for i, image in enumerate(scene.images))


def held_images(scene: Scene) -> dict[int, str]:
    """Images that have to be whole on the device, by number, and who looks them up without waiting."""
    held: dict[int, str] = {}

    def hold(program: Program | None, who: str, ops: Iterable[str] = ()) -> None:
        for op, image in _images_of(program):
            if op not in ops:
                held.setdefault(image, who)

    hold(scene.world.program, "the world")
    for light in scene.lights:
        hold(light.program, "a light")
    for volume in (scene.world.volume, *(material.volume for material in scene.materials)):
        hold(volume.program if volume else None, "a volume")
    for material in scene.materials:
        program = material.program
        if program is None:
            continue
        if program.may_emit:
            hold(program, "a material that emits")
        elif program.requests is not None:
            hold(program, "a material with Ambient Occlusion or Bevel")
        elif OCCLUSION_PASS in scene.frame.passes:
            hold(program, "the pass Ambient Occlusion")
        hold(program, "an environment texture of a material", (*_TILED, "image_level"))
    return held


def fetch_part(program: Program, register_count: int) -> Program | None:
    """The part of `program`, whose look-ups find tiles, that asks for them; None where there is none. It has so many
    registers, the last of which are those of `FETCH_REGISTERS`.
    """
    first = register_count - FETCH_REGISTERS
    steps: list[Instruction] = []
    for step in program.instructions:
        if step.op not in TILED_OPS:
            steps.append(step)
            continue
        outputs = len(op_named(step.op).outputs)
        sure = _SURE[step.op]
        inputs = step.words[:-outputs]
        words = (*inputs[: sure - 1], 0, *inputs[sure + 1 :], first + ACTION, first + MISSING, first + MISSING)
        alone = Instruction(_WANTS[step.op], (*words[:-2], first + ACTION, -1))  # without what others miss
        depends = any(
            each.op in TILED_OPS for each in steps_towards([*steps, alone], lambda each, aim=alone: each is aim)
        )
        steps.append(Instruction(alone.op, (*words[: sure - 1], int(depends), *words[sure:])))
        steps.append(Instruction(step.op, (*step.words[:sure], 0, *step.words[sure + 1 :])))
    kept = steps_towards(steps, lambda step: step.op in WANT_OPS)
    if not kept:
        return None
    ops = tuple(sorted({step.op for step in kept}))
    return Program(kept, program.constants, register_count, 0, ops)


def tiles_at_once(programs: Iterable[Program | None]) -> int:
    """The most tiles that one run of any of `programs`, which fetch, needs at once."""
    return max((sum(map(_tiles_of, program.instructions)) for program in programs if program is not None), default=0)


def _tiles_of(step: Instruction) -> int:
    if step.op not in WANT_OPS:
        return 0
    across = _TILES_ACROSS[Interpolation(step.words[1])]
    return across * across * (3 if step.op == "tiled_want_box" else 1)


def _images_of(program: Program | None) -> list[tuple[str, int]]:
    """The ops of `program` that look up images, each with the number of its image."""
    found = []
    for step in program.instructions if program is not None else ():
        at = op_named(step.op).signature.find("m")
        if at >= 0:
            found.append((step.op, step.words[at]))
    return found


def _with_tiles(program: Program, tiled: set[int]) -> Program:
    """`program` with look-ups of `tiled` images that find tiles; itself where there are none."""
    steps, constants = [], program.constants
    zero = -1 - len(constants)
    changed = False
    for step in program.instructions:
        if step.op in _TILED and step.words[0] in tiled:
            op, words = _TILED[step.op], step.words
            at = _BEFORE_LEVEL[step.op]
            level = (words[at],) if step.op.endswith("_at") else (zero,)
            rest = words[at + len(level) :] if step.op.endswith("_at") else words[at:]
            before = words[:at]
            words = (*before[: _SURE[op]], 1, *before[_SURE[op] :], *level, *rest)
            step, changed = Instruction(op, words), True
        steps.append(step)
    if not changed:
        return program
    names = {step.op for step in steps}
    ops = {name for name in program.ops if name not in _TILED or name in names} | names
    constants = np.append(constants, np.float32(0.0)).astype(np.float32)
    return dataclasses.replace(program, instructions=tuple(steps), constants=constants, ops=tuple(sorted(ops)))


def _without_pixels(image: Image) -> Image:
    """`image` for who does not look it up."""
    return Image(image.name)


def _is_large(image: Image, slot_bytes: int) -> bool:
    pictures = [image.pixels] if image.tiles is None else [pixels for _, pixels in image.tiles]
    return any(each is not None and device_bytes_of([Image("", each)]) > slot_bytes for each in pictures)


def _in_tiles(image: Image, slot_bytes: int) -> TiledImage:
    levels = image.levels if isinstance(image, FilteredImage) else ImageLevels.NONE
    return TiledImage(image.name, image.pixels, image.encoding, image.tiles, levels, slot_bytes)


def _named(scene: Scene, held: dict[int, str]) -> str:
    """The largest images that have to be whole, and why."""
    there = [i for i in held if 0 <= i < len(scene.images)]
    largest = sorted(there, key=lambda i: -device_bytes_of([scene.images[i]]))[:_NAMED_MOST]
    return ", ".join(f"“{scene.images[i].name}”, of {held[i]}" for i in largest) or "small ones"
