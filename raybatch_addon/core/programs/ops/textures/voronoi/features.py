"""Features of Voronoi textures: distances to the random points of cells, and attributes of the nearest point.

Octaves add up as in fractal noise. Any input gives a finite result.
"""

import functools

import warp as wp

from .....float32 import LARGEST
from ...values.finite import finite_or_zero
from ..hashing import hash_1_to_1
from ..noise import DETAIL_MAX
from .cells import make_cells

FEATURES = ("f1", "f2", "smooth_f1", "distance_to_edge", "n_sphere_radius")
# Squared distance below which two points count as one, for edges
_SAME_POINT = wp.constant(1e-4)


@wp.struct
class VoronoiSettings:
    """Parameters of a Voronoi texture."""

    metric: int
    normalize: int  # 1: distances and colours end at 1, roughly
    scale: float
    detail: float  # octaves beyond the first, may be fractional
    roughness: float
    lacunarity: float
    smoothness: float  # [0, 1]
    exponent: float  # exponent of Minkowski's metric
    randomness: float  # [0, 1]


@wp.struct
class VoronoiSample:
    """Result of a Voronoi texture at a point."""

    distance: float
    color: wp.vec3
    position: wp.vec4  # x, y, z, w of the nearest random point; 0 where a coordinate does not count


@wp.func
def _lerp(a: float, b: float, t: float) -> float:
    return a + t * (b - a)


@wp.func
def _smooth(x: float) -> float:
    """Smooth step from 0 at 0 to 1 at 1."""
    t = wp.clamp(x, 0.0, 1.0)
    return (3.0 - 2.0 * t) * (t * t)


@wp.func
def _clean(settings: VoronoiSettings) -> VoronoiSettings:
    """`settings` with every number finite and in its range; smoothness becomes the width of `smooth_f1`'s blend."""
    settings.scale = finite_or_zero(settings.scale)
    settings.detail = wp.clamp(finite_or_zero(settings.detail), 0.0, wp.static(DETAIL_MAX))
    settings.roughness = wp.clamp(finite_or_zero(settings.roughness), 0.0, 1.0)
    settings.lacunarity = finite_or_zero(settings.lacunarity)
    settings.smoothness = wp.clamp(0.5 * finite_or_zero(settings.smoothness), 0.0, 0.5)
    settings.exponent = finite_or_zero(settings.exponent)
    settings.randomness = wp.clamp(finite_or_zero(settings.randomness), 0.0, 1.0)
    return settings


@functools.cache
def make_octave(dimensions: int, feature: str) -> wp.Function:
    """Function (settings, coordinates) -> `VoronoiSample`: one octave of feature f1, f2 or smooth_f1."""
    cells = make_cells(dimensions)
    coordinates_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def first(settings: VoronoiSettings, coordinates: coordinates_type):
        cell = cells.floor(coordinates)
        local = coordinates - cell
        nearest = float(LARGEST)
        offset = offset_type()
        found = coordinates_type()
        count = int(wp.static(3**dimensions))  # a variable, so that the loop is not unrolled
        for i in range(count):
            candidate = cells.offset(i, 3)
            point = cells.point(cell, candidate, settings.randomness)
            rank = cells.rank(point - local, settings.metric, settings.exponent)
            if rank < nearest:
                nearest = rank
                offset = candidate
                found = point
        result = VoronoiSample()
        result.distance = cells.measure(found - local, settings.metric, settings.exponent)
        result.color = cells.color(cell, offset)
        result.position = cells.position(found + cell)
        return result

    @wp.func
    def second(settings: VoronoiSettings, coordinates: coordinates_type):
        cell = cells.floor(coordinates)
        local = coordinates - cell
        nearest = float(LARGEST)
        nearest_offset = offset_type()
        nearest_point = coordinates_type()
        next_nearest = float(LARGEST)
        offset = offset_type()
        found = coordinates_type()
        count = int(wp.static(3**dimensions))
        for i in range(count):
            candidate = cells.offset(i, 3)
            point = cells.point(cell, candidate, settings.randomness)
            distance = cells.measure(point - local, settings.metric, settings.exponent)
            if distance < nearest:
                next_nearest = nearest
                offset = nearest_offset
                found = nearest_point
                nearest = distance
                nearest_offset = candidate
                nearest_point = point
            elif distance < next_nearest:
                next_nearest = distance
                offset = candidate
                found = point
        result = VoronoiSample()
        result.distance = wp.where(next_nearest < LARGEST, next_nearest, 0.0)
        result.color = cells.color(cell, offset)
        result.position = cells.position(found + cell)
        return result

    @wp.func
    def smooth(settings: VoronoiSettings, coordinates: coordinates_type):
        # points are blended one after the other, so that their order (x first) matters
        cell = cells.floor(coordinates)
        local = coordinates - cell
        nearest = float(0.0)
        color = wp.vec3()
        found = coordinates_type()
        ones = coordinates_type(1.0)
        count = int(wp.static(5**dimensions))
        for i in range(count):
            offset = cells.offset(i, 5)
            point = cells.point(cell, offset, settings.randomness)
            distance = cells.measure(point - local, settings.metric, settings.exponent)
            share = float(1.0)
            if i > 0:
                share = _smooth(0.5 + 0.5 * (nearest - distance) / settings.smoothness)
            correction = settings.smoothness * share * (1.0 - share)
            nearest = _lerp(nearest, distance, share) - correction
            correction = correction / (1.0 + 3.0 * settings.smoothness)
            color = color + share * (cells.color(cell, offset) - color) - wp.vec3(correction)
            found = found + share * (point - found) - correction * ones
        result = VoronoiSample()
        if wp.isfinite(nearest):
            result.distance = nearest
            result.color = color
            result.position = cells.position(cell + found)
        return result

    @wp.func
    def smooth_or_first(settings: VoronoiSettings, coordinates: coordinates_type):
        result = VoronoiSample()
        if settings.smoothness > 0.0:
            result = smooth(settings, coordinates)
        else:
            result = first(settings, coordinates)
        return result

    return {"f1": first, "f2": second, "smooth_f1": smooth_or_first}[feature]


