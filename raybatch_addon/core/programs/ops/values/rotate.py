"""Rotations of vectors around axes, and the mapping of coordinates."""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .vector_math import divided, safe_normalize


class MappingKind(IntEnum):
    """Kind of vector that is mapped."""

    POINT = 0
    TEXTURE = 1  # the inverse of POINT
    VECTOR = 2
    NORMAL = 3


class RotationKind(IntEnum):
    """Axis that a vector is rotated around."""

    AXIS_ANGLE = 0
    X_AXIS = 1
    Y_AXIS = 2
    Z_AXIS = 3
    EULER_XYZ = 4


@wp.func
def euler_matrix(angles: wp.vec3) -> wp.mat33:
    """Rotation around x, then y, then z by `angles` [rad]."""
    cx = wp.cos(angles[0])
    cy = wp.cos(angles[1])
    cz = wp.cos(angles[2])
    sx = wp.sin(angles[0])
    sy = wp.sin(angles[1])
    sz = wp.sin(angles[2])
    return wp.mat33(
        cy * cz,
        sy * sx * cz - cx * sz,
        sy * cx * cz + sx * sz,
        cy * sz,
        sy * sx * sz + cx * cz,
        sy * cx * sz - sx * cz,
        -sy,
        cy * sx,
        cy * cx,
    )


@wp.func
def map_vector(kind: int, v: wp.vec3, location: wp.vec3, rotation: wp.vec3, scale: wp.vec3) -> wp.vec3:
    """`v` scaled, rotated and moved as a `MappingKind` asks; 0 where it is divided by a scale of 0."""
    matrix = euler_matrix(rotation)
    if kind == MappingKind.TEXTURE:
        return divided(wp.transpose(matrix) * (v - location), scale)
    if kind == MappingKind.NORMAL:
        return safe_normalize(matrix * divided(v, scale))
    result = matrix * wp.cw_mul(v, scale)
    if kind == MappingKind.POINT:
        result = result + location
    return result


@wp.func
def rotated_around(v: wp.vec3, axis: wp.vec3, angle: float) -> wp.vec3:
    """`v` turned by `angle` [rad] around the unit vector `axis`."""
    c = wp.cos(angle)
    return v * c + wp.cross(axis, v) * wp.sin(angle) + axis * (wp.dot(axis, v) * (1.0 - c))


@wp.func
def rotate_vector(
    kind: int, invert: int, v: wp.vec3, center: wp.vec3, axis: wp.vec3, angle: float, rotation: wp.vec3
) -> wp.vec3:
    """`v` turned around `center` as a `RotationKind` says, backwards where `invert` is 1.

    It is unchanged for an axis without length.
    """
    if kind == RotationKind.EULER_XYZ:
        matrix = euler_matrix(rotation)
        if invert == 1:
            matrix = wp.transpose(matrix)
        return matrix * (v - center) + center
    around = axis
    if kind == RotationKind.X_AXIS:
        around = wp.vec3(1.0, 0.0, 0.0)
    if kind == RotationKind.Y_AXIS:
        around = wp.vec3(0.0, 1.0, 0.0)
    if kind == RotationKind.Z_AXIS:
        around = wp.vec3(0.0, 0.0, 1.0)
    length = wp.length(around)
    if length == 0.0:
        return v
    if invert == 1:
        angle = -angle
    return rotated_around(v - center, around / length, angle) + center


@op("mapping", "ivvvv>V")
@wp.func
def mapping(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Kind, vector, location, rotation [rad], scale > vector."""
    v = vector(data, stack, pc + 2)
    location = vector(data, stack, pc + 3)
    rotation = vector(data, stack, pc + 4)
    put_vector(data, stack, pc + 6, map_vector(data.code[pc + 1], v, location, rotation, vector(data, stack, pc + 5)))


@op("vector_rotate", "iivvvnv>V")
@wp.func
def vector_rotate(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Kind, whether backwards, vector, center, axis, angle [rad], Euler angles [rad] > vector."""
    v = vector(data, stack, pc + 3)
    center = vector(data, stack, pc + 4)
    axis = vector(data, stack, pc + 5)
    angle = number(data, stack, pc + 6)
    rotation = vector(data, stack, pc + 7)
    put_vector(
        data, stack, pc + 8, rotate_vector(data.code[pc + 1], data.code[pc + 2], v, center, axis, angle, rotation)
    )


@op("normal", "vv>VN")
@wp.func
def normal(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Direction, normal > unit direction, cosine between both; 0 where one has no length."""
    direction = safe_normalize(vector(data, stack, pc + 1))
    cosine = wp.dot(direction, safe_normalize(vector(data, stack, pc + 2)))
    put_vector(data, stack, pc + 3, direction)
    put_number(data, stack, pc + 4, cosine)
