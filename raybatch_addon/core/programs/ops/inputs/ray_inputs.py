"""Inputs that rays find: how much of its surroundings a point sees, and the normals of edges that are rounded.

A program does not trace. Where it runs at a surface that a path met, it is given answers (`programs/requests.py`): the
registers from `first` on hold how many are known, then the request that comes next, then the answers. The requests of a
program are numbered in its order, so that one may depend on the answers before it. Where nobody answers, as where light
is aimed at or a shadow ray passes, nothing is occluded and no edge is round, as in Cycles.
"""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint

# Registers, counted from the first: answers that are known; of the request that is asked for its `RequestBits`, normal
# and distance; and the answers, three numbers each
KNOWN, ASKED, NORMAL, DISTANCE, ANSWERS = 0, 1, 2, 5, 6
# Bits of a request; the number of its samples is above them
ROUNDED, INSIDE, ONLY_LOCAL, SAMPLES_SHIFT = 1, 2, 4, 3


@wp.func
def _is_answered(data: NodeData, stack: wp.array(dtype=float), pc: int) -> bool:
    """Whether the answer is known. The first request of which it is not is written down."""
    first = data.code[pc + 4]
    if first < 0:
        return False
    index = data.code[pc + 5]
    known = int(stack[first])
    if index == known:
        normal = vector(data, stack, pc + 1)
        stack[first + ASKED] = float(data.code[pc + 3])
        stack[first + NORMAL] = normal[0]
        stack[first + NORMAL + 1] = normal[1]
        stack[first + NORMAL + 2] = normal[2]
        stack[first + DISTANCE] = number(data, stack, pc + 2)
    return index < known


@wp.func
def _answer(data: NodeData, stack: wp.array(dtype=float), pc: int) -> wp.vec3:
    at = data.code[pc + 4] + ANSWERS + 3 * data.code[pc + 5]
    return wp.vec3(stack[at], stack[at + 1], stack[at + 2])


@op("ambient_occlusion", "vniii>N", foldable=False)
@wp.func
def ambient_occlusion(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Share of the half-space about a normal in which nothing is nearer than a distance [m], weighed by the cosine;
    then bits, and the first register and the number of the request.
    """
    seen = float(1.0)
    if _is_answered(data, stack, pc):
        seen = _answer(data, stack, pc)[0]
    put_number(data, stack, pc + 6, seen)


@op("bevel", "vniii>V", foldable=False)
@wp.func
def bevel(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Mean normal of the object's surface within a radius [m]; where that is none, the normal that is given. Operands
    as of `ambient_occlusion`.
    """
    normal = vector(data, stack, pc + 1)
    if _is_answered(data, stack, pc):
        found = _answer(data, stack, pc)
        if wp.dot(found, found) > 0.0:
            normal = found
    put_vector(data, stack, pc + 6, normal)
