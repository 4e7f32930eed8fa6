"""Vectors from one space to another: the world's, the object's and the camera's, which looks along +Z."""

from enum import IntEnum

import warp as wp

from ....scene.geometry import mat34, transform_point, transform_vector
from ...object_space import object_to_world, world_to_object
from ...op import NodeData, op, put_vector, vector
from ...point import ShadingPoint
from .vector_math import safe_normalize


class Space(IntEnum):
    """Space of a vector."""

    WORLD = 0
    OBJECT = 1
    CAMERA = 2


class VectorKind(IntEnum):
    """Kind of a vector that is transformed."""

    POINT = 0
    VECTOR = 1
    NORMAL = 2


@wp.func
def transposed_vector(m: mat34, v: wp.vec3) -> wp.vec3:
    """`v` under the transpose of the linear part of `m`."""
    return wp.vec3(
        m[0, 0] * v[0] + m[1, 0] * v[1] + m[2, 0] * v[2],
        m[0, 1] * v[0] + m[1, 1] * v[1] + m[2, 1] * v[2],
        m[0, 2] * v[0] + m[1, 2] * v[1] + m[2, 2] * v[2],
    )


@wp.func
def transformed(kind: int, forth: mat34, back: mat34, v: wp.vec3) -> wp.vec3:
    """`v`, a `VectorKind`, under the affine map `forth`, of which `back` is the inverse.

    Normals come out with length 1, or 0.
    """
    if kind == VectorKind.NORMAL:
        return safe_normalize(transposed_vector(back, v))
    if kind == VectorKind.VECTOR:
        return transform_vector(forth, v)
    return transform_point(forth, v)


@wp.func
def camera_to_world(to_camera: mat34) -> mat34:
    """The inverse of `to_camera`, which only turns and moves."""
    t = wp.vec3(to_camera[0, 3], to_camera[1, 3], to_camera[2, 3])
    origin = -transposed_vector(to_camera, t)
    return mat34(
        to_camera[0, 0],
        to_camera[1, 0],
        to_camera[2, 0],
        origin[0],
        to_camera[0, 1],
        to_camera[1, 1],
        to_camera[2, 1],
        origin[1],
        to_camera[0, 2],
        to_camera[1, 2],
        to_camera[2, 2],
        origin[2],
    )


@op("vector_transform", "iiiv>V", foldable=False)
@wp.func
def vector_transform(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Vector transform: kind, space of the vector, space of the result, vector > vector.

    Where there is no object, its space is the world's.
    """
    kind = data.code[pc + 1]
    source = data.code[pc + 2]
    target = data.code[pc + 3]
    v = vector(data, stack, pc + 4)
    if source != target:
        if source == Space.OBJECT and point.instance >= 0:
            v = transformed(kind, object_to_world(data, point), world_to_object(data, point), v)
        if source == Space.CAMERA:
            v = transformed(kind, camera_to_world(data.inputs.to_camera), data.inputs.to_camera, v)
        if target == Space.OBJECT and point.instance >= 0:
            v = transformed(kind, world_to_object(data, point), object_to_world(data, point), v)
        if target == Space.CAMERA:
            v = transformed(kind, data.inputs.to_camera, camera_to_world(data.inputs.to_camera), v)
    put_vector(data, stack, pc + 5, v)
