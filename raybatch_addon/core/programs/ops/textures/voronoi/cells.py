"""Cells of Voronoi textures in one to four dimensions: one random point in each unit cell, and metrics of distance.

Steven Worley, "A Cellular Texture Basis Function", SIGGRAPH 1996.
"""

import functools
from typing import Any, NamedTuple

import warp as wp

from ...values.finite import finite_or_zero
from ..hashing import cell_to_vec2, cell_to_vec3, cell_to_vec4, hash_1_to_1, hash_1_to_3

# Metrics, in Blender's order
EUCLIDEAN = 0
MANHATTAN = 1
CHEBYCHEV = 2
MINKOWSKI = 3

_INT_LOWEST = wp.constant(-(2**31))
_INT_RANGE = wp.constant(2.0**31)


class Cells(NamedTuple):
    """Functions of cells in one number of dimensions; `vector` and `integers` are types of points and of offsets."""

    dimensions: int
    vector: Any
    integers: Any
    # (index, side) -> integers: the index-th of side**dimensions cells around the middle one, x first
    offset: wp.Function
    # (cell: vector, offset: integers, randomness) -> vector: the point of cell + offset, seen from `cell`
    point: wp.Function
    color: wp.Function  # (cell: vector, offset: integers) -> vec3: the colour of cell + offset
    floor: wp.Function  # (coordinates: vector) -> vector: their cell
    coordinates: wp.Function  # (xyz: vec3, w) -> vector: the coordinates that count
    position: wp.Function  # (coordinates: vector) -> vec4 (x, y, z, w) with zeros for coordinates that do not count
    dot: wp.Function  # (vector, vector) -> float
    measure: wp.Function  # (difference: vector, metric, exponent) -> float
    rank: wp.Function  # as `measure`, but only the order of its values counts (cheaper)


@wp.func
def whole(x: float) -> int:
    """`x` as int, the least int32 where it is out of range: casts do so on CPUs, but not on GPUs."""
    return wp.where(wp.abs(x) < _INT_RANGE, int(x), _INT_LOWEST)


@wp.func
def _point_1(cell: Any, offset: Any) -> Any:
    return hash_1_to_1(cell[0] + float(offset[0]))


@wp.func
def _point_2(cell: Any, offset: Any) -> Any:
    return cell_to_vec2(whole(cell[0]) + offset[0], whole(cell[1]) + offset[1])


@wp.func
def _point_3(cell: Any, offset: Any) -> Any:
    return cell_to_vec3(whole(cell[0]) + offset[0], whole(cell[1]) + offset[1], whole(cell[2]) + offset[2])


@wp.func
def _point_4(cell: Any, offset: Any) -> Any:
    return cell_to_vec4(
        whole(cell[0]) + offset[0], whole(cell[1]) + offset[1], whole(cell[2]) + offset[2], whole(cell[3]) + offset[3]
    )


@wp.func
def _color_1(cell: Any, offset: Any) -> wp.vec3:
    return hash_1_to_3(cell[0] + float(offset[0]))


@wp.func
def _color_2(cell: Any, offset: Any) -> wp.vec3:
    return cell_to_vec3(whole(cell[0]) + offset[0], whole(cell[1]) + offset[1], 0)


@wp.func
def _color_4(cell: Any, offset: Any) -> wp.vec3:
    hashed = _point_4(cell, offset)
    return wp.vec3(hashed[0], hashed[1], hashed[2])


_POINTS = {1: _point_1, 2: _point_2, 3: _point_3, 4: _point_4}
_COLORS = {1: _color_1, 2: _color_2, 3: _point_3, 4: _color_4}


@functools.cache
def make_cells(dimensions: int) -> Cells:
    """The `Cells` of `dimensions`, 1 to 4. In one dimension all metrics are the same."""
    vector = {1: wp.types.vector(length=1, dtype=float), 2: wp.vec2, 3: wp.vec3, 4: wp.vec4}[dimensions]
    integers = wp.types.vector(length=dimensions, dtype=int)
    hashed = _POINTS[dimensions]
    hashed_color = _COLORS[dimensions]

    @wp.func
    def offset(index: int, side: int):
        result = integers()
        rest = int(index)
        for k in range(wp.static(dimensions)):
            result[k] = rest % side - side // 2
            rest = rest // side
        return result

    @wp.func
    def point(cell: vector, offset: integers, randomness: float):
        result = vector()
        unit = hashed(cell, offset)
        for k in range(wp.static(dimensions)):
            if wp.static(dimensions == 1):
                result[k] = float(offset[k]) + unit * randomness
            else:
                result[k] = float(offset[k]) + unit[k] * randomness
        return result

    @wp.func
    def color(cell: vector, offset: integers):
        return hashed_color(cell, offset)

    @wp.func
    def floor(coordinates: vector):
        result = vector()
        for k in range(wp.static(dimensions)):
            result[k] = wp.floor(coordinates[k])
        return result

    @wp.func
    def coordinates(xyz: wp.vec3, w: float):
        result = vector()
        if wp.static(dimensions == 1):
            result[0] = finite_or_zero(w)
        else:
            for k in range(wp.static(min(dimensions, 3))):
                result[k] = finite_or_zero(xyz[k])
            if wp.static(dimensions == 4):
                result[3] = finite_or_zero(w)
        return result

    @wp.func
    def position(coordinates: vector):
        result = wp.vec4()
        if wp.static(dimensions == 1):
            result[3] = coordinates[0]
        else:
            for k in range(wp.static(dimensions)):
                result[k] = coordinates[k]
        return result

    @wp.func
    def total(parts: vector):
        # in the order in which Blender's vector units add, which decides between points that are equally far
        result = float(parts[0])
        if wp.static(dimensions == 4):
            result = (parts[0] + parts[1]) + (parts[2] + parts[3])
        else:
            for k in range(wp.static(1), wp.static(dimensions)):
                result += parts[k]
        return result

    @wp.func
    def dot(a: vector, b: vector):
        return total(wp.cw_mul(a, b))

    @wp.func
    def rank(difference: vector, metric: int, exponent: float):
        result = float(0.0)
        if wp.static(dimensions == 1):
            result = wp.abs(difference[0])
        elif metric == wp.static(EUCLIDEAN):
            result = dot(difference, difference)
        elif metric == wp.static(CHEBYCHEV):
            for k in range(wp.static(dimensions)):
                result = wp.max(result, wp.abs(difference[k]))
        else:
            parts = vector()
            for k in range(wp.static(dimensions)):
                parts[k] = wp.abs(difference[k])
                if metric == wp.static(MINKOWSKI):
                    parts[k] = wp.pow(parts[k], exponent)
            result = total(parts)
        return result

    @wp.func
    def measure(difference: vector, metric: int, exponent: float):
        result = rank(difference, metric, exponent)
        if wp.static(dimensions > 1):
            if metric == wp.static(EUCLIDEAN):
                result = wp.sqrt(result)
            elif metric == wp.static(MINKOWSKI):
                result = wp.pow(result, 1.0 / exponent)
        return result

    return Cells(
        dimensions=dimensions,
        vector=vector,
        integers=integers,
        offset=offset,
        point=point,
        color=color,
        floor=floor,
        coordinates=coordinates,
        position=position,
        dot=dot,
        measure=measure,
        rank=rank,
    )
