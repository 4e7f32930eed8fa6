"""Arithmetic of numbers: one op for all operations, clamping, and the guarded functions that other families share.

Outside its domain a function (division by 0, roots and powers of negatives, logarithms of numbers that are not
positive) gives the value that Blender's renderers give. A result that float32 cannot hold is infinite, as in theirs.
"""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number
from ...point import ShadingPoint

EPSILON = 1.1920929e-07  # float32's at 1: the least distance that COMPARE allows
INTEGER_END = 2147483648.0  # from here on powers of negatives are 0: the exponent's parity is not checked


class MathOperation(IntEnum):
    """Operations of `math` on a, b and c."""

    ADD = 0
    SUBTRACT = 1
    MULTIPLY = 2
    DIVIDE = 3
    MULTIPLY_ADD = 4
    POWER = 5
    LOGARITHM = 6
    SQRT = 7
    INVERSE_SQRT = 8
    ABSOLUTE = 9
    EXPONENT = 10
    MINIMUM = 11
    MAXIMUM = 12
    LESS_THAN = 13
    GREATER_THAN = 14
    SIGN = 15
    COMPARE = 16
    SMOOTH_MIN = 17
    SMOOTH_MAX = 18
    ROUND = 19
    FLOOR = 20
    CEIL = 21
    TRUNC = 22
    FRACT = 23
    MODULO = 24
    FLOORED_MODULO = 25
    WRAP = 26
    SNAP = 27
    PINGPONG = 28
    SINE = 29
    COSINE = 30
    TANGENT = 31
    ARCSINE = 32
    ARCCOSINE = 33
    ARCTANGENT = 34
    ARCTAN2 = 35
    SINH = 36
    COSH = 37
    TANH = 38
    RADIANS = 39
    DEGREES = 40


@wp.func
def lesser(a: float, b: float) -> float:
    """The lesser of two numbers; `b` where one is NaN."""
    if a < b:
        return a
    return b


@wp.func
def greater(a: float, b: float) -> float:
    """The greater of two numbers; `b` where one is NaN."""
    if a > b:
        return a
    return b


@wp.func
def limited(x: float, low: float, high: float) -> float:
    """`x` within [low, high]; `high` where the bounds are the wrong way round, `low` for NaN."""
    return lesser(greater(x, low), high)


@wp.func
def saturated(x: float) -> float:
    """`x` within [0, 1]; 0 for NaN."""
    return lesser(greater(x, 0.0), 1.0)


@wp.func
def fraction(x: float) -> float:
    """`x` less the integer below it."""
    return x - wp.floor(x)


@wp.func
def safe_divide(a: float, b: float) -> float:
    """a / b; 0 where b is 0."""
    if b != 0.0:
        return a / b
    return 0.0


@wp.func
def safe_power(base: float, exponent: float) -> float:
    """Base to the exponent; 0 for a negative base with a fractional exponent, and for 0 to a negative exponent."""
    if base < 0.0 and (wp.trunc(exponent) != exponent or wp.abs(exponent) >= INTEGER_END):
        return 0.0
    if exponent == 0.0:
        return 1.0
    if base == 0.0:
        return 0.0
    return wp.pow(base, exponent)


@wp.func
def safe_logarithm(x: float, base: float) -> float:
    """Logarithm of `x`; 0 where it or that of the base does not exist, and for base 1."""
    if x <= 0.0 or base <= 0.0:
        return 0.0
    return safe_divide(wp.log(x), wp.log(base))


@wp.func
def safe_root(x: float) -> float:
    """Square root; 0 for a negative `x`."""
    return wp.sqrt(greater(x, 0.0))


@wp.func
def sign_of(x: float) -> float:
    """Sign of `x`: -1, 0 or 1."""
    if x == 0.0:
        return 0.0
    if x < 0.0:
        return -1.0
    return 1.0


@wp.func
def wrapped(x: float, high: float, low: float) -> float:
    """`x` moved by whole periods into [low, high); `low` for an empty range."""
    period = high - low
    if period != 0.0:
        return x - period * wp.floor((x - low) / period)
    return low


@wp.func
def ping_pong(x: float, scale: float) -> float:
    """Triangle wave of `x` between 0 and `scale`."""
    if scale != 0.0:
        return wp.abs(fraction((x - scale) / (scale * 2.0)) * scale * 2.0 - scale)
    return 0.0


@wp.func
def smooth_minimum(a: float, b: float, distance: float) -> float:
    """The lesser of `a` and `b`, rounded by a cubic where they are nearer to each other than `distance`."""
    least = wp.min(a, b)
    if distance != 0.0:
        h = wp.max(distance - wp.abs(a - b), 0.0) / distance
        return least - h * h * h * distance * wp.static(1.0 / 6.0)
    return least