@functools.cache
def make_voronoi(dimensions: int, feature: str) -> wp.Function:
    """Function (settings: `VoronoiSettings`, xyz: vec3, w: float) -> `VoronoiSample` of a feature, all octaves.

    `feature` is f1, f2 or smooth_f1. Points are multiplied by `settings.scale`, positions divided by it.
    """
    cells = make_cells(dimensions)
    octave_at = make_octave(dimensions, feature)
    coordinates_type = cells.vector

    @wp.func
    def voronoi(settings: VoronoiSettings, xyz: wp.vec3, w: float):
        settings = _clean(settings)
        scale = float(1.0)
        amplitude = float(1.0)
        sum_of_amplitudes = float(0.0)
        result = VoronoiSample()
        single = settings.detail == 0.0 or settings.roughness == 0.0
        count = wp.where(single, 0, int(wp.ceil(settings.detail))) + 1
        for i in range(count):
            coordinates = cells.coordinates(xyz * settings.scale * scale, w * settings.scale * scale)
            octave = octave_at(settings, coordinates)
            if single:
                sum_of_amplitudes = 1.0
                result = octave
            else:
                # the last octave of a fractional detail counts in part
                part = wp.min(settings.detail - float(i) + 1.0, 1.0)
                sum_of_amplitudes += part * amplitude
                result.distance += part * (octave.distance * amplitude)
                result.color = result.color + part * (octave.color * amplitude)
                position = result.position + amplitude * (octave.position / scale - result.position)
                result.position = result.position + part * (position - result.position)
                scale *= settings.lacunarity
                amplitude *= settings.roughness
        if settings.normalize != 0:
            reach = coordinates_type(0.5 + 0.5 * settings.randomness)
            farthest = cells.measure(reach, settings.metric, settings.exponent)
            if wp.static(feature == "f2"):
                farthest *= 2.0
            result.distance = result.distance / (sum_of_amplitudes * farthest)
            result.color = result.color / sum_of_amplitudes
        result.distance = finite_or_zero(result.distance)
        for k in range(3):
            result.color[k] = finite_or_zero(result.color[k])
        for k in range(4):
            result.position[k] = finite_or_zero(
                wp.where(settings.scale != 0.0, result.position[k] / settings.scale, 0.0)
            )
        return result

    return voronoi


