"""Rows of bricks in mortar, each brick of its own tint."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector, wanted
from ...point import ShadingPoint
from ..values.finite import finite_or_zero, finite_vector_or_zero
from .hashing import LOW_31, UNIT_31
from .perlin import floor_to_int, sum_with_product


@wp.struct
class Wall:
    """Layout of bricks; lengths in units of the texture's space."""

    width: float  # width of a brick, without squash
    row_height: float
    mortar_size: float  # distance from a brick's edge to the end of its mortar
    mortar_smooth: float  # part of the mortar over which it fades in from the inside; 0: it does not fade
    bias: float  # added to tints
    offset: float  # shift of rows, in widths of a brick, ...
    offset_frequency: int  # ... in every row whose number is a multiple of this; at least 1
    squash: float  # factor of the width of bricks ...
    squash_frequency: int  # ... in every row whose number is a multiple of this; at least 1


@wp.func
def _tint_of(brick: int, row: int) -> float:
    """Tint of a brick in [0, 1]: an old integer noise (three multiplications) over the lower halves of both numbers."""
    n = (wp.uint32(row) << wp.uint32(16)) + (wp.uint32(brick) & wp.uint32(0xFFFF))
    n = (n + wp.uint32(1013)) & LOW_31
    n = n ^ (n >> wp.uint32(13))
    n = (n * (n * n * wp.uint32(60493) + wp.uint32(19990303)) + wp.uint32(1376312589)) & LOW_31
    return wp.float32(n) * UNIT_31


@wp.func
def _smooth_step(t: float) -> float:
    s = wp.clamp(t, 0.0, 1.0)
    return 3.0 * s * s - 2.0 * s * s * s


@wp.func
def _lesser(a: float, b: float) -> float:
    """The lesser number; `b` where either is NaN, as a brick without width makes it."""
    return wp.where(a < b, a, b)


@wp.func
def brick(p: wp.vec3, wall: Wall) -> wp.vec2:
    """Tint of the brick at `p`, and share of mortar there, both in [0, 1]."""
    row = floor_to_int(p[1] / wall.row_height)
    width = wall.width
    shift = float(0.0)
    if wall.offset_frequency != 0 and wall.squash_frequency != 0:
        if row % wall.squash_frequency == 0:
            width *= wall.squash
        if row % wall.offset_frequency == 0:
            shift = width * wall.offset
    columns = wp.floor((p[0] + shift) / width)
    x = sum_with_product(p[0] + shift, -width, columns)
    y = sum_with_product(p[1], -wall.row_height, wp.floor(p[1] / wall.row_height))
    tint = wp.clamp(_tint_of(floor_to_int(columns), row) + finite_or_zero(wall.bias), 0.0, 1.0)
    edge = _lesser(_lesser(x, y), _lesser(width - x, wall.row_height - y))
    if edge >= wall.mortar_size:
        return wp.vec2(tint, 0.0)
    if wall.mortar_smooth == 0.0:
        return wp.vec2(tint, 1.0)
    return wp.vec2(tint, finite_or_zero(_smooth_step((1.0 - edge / wall.mortar_size) / wall.mortar_smooth)))


@op("brick", "vvvvnnnnnnnini>NV", foldable=False)
@wp.func
def brick_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Brick texture, share of mortar and colour.

    Operands: vector, three colours (bricks of tint 0, of tint 1, mortar), scale, mortar size and smooth, bias, width,
    row height, offset and its frequency, squash and its frequency.
    """
    scale = number(data, stack, pc + 5)
    wall = Wall()
    wall.mortar_size = number(data, stack, pc + 6)
    wall.mortar_smooth = number(data, stack, pc + 7)
    wall.bias = number(data, stack, pc + 8)
    wall.width = number(data, stack, pc + 9)
    wall.row_height = number(data, stack, pc + 10)
    wall.offset = number(data, stack, pc + 11)
    wall.offset_frequency = data.code[pc + 12]
    wall.squash = number(data, stack, pc + 13)
    wall.squash_frequency = data.code[pc + 14]
    found = brick(vector(data, stack, pc + 1) * scale, wall)
    mortar = found[1]
    put_number(data, stack, pc + 15, mortar)
    if wanted(data, pc + 16):
        color = vector(data, stack, pc + 2)
        if mortar != 1.0:
            color = (1.0 - found[0]) * color + found[0] * vector(data, stack, pc + 3)
        put_vector(
            data, stack, pc + 16, finite_vector_or_zero(color * (1.0 - mortar) + vector(data, stack, pc + 4) * mortar)
        )
