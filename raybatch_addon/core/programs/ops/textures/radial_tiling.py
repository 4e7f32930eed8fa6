"""The plane cut into segments around the origin, as many as a rounded polygon has sides.

A polygon with a whole number of sides has equal segments of angle 2 A, beginning at the x axis. Otherwise the last
segment takes the rest of the turn, 2 L. Corners are arcs between sides; each half of a side begins where an arc ends,
and ends at the segment's middle. A point has two coordinates: how far out it lies, measured as the distance from the
origin to the sides of the polygon through it, and how far along its side.
"""

import warp as wp

from ....float32 import PI, TWO_PI
from ...op import NodeData, number, op, put_number, put_vector, vector, wanted
from ...point import ShadingPoint
from ..values.finite import finite_or_zero
from ..values.math import greater, limited, safe_divide


@wp.struct
class Side:
    """Half of a side."""

    start: float  # angle from the segment's divider to the end of the corner's arc, where the side begins [rad]
    reach: float  # angle from there to the segment's middle [rad]
    bend: float  # angle beyond the beginning over which lengths along the side go over to those along the arc [rad]
    rest: float  # length of the rest of the arc, of radius 1


@wp.struct
class SegmentPoint:
    """Coordinates of a point in its segment."""

    out: float
    along: float  # without sign
    extent: float  # `along` at the end of the half side that the point is measured by
    widest: float  # `extent` on the polygon of distance 1
    middle: float  # angle of the segment's middle from its divider [rad]


@wp.struct
class Corner:
    """The arc between the last side and the first, the x axis through it; the last side is at distance 1."""

    x: float  # centre
    y: float
    radius: float
    start: float  # angle from the x axis to the begin of the first side [rad]


@wp.func
def side_of(half_angle: float, start: float, roundness: float) -> Side:
    """Half a side of a segment of `half_angle`, of which the corner takes `start` [rad]."""
    side = Side()
    side.start = start
    side.reach = half_angle - start
    side.bend = (1.0 - roundness) * start
    side.rest = roundness * start
    return side


@wp.func
def round_side(half_angle: float, roundness: float) -> Side:
    """Half a side of a segment of `half_angle` [rad], as short as `roundness` leaves it."""
    if roundness == 0.0:  # also where the tangent is infinite, as for two sides
        return side_of(half_angle, 0.0, 0.0)
    return side_of(half_angle, half_angle - wp.atan((1.0 - roundness) * wp.tan(half_angle)), roundness)


@wp.func
def straight_extent(side: Side, distance: float) -> float:
    """Length along the half side to its end, at `distance` from the origin."""
    return distance * wp.tan(side.reach) + side.bend * (0.5 * distance + 0.5) + side.rest


@wp.func
def along_arc(side: Side, length: float, turned: float) -> float:
    """Coordinate along of a point at `length` from the origin, `turned` [rad] beyond the begin of the side."""
    distance = length * wp.cos(side.reach)
    beginning = length * wp.sin(side.reach)
    if turned < side.bend:
        return beginning + distance * turned + 0.5 * (1.0 - distance) * turned * turned / side.bend
    return beginning + side.bend * (0.5 * distance - 0.5) + turned


@wp.func
def arc_extent(side: Side, distance: float, length: float, turned: float) -> float:
    """Coordinate along of the end of the arc: that of the side, blended into that of the circle of radius `length`."""
    straight = straight_extent(side, distance)
    circular = length * wp.sin(side.reach) + side.bend * (0.5 * length * wp.cos(side.reach) + 0.5) + side.rest
    return straight + safe_divide(turned, side.start) * (circular - straight)


