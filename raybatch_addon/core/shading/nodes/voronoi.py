"""Voronoi textures: distances to the random points of cells, and what belongs to the nearest one.

Each feature in each number of dimensions is an op of its own (`voronoi_3d_f1`), so that kernels hold only the loops that a scene
needs; metrics are immediates. Octaves add up as in fractal noise. Any input gives a finite result.
"""

import functools

import warp as wp

from .hashing import hash_1_to_1
from .op import NodeData, number, op, put_number, put_vector, vector
from .point import ShadingPoint
from .finite import finite_or_zero
from .voronoi_cells import FARTHEST, make_cells

FEATURES = ("f1", "f2", "smooth_f1", "distance_to_edge", "n_sphere_radius")
DETAIL_MAX = 15.0  # octaves beyond the first
# Points that are closer to each other than this squared are one, for edges
_SAME_POINT = wp.constant(1e-4)


@wp.struct
class VoronoiSettings:
    """What a Voronoi texture is asked for, besides the place."""

    metric: int
    normalize: int  # 1: distances and colours end at 1, roughly
    scale: float
    detail: float  # octaves beyond the first, may be fractional
    roughness: float
    lacunarity: float
    smoothness: float  # [0, 1]
    exponent: float  # of Minkowski's metric
    randomness: float  # [0, 1]


@wp.struct
class VoronoiSample:
    """What a Voronoi texture gives at a place."""

    distance: float
    colour: wp.vec3
    position: wp.vec4  # x, y, z, w of the point; 0 where a coordinate does not count


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
    """`settings` with every number finite and in its range; smoothness as the width that `smooth_f1` blends over."""
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
    """Function (settings, place) -> `VoronoiSample`: one octave of feature f1, f2 or smooth_f1."""
    cells = make_cells(dimensions)
    place_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def first(settings: VoronoiSettings, place: place_type):
        cell = cells.floor(place)
        local = place - cell
        nearest = float(FARTHEST)
        offset = offset_type()
        found = place_type()
        count = int(wp.static(3**dimensions))  # a variable: the loop is not to be unrolled
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
        result.colour = cells.colour(cell, offset)
        result.position = cells.position(found + cell)
        return result

    @wp.func
    def second(settings: VoronoiSettings, place: place_type):
        cell = cells.floor(place)
        local = place - cell
        nearest = float(FARTHEST)
        nearest_offset = offset_type()
        nearest_point = place_type()
        next_nearest = float(FARTHEST)
        offset = offset_type()
        found = place_type()
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
        result.distance = wp.where(next_nearest < FARTHEST, next_nearest, 0.0)
        result.colour = cells.colour(cell, offset)
        result.position = cells.position(found + cell)
        return result

    @wp.func
    def smooth(settings: VoronoiSettings, place: place_type):
        # Blends one point after the other, so their order (x first) matters
        cell = cells.floor(place)
        local = place - cell
        nearest = float(0.0)
        colour = wp.vec3()
        found = place_type()
        ones = place_type(1.0)
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
            colour = colour + share * (cells.colour(cell, offset) - colour) - wp.vec3(correction)
            found = found + share * (point - found) - correction * ones
        result = VoronoiSample()
        if wp.isfinite(nearest):
            result.distance = nearest
            result.colour = colour
            result.position = cells.position(cell + found)
        return result

    @wp.func
    def smooth_or_first(settings: VoronoiSettings, place: place_type):
        result = VoronoiSample()
        if settings.smoothness > 0.0:
            result = smooth(settings, place)
        else:
            result = first(settings, place)
        return result

    return {"f1": first, "f2": second, "smooth_f1": smooth_or_first}[feature]


@functools.cache
def make_voronoi(dimensions: int, feature: str) -> wp.Function:
    """Function (settings: `VoronoiSettings`, xyz: vec3, w: float) -> `VoronoiSample` of feature f1, f2 or smooth_f1.

    Places are multiplied by `settings.scale`, positions divided by it.
    """
    cells = make_cells(dimensions)
    octave_at = make_octave(dimensions, feature)
    place_type = cells.vector

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
            place = cells.place(xyz * settings.scale * scale, w * settings.scale * scale)
            octave = octave_at(settings, place)
            if single:
                sum_of_amplitudes = 1.0
                result = octave
            else:
                # The last octave of a fractional detail counts in part
                part = wp.min(settings.detail - float(i) + 1.0, 1.0)
                sum_of_amplitudes += part * amplitude
                result.distance += part * (octave.distance * amplitude)
                result.colour = result.colour + part * (octave.colour * amplitude)
                position = result.position + amplitude * (octave.position / scale - result.position)
                result.position = result.position + part * (position - result.position)
                scale *= settings.lacunarity
                amplitude *= settings.roughness
        if settings.normalize != 0:
            reach = place_type(0.5 + 0.5 * settings.randomness)
            farthest = cells.measure(reach, settings.metric, settings.exponent)
            if wp.static(feature == "f2"):
                farthest *= 2.0
            result.distance = result.distance / (sum_of_amplitudes * farthest)
            result.colour = result.colour / sum_of_amplitudes
        result.distance = finite_or_zero(result.distance)
        for k in range(3):
            result.colour[k] = finite_or_zero(result.colour[k])
        for k in range(4):
            result.position[k] = finite_or_zero(wp.where(settings.scale != 0.0, result.position[k] / settings.scale, 0.0))
        return result

    return voronoi


