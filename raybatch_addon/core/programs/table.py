"""Upload of programs to the device."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from ..errors import SceneError
from ..native.structs import Upload, bytes_of_struct, upload_anew
from ..scene.description import Scene
from ..scene.geometry import Geometry
from ..scene.program import Program, ProgramFeatures
from ..shading.bsdf.albedo import upload_tables
from ..shading.images.textures import ImageTable
from .inputs_data import InputData, upload_inputs
from .op import INPUTS, NodeData, op_named, op_numbers
from .run import END, LENGTH_SHIFT


def encode(programs: Sequence[Program | None], ops: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Programs as one array of code, one of constants, and the begin of each program (-1 for None).

    A `Program` that occurs several times has its code and constants once: lamps may share it. Raises `SceneError` for a
    program that is not valid: unknown ops or operands out of range.
    """
    numbers = {name: number for name, number in op_numbers().items() if name in ops}
    code: list[int] = []
    constants: list[np.ndarray] = []
    first = np.full(len(programs), -1, np.int32)
    known: dict[int, int] = {}  # begin by identity: to compare constants would take longer than to copy them
    constant_first = 0
    for index, program in enumerate(programs):
        if program is None:
            continue
        if id(program) in known:
            first[index] = known[id(program)]
            continue
        first[index] = known[id(program)] = len(code)
        for instruction in program.instructions:
            words = _checked(instruction, program, numbers, constant_first)
            code.append(numbers[instruction.op] | (len(words) + 1) << LENGTH_SHIFT)
            code += words
        code.append(END)
        constants.append(np.asarray(program.constants, np.float32))
        constant_first += len(program.constants)
    if any(not np.isfinite(values).all() for values in constants):
        raise SceneError("a shader program has a constant that is not a finite number")
    return np.array(code, np.int32), np.concatenate(constants) if constants else np.zeros(0, np.float32), first


def upload_programs(
    programs: Sequence[Program | None],
    features: ProgramFeatures,
    scene: Scene,
    geometry: Geometry,
    images: ImageTable,
    device: wp.Device,
    inputs: InputData | None = None,
    upload: Upload = upload_anew,
) -> NodeData:
    """`programs` and their inputs from `scene`; all arrays are empty where there are no programs.

    `inputs`: those of objects that are no instances. `upload`: copies each array to the device.
    """
    data = NodeData()
    if not features:
        return data
    code, constants, first = encode(programs, features.ops)
    data.code = upload("code", code, int, device)
    data.constants = upload("constants", constants, float, device)
    data.program_first = upload("program_first", first, int, device)
    data.geometry = geometry
    data.images = images
    data.inputs = upload_inputs(scene, features.ops, device) if inputs is None else inputs
    coat = not {"layer_coat", "layer_specular"}.isdisjoint(features.ops)
    film = not {"layer_film", "layer_thin_glass_film"}.isdisjoint(features.ops)
    data.albedo = upload_tables(
        device, reflection=coat, coat=coat, glass=False, sheen="layer_sheen" in features.ops, film=film, upload=upload
    )
    return data


def store_programs(*tables: NodeData, device: wp.Device, upload: Upload = upload_anew) -> list[wp.array]:
    """Write each of `tables` into the device's memory by `upload`, where ops out of line read it; the arrays have to be
    kept.
    """
    kept = []
    for number, table in enumerate(tables):
        kept.append(upload(str(number), bytes_of_struct(table), wp.uint8, device))
        table.stored = kept[-1].ptr
    return kept


def _checked(instruction, program: Program, numbers: dict[str, int], constant_first: int) -> list[int]:
    """Words of `instruction`, with constants counted from the first constant of all programs."""
    if instruction.op not in numbers:
        raise SceneError(f"a shader program has the op {instruction.op!r}, which the scene's features lack")
    op = op_named(instruction.op)
    if len(instruction.words) != len(op.signature):
        raise SceneError(
            f"the op {instruction.op!r} of a shader program has {len(instruction.words)} words instead of "
            f"{len(op.signature)}"
        )
    words = []
    for letter, word in zip(op.signature, instruction.words):
        width = 3 if letter in "vV" else 1
        if (letter in "nv" and word < 0) or letter == "t":
            index = word if letter == "t" else -1 - word
            good = 0 <= index <= len(program.constants) - width
            word = index + constant_first if letter == "t" else word - constant_first
        elif letter in "nvNV":
            good = 0 <= word <= program.register_count - width or (letter not in INPUTS and word == -1)
        else:
            good = -(2**31) <= word < 2**31
        if not good:
            raise SceneError(f"the op {instruction.op!r} of a shader program has an operand out of range")
        words.append(word)
    return words