@wp.func
def last_corner(half_angle: float, last: Side, last_half: float, roundness: float) -> Corner:
    """The corner between the last side, of a segment of `last_half`, and the first, of one of `half_angle`."""
    corner = Corner()
    corner.radius = safe_divide(roundness * wp.tan(last_half), wp.tan(0.5 * (half_angle + last_half)))
    corner.x = safe_divide(wp.cos(last.start), wp.cos(last.reach)) - corner.radius * wp.cos(last_half)
    corner.y = corner.radius * wp.sin(last_half) - safe_divide(wp.sin(last.start), wp.cos(last.reach))
    y = corner.y + corner.radius * wp.sin(half_angle)
    x = corner.x + corner.radius * wp.cos(half_angle)
    corner.start = wp.atan(safe_divide(y, x))
    return corner


@wp.func
def distance_to_circle(x: float, y: float, radius: float, angle: float) -> float:
    """Distance from the origin to the far side of a circle around (x, y), in the direction `angle` [rad]."""
    toward = wp.cos(angle) * x + wp.sin(angle) * y
    return toward + wp.sqrt(greater(toward * toward + radius * radius - x * x - y * y, 0.0))


@wp.func
def tile_of_side(regular: Side, side: Side, half: float, length: float, angle: float) -> SegmentPoint:
    """Coordinates of a point at a straight side, `side` of a segment of `half`.

    `regular` is the side of a polygon without a last segment.
    """
    tile = SegmentPoint()
    tile.middle = half
    tile.out = length * wp.cos(half - angle)
    tile.along = tile.out * wp.tan(wp.abs(half - angle))
    tile.extent = straight_extent(side, tile.out)
    tile.widest = straight_extent(regular, 1.0)
    return tile


@wp.func
def tile_of_corner(side: Side, half: float, roundness: float, length: float, angle: float) -> SegmentPoint:
    """Coordinates of a point at the arc between equal segments of `half`."""
    nearest = wp.min(angle, 2.0 * half - angle)
    turned = side.start - nearest
    center = safe_divide(1.0 - roundness, wp.cos(half))
    tile = SegmentPoint()
    tile.middle = half
    tile.out = safe_divide(length, distance_to_circle(center, 0.0, roundness, nearest))
    tile.along = along_arc(side, length, turned)
    tile.extent = arc_extent(side, tile.out, length, turned)
    tile.widest = straight_extent(side, 1.0)
    return tile


@wp.func
def tile_of_last(
    regular: Side,
    outer: Side,
    inner: Side,
    corner: Corner,
    half: float,
    last_half: float,
    around: float,
    length: float,
    angle: float,
) -> SegmentPoint:
    """Coordinates of a point in the last segment, or at the corners of its ends."""
    begin = TWO_PI - 2.0 * last_half
    shrunk = safe_divide(wp.cos(half), wp.cos(last_half))  # distance of the other sides over that of the last
    tile = SegmentPoint()
    tile.middle = last_half
    tile.widest = wp.tan(inner.reach) + inner.bend * (0.5 + 0.5 * shrunk) + shrunk * inner.rest
    if around >= begin + inner.start and around < TWO_PI - inner.start:
        distance = length * wp.cos(last_half - angle)
        tile.out = shrunk * distance
        tile.along = tile.out * wp.tan(wp.abs(last_half - angle))
        tile.extent = shrunk * straight_extent(inner, distance)
        return tile
    # from the x axis, or from the last segment's beginning the other way round
    bearing = float(around)
    if around >= begin - corner.start and around < TWO_PI - last_half:
        bearing = begin - around
    elif around >= PI:
        bearing = around - TWO_PI
    distance = safe_divide(length, distance_to_circle(corner.x, corner.y, corner.radius, bearing))
    tile.out = shrunk * distance
    if bearing < 0.0:
        turned = inner.start - wp.abs(bearing)
        tile.along = shrunk * along_arc(inner, length, turned)
        tile.extent = shrunk * arc_extent(inner, distance, length, turned)
        return tile
    turned = outer.start - bearing
    tile.middle = half
    tile.along = along_arc(outer, length, turned)
    tile.extent = arc_extent(outer, tile.out, length, turned)
    tile.widest = straight_extent(regular, 1.0)
    return tile


