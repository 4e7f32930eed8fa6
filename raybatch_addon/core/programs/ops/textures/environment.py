"""Environment textures: image coordinates of directions."""

from enum import IntEnum

import warp as wp

from ....float32 import PI
from ....shading.images.textures import Extension, sample_image
from ...op import NodeData, op, put_number, put_vector, vector
from ...point import ShadingPoint


class EnvironmentProjection(IntEnum):
    """Projection of all directions to an image (op `environment`)."""

    EQUIRECTANGULAR = 0
    MIRROR_BALL = 1


_MIRROR_BALL = wp.constant(int(EnvironmentProjection.MIRROR_BALL))
_REPEAT = wp.constant(int(Extension.REPEAT))


@wp.func
def equirectangular_uv(direction: wp.vec3) -> wp.vec2:
    """Image coordinates of a unit direction: longitude to the right, +x in the middle, latitude upwards."""
    u = 0.5 - wp.atan2(direction[1], direction[0]) * wp.static(0.5 / PI)
    level = wp.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    v = 0.5 + wp.atan2(direction[2], level) * wp.static(1.0 / PI)
    return wp.vec2(u, v)


@wp.func
def mirror_ball_uv(direction: wp.vec3) -> wp.vec2:
    """Image coordinates of a unit direction, in the picture of a mirror ball that is looked at along +y.

    The ball's normal there is halfway to the direction.
    """
    x = direction[0]
    y = direction[1] - 1.0
    z = direction[2]
    length = 2.0 * wp.sqrt(wp.max(-0.5 * y, 0.0))
    if length > 0.0:
        x = x / length
        z = z / length
    return wp.vec2(0.5 * (x + 1.0), 0.5 * (z + 1.0))


@op("environment", "miiiv>VN", foldable=False)
@wp.func
def environment(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Environment texture, colour and alpha.

    Operands: image, `Interpolation`, `EnvironmentProjection`, whether alpha is divided out, direction.
    """
    direction = vector(data, stack, pc + 5)
    length = wp.length(direction)
    if length > 0.0 and wp.isfinite(length):
        direction = direction / length
    else:
        direction = wp.vec3(0.0, 0.0, 0.0)
    image_uv = equirectangular_uv(direction)
    if data.code[pc + 3] == _MIRROR_BALL:
        image_uv = mirror_ball_uv(direction)
    value = sample_image(data.images, data.code[pc + 1], image_uv, data.code[pc + 2], _REPEAT, data.code[pc + 4])
    put_vector(data, stack, pc + 6, wp.vec3(value[0], value[1], value[2]))
    put_number(data, stack, pc + 7, value[3])