@functools.cache
def make_edge_octave(dimensions: int) -> wp.Function:
    """Function (place, randomness) -> float: distance to the nearest border between two cells' points, one octave.

    In one dimension borders lie in the middle between neighbours. Otherwise the distance is that to the nearest plane between the
    nearest point and another one (Inigo Quilez, "Voronoi edges").
    """
    cells = make_cells(dimensions)
    place_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def line(place: place_type, randomness: float):
        cell = cells.floor(place)
        local = place - cell
        middle = hash_1_to_1(cell[0]) * randomness
        left = cells.point(cell, offset_type(-1), randomness)
        right = cells.point(cell, offset_type(1), randomness)
        return wp.min(wp.abs((middle + left[0]) / 2.0 - local[0]), wp.abs((middle + right[0]) / 2.0 - local[0]))

    @wp.func
    def edge(place: place_type, randomness: float):
        cell = cells.floor(place)
        local = place - cell
        nearest = float(FARTHEST)
        to_nearest = place_type()
        count = int(wp.static(3**dimensions))
        for i in range(count):
            to_point = cells.point(cell, cells.offset(i, 3), randomness) - local
            squared = cells.dot(to_point, to_point)
            if squared < nearest:
                nearest = squared
                to_nearest = to_point
        nearest = float(FARTHEST)
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
    """Function (settings: `VoronoiSettings`, xyz: vec3, w: float) -> float: distance to the nearest border, all octaves."""
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
            octave = octave_at(cells.place(xyz * settings.scale * scale, w * settings.scale * scale), settings.randomness)
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
    """Function (settings: `VoronoiSettings`, xyz: vec3, w: float) -> float: half the distance of the nearest point to its nearest."""
    cells = make_cells(dimensions)
    place_type = cells.vector
    offset_type = cells.integers

    @wp.func
    def n_sphere_radius(settings: VoronoiSettings, xyz: wp.vec3, w: float):
        settings = _clean(settings)
        place = cells.place(xyz * settings.scale, w * settings.scale)
        cell = cells.floor(place)
        local = place - cell
        nearest = float(FARTHEST)
        offset = offset_type()
        found = place_type()
        count = int(wp.static(3**dimensions))
        for i in range(count):
            candidate = cells.offset(i, 3)
            point = cells.point(cell, candidate, settings.randomness)
            squared = cells.dot(point - local, point - local)
            if squared < nearest:
                nearest = squared
                offset = candidate
                found = point
        nearest = float(FARTHEST)
        neighbour = place_type()
        for i in range(count):
            if i != wp.static(3**dimensions // 2):  # its own cell
                point = cells.point(cell, cells.offset(i, 3) + offset, settings.randomness)
                squared = cells.dot(found - point, found - point)
                if squared < nearest:
                    nearest = squared
                    neighbour = point
        return finite_or_zero(wp.length(neighbour - found) / 2.0)

    return n_sphere_radius


@wp.func
def _settings(data: NodeData, stack: wp.array(dtype=float), pc: int) -> VoronoiSettings:
    """Settings from the words that all ops have alike."""
    settings = VoronoiSettings()
    settings.metric = data.code[pc + 1]
    settings.normalize = data.code[pc + 2]
    settings.scale = number(data, stack, pc + 5)
    settings.detail = number(data, stack, pc + 6)
    settings.roughness = number(data, stack, pc + 7)
    settings.lacunarity = number(data, stack, pc + 8)
    settings.smoothness = number(data, stack, pc + 9)
    settings.exponent = number(data, stack, pc + 10)
    settings.randomness = number(data, stack, pc + 11)
    return settings


def op_name(dimensions: int, feature: str) -> str:
    """Name of the op for `feature` (one of `FEATURES`)."""
    return f"voronoi_{dimensions}d_{feature}"


# metric, normalize, xyz, w, scale, detail, roughness, lacunarity, smoothness, exponent, randomness > ...
_WORDS = "iivnnnnnnnn"


def _register_sample(dimensions: int, feature: str) -> None:
    voronoi = make_voronoi(dimensions, feature)

    @op(op_name(dimensions, feature), _WORDS + ">NVVN", foldable=False)  # distance, colour, position, w
    @wp.func
    def sample(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        found = voronoi(_settings(data, stack, pc), vector(data, stack, pc + 3), number(data, stack, pc + 4))
        put_number(data, stack, pc + 12, found.distance)
        put_vector(data, stack, pc + 13, found.colour)
        put_vector(data, stack, pc + 14, wp.vec3(found.position[0], found.position[1], found.position[2]))
        put_number(data, stack, pc + 15, found.position[3])


def _register_number(dimensions: int, feature: str) -> None:
    evaluate = make_distance_to_edge(dimensions) if feature == "distance_to_edge" else make_n_sphere_radius(dimensions)

    @op(op_name(dimensions, feature), _WORDS + ">N", foldable=False)
    @wp.func
    def measure(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        found = evaluate(_settings(data, stack, pc), vector(data, stack, pc + 3), number(data, stack, pc + 4))
        put_number(data, stack, pc + 12, found)


for _dimensions in (1, 2, 3, 4):
    for _feature in FEATURES:
        (_register_sample if _feature in ("f1", "f2", "smooth_f1") else _register_number)(_dimensions, _feature)
