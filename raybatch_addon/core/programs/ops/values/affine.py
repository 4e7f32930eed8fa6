"""Affine maps of vectors."""

import warp as wp

from ...op import NodeData, op, put_vector, vector
from ...point import ShadingPoint
from .finite import finite_vector_or_zero


@wp.func
def affine(v: wp.vec3, x: wp.vec3, y: wp.vec3, z: wp.vec3, offset: wp.vec3, to_unit: int) -> wp.vec3:
    """The matrix of rows `x`, `y` and `z` times `v`, plus `offset`; finite.

    Where `to_unit` is 1 the result is a unit vector; 0 stays 0.
    """
    mapped = finite_vector_or_zero(wp.vec3(wp.dot(x, v), wp.dot(y, v), wp.dot(z, v)) + offset)
    length = wp.length(mapped)
    if to_unit == 1 and length > 0.0:
        return finite_vector_or_zero(mapped / length)
    return mapped


@op("affine", "ivvvvv>V")
@wp.func
def affine_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Affine map: to unit or not, vector, three rows, offset."""
    rows = pc + 3
    mapped = affine(
        vector(data, stack, pc + 2),
        vector(data, stack, rows),
        vector(data, stack, rows + 1),
        vector(data, stack, rows + 2),
        vector(data, stack, rows + 3),
        data.code[pc + 1],
    )
    put_vector(data, stack, pc + 7, mapped)
