"""The point for which a program runs."""

import warp as wp


@wp.struct
class ShadingPoint:
    """A point on a surface, or a direction into the world; in world space.

    In the world there is no instance, `position` is where the ray began, `incoming` its direction backwards, and all normals are `incoming`.
    """

    position: wp.vec3  # [m]
    incoming: wp.vec3  # unit, towards where the ray came from
    normal: wp.vec3  # unit, interpolated, on the side of `incoming`
    geometric_normal: wp.vec3  # unit, of the triangle, on the side of `incoming`
    backfacing: int  # 1: the back of the surface is met
    instance: int  # -1: none
    primitive: int  # triangle of the instance's mesh
    barycentric: wp.vec2  # weights of the triangle's second and third corner
    ray_length: float  # to the point where the ray began [m]
    ray_kind: int  # `Visibility` bit of the ray
    bounce: int  # scattering events of the path so far
    passed: int  # transparent surfaces that the ray has passed
    footprint: float  # width of a pixel at the point [m]: how far apart bump mapping looks
