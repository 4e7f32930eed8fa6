"""Emissive triangles as lights: points on them, chosen by the solid angle under which they are seen, and densities."""

from __future__ import annotations

import warp as wp

from ...scene.geometry import Geometry, corners_of, triangle_vertices
from ..sampling import sample_triangle
from .shapes import GAMMA_8, LightSample
from .table import LightTable

# Triangles whose area is below this share of the square of the nearest corner's distance are sampled evenly: it makes
# little difference, takes a fraction of the time, and angles lose digits. So they do where corners are nearly opposite
# to one another: the cosine of the angle between them is less than this
_NEAR = wp.constant(0.1)
_COSINE_LEAST = wp.constant(-0.95)


@wp.func
def find_triangle(table: LightTable, instance: int, primitive: int) -> int:
    """Number of the emitter that is this triangle of an instance, or -1."""
    if table.instance_first.shape[0] == 0:  # all emission comes from programs
        return -1
    low = table.instance_first[instance]
    end = table.instance_first[instance + 1]
    high = end
    while low < high:
        middle = low + (high - low) // 2
        if table.triangle_primitive[middle] < primitive:
            low = middle + 1
        else:
            high = middle
    if low < end:
        if table.triangle_primitive[low] == primitive:
            return table.light_count + low
    return -1


@wp.func
def triangle_density(normal: wp.vec3, direction: wp.vec3, distance: float) -> float:
    """Density per solid angle of uniform points on a triangle [1/sr]; the length of `normal` is twice the area.

    It is 0 for a triangle that is seen edge-on, or so nearly that the density is beyond the range of numbers.
    """
    projected = 0.5 * wp.abs(wp.dot(normal, direction))
    density = distance * distance / projected
    return wp.where(density < wp.inf, density, 0.0)


@wp.func
def triangle_distance_error(
    geometry: Geometry, instance: int, primitive: int, normal: wp.vec3, direction: wp.vec3, distance: float
) -> float:
    """Bound of how much nearer than `distance` a ray along `direction` may find the triangle that it aims at [m].

    Rounding moves the plane of the triangle, or the ray, by at most `error` along each axis; the slant of the ray
    stretches the part along the normal.
    """
    triangle = corners_of(geometry, geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive)
    p0 = wp.abs(geometry.positions[triangle[0]])
    p1 = wp.abs(geometry.positions[triangle[1]])
    p2 = wp.abs(geometry.positions[triangle[2]])
    m = geometry.instance_transform[instance]
    largest = wp.max(p0, wp.max(p1, p2))
    # terms of the corners in world space; the shaded point is at most `distance` away, and so are the products of the
    # ray with its distance
    error = wp.vec3(distance)
    for i in range(3):
        reach = wp.abs(m[i, 0]) * largest[0] + wp.abs(m[i, 1]) * largest[1] + wp.abs(m[i, 2]) * largest[2]
        error[i] = error[i] + reach + wp.abs(m[i, 3])
    slant = wp.abs(wp.dot(normal, direction))
    # each of four steps: the corners to the world, the sampled point, the ray to the object, the ray's test
    return wp.static(4.0 * GAMMA_8) * wp.dot(wp.abs(normal), error) / slant


@wp.func
def seen_solid_angle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> float:
    """Solid angle of the triangle with the corners `a`, `b`, `c` relative to the eye [sr] (van Oosterom and Strackee
    1983); 0 where it is to be sampled evenly.
    """
    nearest = wp.min(wp.length_sq(a), wp.min(wp.length_sq(b), wp.length_sq(c)))
    if not (0.5 * wp.length(wp.cross(b - a, c - a)) > _NEAR * nearest) or nearest <= 0.0:
        return 0.0
    p = wp.normalize(a)
    q = wp.normalize(b)
    r = wp.normalize(c)
    if wp.min(wp.dot(p, q), wp.min(wp.dot(q, r), wp.dot(r, p))) < _COSINE_LEAST:
        return 0.0
    volume = wp.abs(wp.dot(p, wp.cross(q - p, r - p)))
    angle = 2.0 * wp.atan2(volume, 1.0 + wp.dot(p, q) + wp.dot(q, r) + wp.dot(r, p))
    if angle > 0.0 and nearest < wp.inf:
        return angle
    return 0.0


@wp.func
def _angle_between(p: wp.vec3, q: wp.vec3) -> float:
    """Angle between unit vectors, precise for small ones."""
    return 2.0 * wp.atan2(wp.length(p - q), wp.length(p + q))


@wp.func
def _beside(v: wp.vec3, axis: wp.vec3) -> wp.vec3:
    """The part of `v` across the unit vector `axis`, unit."""
    return wp.normalize(v - wp.dot(v, axis) * axis)