@wp.func
def evaluate_rounding(operation: int, a: float, b: float, c: float) -> float:
    """Result of an operation from ROUND to PINGPONG."""
    if operation == MathOperation.ROUND:
        return wp.floor(a + 0.5)
    if operation == MathOperation.FLOOR:
        return wp.floor(a)
    if operation == MathOperation.CEIL:
        return wp.ceil(a)
    if operation == MathOperation.TRUNC:
        return wp.trunc(a)
    if operation == MathOperation.FRACT:
        return fraction(a)
    if operation == MathOperation.MODULO:
        if b != 0.0:
            return wp.mod(a, b)
        return 0.0
    if operation == MathOperation.FLOORED_MODULO:
        if b != 0.0:
            return a - wp.floor(a / b) * b
        return 0.0
    if operation == MathOperation.WRAP:
        return wrapped(a, b, c)
    if operation == MathOperation.SNAP:
        return wp.floor(safe_divide(a, b)) * b
    return ping_pong(a, b)


@wp.func
def evaluate_trigonometry(operation: int, a: float, b: float) -> float:
    """Result of an operation from SINE to DEGREES."""
    if operation == MathOperation.SINE:
        return wp.sin(a)
    if operation == MathOperation.COSINE:
        return wp.cos(a)
    if operation == MathOperation.TANGENT:
        return wp.tan(a)
    if operation == MathOperation.ARCSINE:
        return wp.asin(limited(a, -1.0, 1.0))
    if operation == MathOperation.ARCCOSINE:
        return wp.acos(limited(a, -1.0, 1.0))
    if operation == MathOperation.ARCTANGENT:
        return wp.atan(a)
    if operation == MathOperation.ARCTAN2:
        if a == 0.0 and b == 0.0:
            return 0.0
        return wp.atan2(a, b)
    if operation == MathOperation.SINH:
        return wp.sinh(a)
    if operation == MathOperation.COSH:
        return wp.cosh(a)
    if operation == MathOperation.TANH:
        return wp.tanh(a)
    if operation == MathOperation.RADIANS:
        return a * 0.017453292519943295
    return a * 57.29577951308232


@wp.func
def evaluate_math(operation: int, a: float, b: float, c: float) -> float:
    """Result of a `MathOperation` on a, b and c."""
    if operation >= MathOperation.SINE:
        return evaluate_trigonometry(operation, a, b)
    if operation >= MathOperation.ROUND:
        return evaluate_rounding(operation, a, b, c)
    if operation == MathOperation.ADD:
        return a + b
    if operation == MathOperation.SUBTRACT:
        return a - b
    if operation == MathOperation.MULTIPLY:
        return a * b
    if operation == MathOperation.DIVIDE:
        return safe_divide(a, b)
    if operation == MathOperation.MULTIPLY_ADD:
        return a * b + c
    if operation == MathOperation.POWER:
        return safe_power(a, b)
    if operation == MathOperation.LOGARITHM:
        return safe_logarithm(a, b)
    if operation == MathOperation.SQRT:
        return safe_root(a)
    if operation == MathOperation.INVERSE_SQRT:
        if a > 0.0:
            return 1.0 / wp.sqrt(a)
        return 0.0
    if operation == MathOperation.ABSOLUTE:
        return wp.abs(a)
    if operation == MathOperation.EXPONENT:
        return wp.exp(a)
    if operation == MathOperation.MINIMUM:
        return wp.min(a, b)
    if operation == MathOperation.MAXIMUM:
        return wp.max(a, b)
    if operation == MathOperation.LESS_THAN:
        if a < b:
            return 1.0
        return 0.0
    if operation == MathOperation.GREATER_THAN:
        if a > b:
            return 1.0
        return 0.0
    if operation == MathOperation.SIGN:
        return sign_of(a)
    if operation == MathOperation.COMPARE:
        if a == b or wp.abs(a - b) <= wp.max(c, EPSILON):
            return 1.0
        return 0.0
    if operation == MathOperation.SMOOTH_MIN:
        return smooth_minimum(a, b, c)
    return -smooth_minimum(-a, -b, c)


@wp.func
def evaluate_clamp(ordered: int, x: float, low: float, high: float) -> float:
    """`x` within [low, high]; where `ordered` is 1, the bounds may be the wrong way round."""
    if ordered == 1 and low > high:
        return limited(x, high, low)
    return limited(x, low, high)


@op("math", "iinnn>N")
@wp.func
def math_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Operation, whether the result is clamped to [0, 1] (0, 1), a, b, c > result."""
    a = number(data, stack, pc + 3)
    b = number(data, stack, pc + 4)
    c = number(data, stack, pc + 5)
    result = evaluate_math(data.code[pc + 1], a, b, c)
    if data.code[pc + 2] == 1:
        result = saturated(result)
    put_number(data, stack, pc + 6, result)


@op("clamp", "innn>N")
@wp.func
def clamp_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Whether bounds are put in order (0, 1), number, least, greatest > result."""
    x = number(data, stack, pc + 2)
    low = number(data, stack, pc + 3)
    high = number(data, stack, pc + 4)
    put_number(data, stack, pc + 5, evaluate_clamp(data.code[pc + 1], x, low, high))
