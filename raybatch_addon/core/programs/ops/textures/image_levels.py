"""Image textures that are filtered over footprints of paths: the level of an image, and its look-up there.

Programs with these ops come of `programs/footprints.py`. Their first registers are set before they run: how large the
path's footprint is, and a random number. Where nothing sets them, as where light is aimed at, the level is 0: the image
itself.
"""

import warp as wp

from ....shading.images.textures import footprint_level, sample_level
from ...op import NodeData, number, op, put_number, vector
from ...point import ShadingPoint
from .image import Projection, make_box_texel, projected_uv, put_texel

# Registers that are set before a program runs
FOOTPRINT = 0  # area of the footprint on the surface, in areas of the parallelogram of the point's two steps
CHANCE = 1  # random in [0, 1), keyed by the path's vertex: which of two levels
REGISTERS = 2
# `Projection` of op `image_level` for images with box projection
BOX = 3

_box_texel = make_box_texel(at_level=True)
_FLAT = wp.constant(int(Projection.FLAT))


@wp.func
def _change(before: wp.vec2, behind: wp.vec2, projection: int) -> wp.vec2:
    """How far image coordinates change by a step; where they go around an axis, the shorter way."""
    across = behind[0] - before[0]
    if projection != _FLAT:
        across = across - wp.rint(across)
    return wp.vec2(across, behind[1] - before[1])


@op("image_level", "minvvv>N", foldable=False, general=False)
@wp.func
def image_level(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Level of an image whose texels have the area of the path's footprint.

    Operands: image, `Projection` or BOX, squared width that is asked for, coordinates at the point and one step aside
    along either axis.
    """
    level = int(0)
    if stack[wp.static(FOOTPRINT)] > 0.0:
        p = vector(data, stack, pc + 4)
        p_x = vector(data, stack, pc + 5)
        p_y = vector(data, stack, pc + 6)
        projection = data.code[pc + 2]
        image_uv = wp.vec2(p[0], p[1])
        area = wp.length(wp.cross(p_x - p, p_y - p))  # along whichever axis the image is seen
        if projection != wp.static(BOX):
            image_uv = projected_uv(p, projection)
            d_x = _change(image_uv, projected_uv(p_x, projection), projection)
            d_y = _change(image_uv, projected_uv(p_y, projection), projection)
            area = wp.abs(d_x[0] * d_y[1] - d_x[1] * d_y[0])
        area = area * stack[wp.static(FOOTPRINT)] * number(data, stack, pc + 3)
        level = footprint_level(data.images, data.code[pc + 1], image_uv, area, stack[wp.static(CHANCE)])
    put_number(data, stack, pc + 7, float(level))


@op("image_at", "miiiinv>VN", foldable=False, general=False)
@wp.func
def image_at(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture at a level, colour and alpha.

    Operands: those of `image`, with the level before the coordinates.
    """
    image_uv = projected_uv(vector(data, stack, pc + 7), data.code[pc + 4])
    level = int(number(data, stack, pc + 6))
    value = sample_level(
        data.images, data.code[pc + 1], level, image_uv, data.code[pc + 2], data.code[pc + 3], data.code[pc + 5]
    )
    put_texel(data, stack, pc + 8, value)


@op("image_box_at", "miiinnvv>VN", foldable=False, general=False)
@wp.func
def image_box_at(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Image texture with box projection at a level, colour and alpha.

    Operands: those of `image_box`, with the level before the coordinates.
    """
    level = int(number(data, stack, pc + 6))
    put_texel(data, stack, pc + 9, _box_texel(data, stack, pc, pc + 7, level))