@wp.func
def spherical_point(a: wp.vec3, b: wp.vec3, c: wp.vec3, angle: float, u: wp.vec2) -> wp.vec3:
    """Barycentric coordinates of a point of the triangle `a`, `b`, `c` (relative to the eye), uniform by solid angle
    (Arvo 1995, "Stratified sampling of spherical triangles"); `angle` is all of it.

    A great arc through `q` cuts off the share `u[0]` of the spherical triangle; the direction lies on that arc. The
    corners are turned until the edge from `p` to `q` is the shortest, where the fewest digits are lost; differences of
    cosines and sines are written as products.
    """
    p = wp.normalize(a)
    q = wp.normalize(b)
    r = wp.normalize(c)
    pq = wp.length_sq(p - q)
    qr = wp.length_sq(q - r)
    rp = wp.length_sq(r - p)
    if qr < pq and qr <= rp:
        first = p
        p = q
        q = r
        r = first
        pq = qr
    elif rp < pq:
        last = r
        r = q
        q = p
        p = last
        pq = rp
    normal_pq = wp.normalize(wp.cross(p, q))
    normal_rp = wp.normalize(wp.cross(r, p))
    at_p = _angle_between(normal_pq, -normal_rp)
    half = 0.5 * u[0] * angle
    sine = wp.sin(at_p)
    sin_half = wp.sin(half)
    sin_left = wp.sin(at_p - 2.0 * half)
    cos_left = wp.cos(at_p - 2.0 * half)
    k1 = -2.0 * wp.sin(at_p - half) * sin_half
    k2 = 0.5 * sine * pq - 2.0 * wp.cos(at_p - half) * sin_half
    # cosine of the arc from `p` to the new corner, which lies between `p` and `r`
    along = (k2 - (k2 * cos_left + k1 * sin_left) * wp.cos(at_p)) / ((k2 * sin_left - k1 * cos_left) * sine)
    if not (along <= 1.0):
        along = 1.0
    along = wp.max(along, wp.dot(p, r))
    corner = along * p + wp.sqrt(wp.max(1.0 - along * along, 0.0)) * _beside(r, p)
    height = 1.0 - u[1] * (1.0 - wp.dot(corner, q))
    direction = height * q + wp.sqrt(wp.max(1.0 - height * height, 0.0)) * _beside(corner, q)
    # where the direction meets the plane (Moeller and Trumbore 1997)
    across = wp.cross(direction, c - a)
    divisor = wp.dot(across, b - a)
    weight_b = float(0.0)
    weight_c = float(0.0)
    if divisor != 0.0:
        weight_b = wp.clamp(wp.dot(across, -a) / divisor, 0.0, 1.0)
        weight_c = wp.clamp(wp.dot(wp.cross(-a, b - a), direction) / divisor, 0.0, 1.0)
    both = weight_b + weight_c
    if both > 1.0:
        weight_b = weight_b / both
        weight_c = weight_c / both
    return wp.vec3(wp.max(1.0 - weight_b - weight_c, 0.0), weight_b, weight_c)


@wp.func
def triangle_pdf(
    geometry: Geometry, instance: int, primitive: int, position: wp.vec3, direction: wp.vec3, distance: float
) -> float:
    """Density with which `sample_triangle_light` chooses `direction` from `position` [1/sr]."""
    a, b, c = triangle_vertices(geometry, instance, primitive)
    angle = seen_solid_angle(a - position, b - position, c - position)
    if angle > 0.0:
        return 1.0 / angle
    return triangle_density(wp.cross(b - a, c - a), direction, distance)


@wp.func
def sample_triangle_light(
    table: LightTable, geometry: Geometry, triangle: int, position: wp.vec3, u: wp.vec2
) -> LightSample:
    """A direction towards a point of an emissive triangle."""
    s = LightSample()
    s.instance = table.triangle_instance[triangle]
    s.primitive = table.triangle_primitive[triangle]
    a, b, c = triangle_vertices(geometry, s.instance, s.primitive)
    # corners relative to the shaded point, so that far coordinates cancel once only
    to_a = a - position
    to_b = b - position
    to_c = c - position
    angle = seen_solid_angle(to_a, to_b, to_c)
    weight = sample_triangle(u)
    if angle > 0.0:
        weight = spherical_point(to_a, to_b, to_c, angle, u)
    offset = weight[0] * to_a + weight[1] * to_b + weight[2] * to_c
    s.distance = wp.length(offset)
    s.casts_shadow = 1
    s.visibility = table.instance_visibility[s.instance]
    if s.distance > 0.0:
        s.direction = offset / s.distance
        s.radiance = table.triangle_radiance[triangle]
        s.barycentric = wp.vec2(weight[1], weight[2])
        normal = wp.cross(b - a, c - a)
        s.pdf = triangle_density(normal, s.direction, s.distance)
        if angle > 0.0:
            s.pdf = 1.0 / angle
        if s.pdf > 0.0:
            s.distance_error = triangle_distance_error(
                geometry, s.instance, s.primitive, normal, s.direction, s.distance
            )
    return s
