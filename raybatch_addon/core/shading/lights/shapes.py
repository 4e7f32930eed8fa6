"""Shapes of lights: to be sampled from a shaded point, and to be met by a ray.

Densities are per solid angle at the shaded point, given that this light is chosen. Each pair (sample, meet) states the
same density, so that the two combine by multiple importance sampling. Outside the light's reach the density is 0.

Facts of Blender's lights (as Cycles renders them): a point or spot light is a sphere, or with soft falloff a disk that
faces the shaded point. A spot's cone depends on the direction of the light that leaves, and is ignored inside a sphere.
Area lights are in `area_shapes.py`.
"""

import warp as wp

from ...float32 import roundoff
from ..sampling import (
    bitangent_of,
    cone_pdf,
    is_in_cone,
    sample_cone,
    sample_cone_around,
    sample_disk,
    sample_sphere,
    tangent_of,
    to_world,
)
from .table import LightRecord

# Programs that give the radiance of a sampled light (`LightSample.program`)
WORLD_PROGRAM = 1
SURFACE_PROGRAM = 2
LAMP_PROGRAM = 3
# Bound of the relative error of eight operations (Higham 2002, section 3.1)
GAMMA_8 = roundoff(8)


@wp.struct
class LightSample:
    """A direction towards a light, or a light that a ray meets."""

    direction: wp.vec3  # unit, from the shaded point
    distance: float  # [m]; infinite for a sun
    # bound of how much nearer a ray may find the mesh light itself, or a surface in the plane of an area light, which
    # does not hide it [m]; 0 for other lights
    distance_error: float
    radiance: wp.vec3  # [W/(m² sr)]; of a delta light: irradiance of a surface that faces it [W/m²]
    # solid-angle density [1/sr] times the probability of the light; of a delta light that probability; 0: no light
    pdf: float
    delta: int  # 1: rays that a BSDF scatters never meet it
    casts_shadow: int  # 0: it shines through everything
    # `Visibility` bits: kinds of scattering that the light reaches; where light is linked to blockers also bits of the
    # shadow sets that block it, from `SHADOW_SET_SHIFT` on
    visibility: int
    instance: int  # instance of a mesh light; number of a light without mesh whose program gives its radiance; else -1
    primitive: int  # triangle of a mesh light, else -1
    barycentric: wp.vec2  # barycentric coordinates of the point on a mesh light
    emitter: int  # number among all emitters, of light that is sampled
    # `radiance` multiplies the result of a program: WORLD_PROGRAM, SURFACE_PROGRAM, LAMP_PROGRAM; 0: it is the radiance
    program: int