@wp.func
def tile_at(sides: float, roundness: float, length: float, around: float, angle: float) -> SegmentPoint:
    """The tile of a point at `length` from the origin.

    The point is `around` [rad] from the x axis and `angle` [rad] from its segment's divider.
    """
    half = PI / sides
    regular = round_side(half, roundness)
    side = regular
    is_straight = angle >= regular.start and angle < 2.0 * half - regular.start
    if wp.floor(sides) != sides:
        last_half = PI - wp.floor(sides) * half
        begin = TWO_PI - 2.0 * last_half
        inner = round_side(last_half, roundness)
        corner = last_corner(half, inner, last_half, roundness)
        outer = side_of(half, corner.start, 1.0 - safe_divide(wp.tan(half - corner.start), wp.tan(half)))
        if around < corner.start or around >= begin - corner.start:
            return tile_of_last(regular, outer, inner, corner, half, last_half, around, length, angle)
        # half sides next to the last segment begin at the corner that they share with it
        is_straight = is_straight or around < regular.start or around >= begin - regular.start
        if around < half or around >= begin - half:
            side = outer
    if is_straight:
        return tile_of_side(regular, side, half, length, angle)
    return tile_of_corner(regular, half, roundness, length, angle)


@wp.func
def radial_tiles(normalize: int, p: wp.vec3, sides: float, roundness: float) -> wp.vec4:
    """Coordinates of `p` in its segment.

    They are: how far out, how far along, how far along the middle's end is at distance 1, and the angle of the
    segment's middle [rad]. Where `normalize` is 1, along is 0..1 and out is 1 on the polygon; otherwise along is
    signed, and out is 0 on the polygon.
    """
    around = wp.atan2(p[1], p[0])
    if p[1] < 0.0:
        around = around + TWO_PI
    width = 2.0 * (PI / sides)
    before = wp.floor(around / width) * width
    tile = tile_at(sides, roundness, wp.sqrt(p[0] * p[0] + p[1] * p[1]), around, around - before)
    out = tile.out
    along = tile.along
    widest = tile.widest
    if around - before < tile.middle:
        along = -along
    if sides == 2.0 and roundness == 0.0:
        widest = 0.0  # the sides have no end
    elif normalize == 1:
        along = safe_divide(along, tile.extent)
    if p[0] == 0.0 and p[1] == 0.0:
        along = 0.0
    if normalize == 1:
        along = 0.5 * along + 0.5
    else:
        out = out - 1.0
    # polygons of two sides have no corners
    return wp.vec4(finite_or_zero(out), finite_or_zero(along), finite_or_zero(widest), before + tile.middle)


@wp.func
def segment_index(p: wp.vec3, sides: float) -> float:
    """Number of the segment that the point lies in, from 0."""
    turns = wp.atan2(p[1], p[0]) / TWO_PI
    if p[1] < 0.0:
        turns = turns + 1.0
    return wp.floor(sides * turns)


@op("radial_tiling", "ivnn>VNNN")
@wp.func
def radial_tiling(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Radial tiling.

    Operands: whether coordinates are normalized, vector, sides, roundness > coordinates in the segment, its index,
    width and angle [rad].
    """
    p = vector(data, stack, pc + 2)
    sides = greater(number(data, stack, pc + 3), 2.0)
    roundness = limited(number(data, stack, pc + 4), 0.0, 1.0)
    if wanted(data, pc + 6):
        put_number(data, stack, pc + 6, segment_index(p, sides))
    if wanted(data, pc + 5) or wanted(data, pc + 7) or wanted(data, pc + 8):
        found = radial_tiles(data.code[pc + 1], p, sides, roundness)
        put_vector(data, stack, pc + 5, wp.vec3(found[1], found[0], 0.0))
        put_number(data, stack, pc + 7, found[2])
        put_number(data, stack, pc + 8, found[3])
