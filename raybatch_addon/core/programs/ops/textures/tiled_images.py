"""Image textures whose pictures may be in tiles: their look-up, and what tiles that needs.

Programs with these ops come of `programs/tiling.py`. An op that wants tiles stands before each look-up in a part of the
program that runs before the program itself: then nothing is shaded before all tiles are there.
"""

import warp as wp

from ....shading.images.tiled.look_up import sample_tiled, want_tiles
from ...op import NodeData, number, op, put_number, vector
from ...point import ShadingPoint
from .image import box_uv, box_weights, projected_uv, put_texel


@op("tiled_image", "miiiiinv>VN", foldable=False, general=False)
@wp.func
def tiled_image(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture at a level, colour and alpha.

    Operands: those of `image`, with the level before the coordinates, and before it whether its tiles were fetched.
    """
    image_uv = projected_uv(vector(data, stack, pc + 8), data.code[pc + 4])
    value = sample_tiled(
        data.images,
        data.code[pc + 1],
        int(number(data, stack, pc + 7)),
        image_uv,
        data.code[pc + 2],
        data.code[pc + 3],
        data.code[pc + 5],
        data.code[pc + 6],
    )
    put_texel(data, stack, pc + 9, value)


@op("tiled_image_box", "miiiinnvv>VN", foldable=False, general=False)
@wp.func
def tiled_image_box(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture with box projection at a level, colour and alpha.

    Operands: those of `image_box`, with the level before the coordinates, and before the blend whether its tiles were
    fetched.
    """
    p = vector(data, stack, pc + 8)
    normal = vector(data, stack, pc + 9)
    weights = box_weights(normal, number(data, stack, pc + 6))
    level = int(number(data, stack, pc + 7))
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    axis = int(0)
    while axis < 3:  # a loop that is not unrolled, so that the look-up is compiled once
        if weights[axis] > 0.0:
            total += weights[axis] * sample_tiled(
                data.images,
                data.code[pc + 1],
                level,
                box_uv(axis, p, normal),
                data.code[pc + 2],
                data.code[pc + 3],
                data.code[pc + 4],
                data.code[pc + 5],
            )
        axis += 1
    put_texel(data, stack, pc + 10, total)


@op("tiled_want", "miiiinvnn>N", foldable=False, general=False)
@wp.func
def tiled_want(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The tiles that `tiled_image` needs: how many tiles are missing so far.

    Operands: image, `Interpolation`, `Extension`, `Projection`, whether the coordinates depend on other look-ups,
    level, coordinates, what to do (`tiled/look_up.py`), how many were missing before. Where coordinates are not known
    yet nothing is asked for.
    """
    missing = number(data, stack, pc + 9)
    if data.code[pc + 5] == 0 or missing == 0.0:
        missing += float(
            want_tiles(
                data.images,
                data.code[pc + 1],
                int(number(data, stack, pc + 6)),
                projected_uv(vector(data, stack, pc + 7), data.code[pc + 4]),
                data.code[pc + 2],
                data.code[pc + 3],
                int(number(data, stack, pc + 8)),
            )
        )
    put_number(data, stack, pc + 10, missing)


@op("tiled_want_box", "miiinnvvnn>N", foldable=False, general=False)
@wp.func
def tiled_want_box(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The tiles that `tiled_image_box` needs: how many tiles are missing so far.

    Operands: image, `Interpolation`, `Extension`, whether coordinates or normal depend on other look-ups, blend, level,
    coordinates, normal in object space, what to do, how many were missing before.
    """
    missing = number(data, stack, pc + 10)
    if data.code[pc + 4] == 0 or missing == 0.0:
        p = vector(data, stack, pc + 7)
        normal = vector(data, stack, pc + 8)
        weights = box_weights(normal, number(data, stack, pc + 5))
        axis = int(0)
        while axis < 3:
            if weights[axis] > 0.0:
                missing += float(
                    want_tiles(
                        data.images,
                        data.code[pc + 1],
                        int(number(data, stack, pc + 6)),
                        box_uv(axis, p, normal),
                        data.code[pc + 2],
                        data.code[pc + 3],
                        int(number(data, stack, pc + 9)),
                    )
                )
            axis += 1
    put_number(data, stack, pc + 11, missing)
