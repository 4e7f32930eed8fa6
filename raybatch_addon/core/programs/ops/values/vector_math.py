"""Arithmetic of vectors: one op for all operations."""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .math import fraction, greater, lesser, safe_divide, safe_power, sign_of


class VectorOperation(IntEnum):
    """Operations of `vector_math` on vectors a, b and c and a scale; from DOT_PRODUCT on they give a number."""

    ADD = 0
    SUBTRACT = 1
    MULTIPLY = 2
    DIVIDE = 3
    MULTIPLY_ADD = 4
    CROSS_PRODUCT = 5
    PROJECT = 6
    REFLECT = 7
    REFRACT = 8
    FACEFORWARD = 9
    SCALE = 10
    NORMALIZE = 11
    ABSOLUTE = 12
    POWER = 13
    SIGN = 14
    MINIMUM = 15
    MAXIMUM = 16
    ROUND = 17
    FLOOR = 18
    CEIL = 19
    FRACTION = 20
    MODULO = 21
    WRAP = 22
    SNAP = 23
    SINE = 24
    COSINE = 25
    TANGENT = 26
    DOT_PRODUCT = 27
    DISTANCE = 28
    LENGTH = 29


@wp.func
def safe_normalize(a: wp.vec3) -> wp.vec3:
    """`a` with length 1; the zero vector stays."""
    length = wp.length(a)
    if length != 0.0:
        return a * (1.0 / length)
    return a


@wp.func
def divided(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """a / b by component; 0 where b is 0."""
    return wp.vec3(safe_divide(a[0], b[0]), safe_divide(a[1], b[1]), safe_divide(a[2], b[2]))


@wp.func
def _refracted(incident: wp.vec3, normal: wp.vec3, ratio: float) -> wp.vec3:
    cosine = wp.dot(normal, incident)
    squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if squared < 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    return ratio * incident - (ratio * cosine + wp.sqrt(squared)) * normal


@wp.func
def _component(operation: int, a: float, b: float, c: float) -> float:
    if operation == VectorOperation.ABSOLUTE:
        return wp.abs(a)
    if operation == VectorOperation.POWER:
        return safe_power(a, b)
    if operation == VectorOperation.SIGN:
        return sign_of(a)
    if operation == VectorOperation.MINIMUM:
        return lesser(a, b)
    if operation == VectorOperation.MAXIMUM:
        return greater(a, b)
    if operation == VectorOperation.ROUND:
        return wp.floor(a + 0.5)
    if operation == VectorOperation.FLOOR:
        return wp.floor(a)
    if operation == VectorOperation.CEIL:
        return wp.ceil(a)
    if operation == VectorOperation.FRACTION:
        return fraction(a)
    if operation == VectorOperation.MODULO:
        if b != 0.0:
            return a - wp.trunc(a / b) * b
        return 0.0
    if operation == VectorOperation.WRAP:
        period = b - c
        if period != 0.0:
            return (a - c) - wp.floor((a - c) / period) * period + c
        return c
    if operation == VectorOperation.SNAP:
        return wp.floor(safe_divide(a, b)) * b
    if operation == VectorOperation.SINE:
        return wp.sin(a)
    if operation == VectorOperation.COSINE:
        return wp.cos(a)
    return wp.tan(a)


@wp.func
def evaluate_vector_math(operation: int, a: wp.vec3, b: wp.vec3, c: wp.vec3, scale: float) -> wp.vec3:
    """Result of a `VectorOperation` that gives a vector; 0 for one that gives a number."""
    result = wp.vec3(0.0, 0.0, 0.0)
    if operation >= VectorOperation.ABSOLUTE and operation <= VectorOperation.TANGENT:
        # a loop that Warp does not unroll keeps one copy of the long list of operations in the kernel
        count = int(3)
        for i in range(count):
            result[i] = _component(operation, a[i], b[i], c[i])
        return result
    if operation == VectorOperation.ADD:
        return a + b
    if operation == VectorOperation.SUBTRACT:
        return a - b
    if operation == VectorOperation.MULTIPLY:
        return wp.cw_mul(a, b)
    if operation == VectorOperation.DIVIDE:
        return divided(a, b)
    if operation == VectorOperation.MULTIPLY_ADD:
        return wp.cw_mul(a, b) + c
    if operation == VectorOperation.CROSS_PRODUCT:
        return wp.cross(a, b)
    if operation == VectorOperation.PROJECT:
        squared = wp.dot(b, b)
        if squared != 0.0:
            return (wp.dot(a, b) / squared) * b
        return result
    if operation == VectorOperation.REFLECT:
        normal = safe_normalize(b)
        return a - 2.0 * wp.dot(a, normal) * normal
    if operation == VectorOperation.REFRACT:
        return _refracted(a, safe_normalize(b), scale)
    if operation == VectorOperation.FACEFORWARD:
        if wp.dot(c, b) < 0.0:
            return a
        return -a
    if operation == VectorOperation.SCALE:
        return a * scale
    if operation == VectorOperation.NORMALIZE:
        return safe_normalize(a)
    return result


@wp.func
def evaluate_vector_measure(operation: int, a: wp.vec3, b: wp.vec3) -> float:
    """Result of a `VectorOperation` that gives a number; 0 for one that gives a vector."""
    if operation == VectorOperation.DOT_PRODUCT:
        return wp.dot(a, b)
    if operation == VectorOperation.DISTANCE:
        return wp.length(a - b)
    if operation == VectorOperation.LENGTH:
        return wp.length(a)
    return 0.0


@op("vector_math", "ivvvn>VN")
@wp.func
def vector_math_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Operation, a, b, c, scale > vector, number."""
    operation = data.code[pc + 1]
    a = vector(data, stack, pc + 2)
    b = vector(data, stack, pc + 3)
    c = vector(data, stack, pc + 4)
    scale = number(data, stack, pc + 5)
    if operation >= VectorOperation.DOT_PRODUCT:
        put_vector(data, stack, pc + 6, wp.vec3(0.0, 0.0, 0.0))
        put_number(data, stack, pc + 7, evaluate_vector_measure(operation, a, b))
    else:
        put_vector(data, stack, pc + 6, evaluate_vector_math(operation, a, b, c, scale))
        put_number(data, stack, pc + 7, 0.0)
