"""Curves, baked to tables over the range between their outermost points."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .math import safe_divide
from .tables import read_table

CURVE_SIZE = 257  # entries, 1/256 of the range apart


@op("curves", "invnnt>V")
@wp.func
def curves(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Curves of three components.

    Operands: whether curves go on straight beyond their ends, factor, colour or vector, begin, end, table > the same
    kind. The table has CURVE_SIZE entries of three numbers, one of each curve.
    """
    extrapolate = data.code[pc + 1]
    factor = number(data, stack, pc + 2)
    v = vector(data, stack, pc + 3)
    low = number(data, stack, pc + 4)
    span = number(data, stack, pc + 5) - low
    first = data.code[pc + 6]
    result = wp.vec3(0.0, 0.0, 0.0)
    count = int(3)
    for i in range(count):
        curved = read_table(data.constants, first + i, 3, CURVE_SIZE, safe_divide(v[i] - low, span), 1, extrapolate)
        result[i] = (1.0 - factor) * v[i] + factor * curved
    put_vector(data, stack, pc + 7, result)


@op("float_curve", "innnnt>N")
@wp.func
def float_curve(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Curve of a number.

    Operands: whether the curve goes on straight beyond its ends, factor, number, begin, end, table > number.
    """
    factor = number(data, stack, pc + 2)
    x = number(data, stack, pc + 3)
    low = number(data, stack, pc + 4)
    span = number(data, stack, pc + 5) - low
    curved = read_table(
        data.constants, data.code[pc + 6], 1, CURVE_SIZE, safe_divide(x - low, span), 1, data.code[pc + 1]
    )
    put_number(data, stack, pc + 7, (1.0 - factor) * x + factor * curved)