@functools.cache
def make_edge_octave(dimensions: int) -> wp.Function:
    """Function (coordinates, randomness) -> float: distance to the nearest border between cells, one octave.

    In one dimension borders lie in the middle between neighbours. Otherwise the border is the nearest plane between the
    nearest point and another one (Inigo Quilez, "Voronoi edges").
    """
    cells = make_cells(dimensions)
    coordinates_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def line(coordinates: coordinates_type, randomness: float):
        cell = cells.floor(coordinates)
        local = coordinates - cell
        middle = hash_1_to_1(cell[0]) * randomness
        left = cells.point(cell, offset_type(-1), randomness)
        right = cells.point(cell, offset_type(1), randomness)
        return wp.min(wp.abs((middle + left[0]) / 2.0 - local[0]), wp.abs((middle + right[0]) / 2.0 - local[0]))

    @wp.func
    def edge(coordinates: coordinates_type, randomness: float):
        cell = cells.floor(coordinates)
        local = coordinates - cell
        nearest = float(LARGEST)
        to_nearest = coordinates_type()
        count = int(wp.static(3**dimensions))
        for i in range(count):
            to_point = cells.point(cell, cells.offset(i, 3), randomness) - local
            squared = cells.dot(to_point, to_point)
            if squared < nearest:
                nearest = squared
                to_nearest = to_point
        nearest = float(LARGEST)
        for i in range(count):
            to_point = cells.point(cell, cells.offset(i, 3), randomness) - local
            across = to_point - to_nearest
            squared = cells.dot(across, across)
            if squared > _SAME_POINT:
                nearest = wp.min(nearest, cells.dot((to_nearest + to_point) / 2.0, across / wp.sqrt(squared)))
        return nearest

    return line if dimensions == 1 else edge


@functools.cache
def make_distance_to_edge(dimensions: int) -> wp.Function:
    """Function (settings, xyz: vec3, w: float) -> float: distance to the nearest border, all octaves.

    `settings` is a `VoronoiSettings`.
    """
    cells = make_cells(dimensions)
    octave_at = make_edge_octave(dimensions)

    @wp.func
    def distance_to_edge(settings: VoronoiSettings, xyz: wp.vec3, w: float):
        settings = _clean(settings)
        scale = float(1.0)
        amplitude = float(1.0)
        reach = 0.5 + 0.5 * settings.randomness
        farthest = float(reach)
        result = float(8.0)
        single = settings.detail == 0.0 or settings.roughness == 0.0
        count = wp.where(single, 0, int(wp.ceil(settings.detail))) + 1
        for i in range(count):
            octave = octave_at(
                cells.coordinates(xyz * settings.scale * scale, w * settings.scale * scale), settings.randomness
            )
            if single:
                result = octave
            else:
                part = wp.min(settings.detail - float(i) + 1.0, 1.0)
                farthest = _lerp(farthest, _lerp(farthest, reach / scale, amplitude), part)
                nearer = _lerp(result, wp.min(result, octave / scale), amplitude)
                result = _lerp(result, wp.min(result, nearer), part)
                scale *= settings.lacunarity
                amplitude *= settings.roughness
        if settings.normalize != 0:
            result = result / farthest
        return finite_or_zero(result)

    return distance_to_edge


@functools.cache
def make_n_sphere_radius(dimensions: int) -> wp.Function:
    """Function (settings, xyz: vec3, w: float) -> float: half the distance of the nearest point to its own nearest.

    `settings` is a `VoronoiSettings`.
    """
    cells = make_cells(dimensions)
    coordinates_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def n_sphere_radius(settings: VoronoiSettings, xyz: wp.vec3, w: float):
        settings = _clean(settings)
        coordinates = cells.coordinates(xyz * settings.scale, w * settings.scale)
        cell = cells.floor(coordinates)
        local = coordinates - cell
        nearest = float(LARGEST)
        offset = offset_type()
        found = coordinates_type()
        count = int(wp.static(3**dimensions))
        for i in range(count):
            candidate = cells.offset(i, 3)
            point = cells.point(cell, candidate, settings.randomness)
            squared = cells.dot(point - local, point - local)
            if squared < nearest:
                nearest = squared
                offset = candidate
                found = point
        nearest = float(LARGEST)
        neighbour = coordinates_type()
        for i in range(count):
            if i != wp.static(3**dimensions // 2):  # not the point's own cell
                point = cells.point(cell, cells.offset(i, 3) + offset, settings.randomness)
                squared = cells.dot(found - point, found - point)
                if squared < nearest:
                    nearest = squared
                    neighbour = point
        return finite_or_zero(wp.length(neighbour - found) / 2.0)

    return n_sphere_radius
