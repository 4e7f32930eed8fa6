"""White noise: a hash of the coordinates' bits."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector, wanted
from ...point import ShadingPoint
from .hashing import (
    hash_1_to_1,
    hash_1_to_3,
    hash_2_to_1,
    hash_2_to_3,
    hash_3_to_1,
    hash_3_to_3,
    hash_4_to_1,
    hash_4_to_3,
)


@wp.func
def white_noise(dimensions: int, v: wp.vec3, w: float) -> float:
    """A number in [0, 1] for `w` (1 dimension), x and y of `v` (2), `v` (3) or both (4)."""
    if dimensions == 1:
        return hash_1_to_1(w)
    if dimensions == 2:
        return hash_2_to_1(v[0], v[1])
    if dimensions == 3:
        return hash_3_to_1(v[0], v[1], v[2])
    return hash_4_to_1(v[0], v[1], v[2], w)


@wp.func
def white_noise_color(dimensions: int, v: wp.vec3, w: float) -> wp.vec3:
    """Three numbers as those of `white_noise`; the first is the same."""
    if dimensions == 1:
        return hash_1_to_3(w)
    if dimensions == 2:
        return hash_2_to_3(v[0], v[1])
    if dimensions == 3:
        return hash_3_to_3(v[0], v[1], v[2])
    return hash_4_to_3(v[0], v[1], v[2], w)


@op("white_noise", "ivn>NV", foldable=False)
@wp.func
def white_noise_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Value and colour of white noise; the immediate is the number of dimensions."""
    dimensions = data.code[pc + 1]
    v = vector(data, stack, pc + 2)
    w = number(data, stack, pc + 3)
    if wanted(data, pc + 5):
        color = white_noise_color(dimensions, v, w)
        put_vector(data, stack, pc + 5, color)
        put_number(data, stack, pc + 4, color[0])
    else:
        put_number(data, stack, pc + 4, white_noise(dimensions, v, w))