@wp.func
def spot_attenuation(light: LightRecord, direction: wp.vec3) -> float:
    """Share of a spot's light that leaves against `direction` (unit, towards the light): smooth in the cosine."""
    x = wp.dot(direction, light.axis_x) * light.squeeze_x
    y = wp.dot(direction, light.axis_y) * light.squeeze_y
    z = -wp.dot(direction, light.axis)
    inside = z / wp.sqrt(x * x + y * y + z * z) - light.cos_half
    if light.inverse_blend == 0.0:
        return wp.where(inside > 0.0, 1.0, 0.0)
    t = wp.clamp(inside * light.inverse_blend, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def spot_factor(light: LightRecord, position: wp.vec3, direction: wp.vec3) -> float:
    """Share of a SPOT's light that comes to `position` from `direction`."""
    # inside a sphere there is no cone
    if light.sphere != 0:
        offset = light.position - position
        if wp.dot(offset, offset) <= light.radius * light.radius:
            return 1.0
    return spot_attenuation(light, direction)


# --- spheres ----------------------------------------------------------------------------------------


@wp.func
def sphere_one_minus_cos(radius: float, distance_squared: float) -> float:
    """1 - cos of the angle under which a sphere's radius is seen from outside, precise for small ones."""
    sine_squared = radius * radius / distance_squared
    return sine_squared / (1.0 + wp.sqrt(wp.max(1.0 - sine_squared, 0.0)))


@wp.func
def sphere_pdf(radius: float, distance_squared: float) -> float:
    """Density [1/sr], uniform over the directions that meet the sphere: a cone from outside, all from inside."""
    if distance_squared > radius * radius:
        return cone_pdf(sphere_one_minus_cos(radius, distance_squared))
    return 1.0 / (2.0 * wp.TAU)


@wp.func
def sample_sphere_light(light: LightRecord, position: wp.vec3, u: wp.vec2) -> LightSample:
    """A direction that meets the sphere."""
    s = LightSample()
    offset = light.position - position
    distance_squared = wp.dot(offset, offset)
    radius_squared = light.radius * light.radius
    s.pdf = sphere_pdf(light.radius, distance_squared)
    if distance_squared > radius_squared:
        centre_distance = wp.sqrt(distance_squared)
        axis = offset / centre_distance
        local = sample_cone(u, sphere_one_minus_cos(light.radius, distance_squared))
        s.direction = to_world(local, tangent_of(axis), bitangent_of(axis), axis)
        beside_squared = distance_squared * (local[0] * local[0] + local[1] * local[1])
        s.distance = centre_distance * local[2] - wp.sqrt(wp.max(radius_squared - beside_squared, 0.0))
    else:
        s.direction = sample_sphere(u)
        along = wp.dot(s.direction, offset)
        s.distance = along + wp.sqrt(wp.max(radius_squared - distance_squared + along * along, 0.0))
    return s


@wp.func
def meet_sphere(light: LightRecord, origin: wp.vec3, direction: wp.vec3) -> LightSample:
    """Hit of a ray with the sphere, from outside or inside."""
    s = LightSample()
    offset = light.position - origin
    distance_squared = wp.dot(offset, offset)
    radius_squared = light.radius * light.radius
    along = wp.dot(offset, direction)
    # the vector from the ray to the centre does not cancel when the sphere is far (Haines et al., Ray Tracing Gems 7)
    beside = offset - along * direction
    half_chord_squared = radius_squared - wp.dot(beside, beside)
    if distance_squared > radius_squared:
        if along > 0.0 and half_chord_squared >= 0.0:
            s.distance = along - wp.sqrt(half_chord_squared)
            s.pdf = sphere_pdf(light.radius, distance_squared)
    else:
        s.distance = along + wp.sqrt(wp.max(half_chord_squared, 0.0))
        s.pdf = sphere_pdf(light.radius, distance_squared)
    return s


# --- disks that face the shaded point ----------------------------------------------------------------


@wp.func
def area_to_solid_angle(distance_squared: float, height: float, area: float) -> float:
    """Density per solid angle of uniform points on `area` [m²].

    The shaded point is `height` [m] away along the normal of the area.
    """
    return distance_squared * wp.sqrt(distance_squared) / (height * area)


@wp.func
def sample_disk_light(light: LightRecord, position: wp.vec3, u: wp.vec2) -> LightSample:
    """A direction towards a uniform point of the disk."""
    s = LightSample()
    offset = light.position - position
    height = wp.length(offset)
    if height > 0.0:
        axis = offset / height
        p = sample_disk(u) * light.radius
        beside_squared = wp.dot(p, p)
        distance_squared = height * height + beside_squared
        s.distance = wp.sqrt(distance_squared)
        s.direction = to_world(wp.vec3(p[0], p[1], height), tangent_of(axis), bitangent_of(axis), axis)
        s.pdf = area_to_solid_angle(distance_squared, height, wp.PI * light.radius * light.radius)
    return s


@wp.func
def meet_disk(light: LightRecord, origin: wp.vec3, direction: wp.vec3) -> LightSample:
    """Hit of a ray with the disk that faces its origin."""
    s = LightSample()
    offset = light.position - origin
    height = wp.length(offset)
    along = wp.dot(offset, direction)
    if along > 0.0:
        distance = height * (height / along)
        beside = offset - distance * direction
        beside_squared = wp.dot(beside, beside)
        radius_squared = light.radius * light.radius
        if beside_squared <= radius_squared:
            s.distance = distance
            s.pdf = area_to_solid_angle(height * height + beside_squared, height, wp.PI * radius_squared)
    return s


# --- suns -------------------------------------------------------------------------------------------


@wp.func
def sample_sun(light: LightRecord, u: wp.vec2) -> LightSample:
    """A direction within the sun's cone."""
    s = LightSample()
    s.direction = sample_cone_around(-light.axis, light.one_minus_cos, u)
    s.distance = wp.inf
    s.pdf = cone_pdf(light.one_minus_cos)
    return s


@wp.func
def meet_sun(light: LightRecord, direction: wp.vec3) -> LightSample:
    """The sun, if `direction` lies within its cone."""
    s = LightSample()
    if is_in_cone(direction, -light.axis, light.one_minus_cos):
        s.distance = wp.inf
        s.pdf = cone_pdf(light.one_minus_cos)
    return s
