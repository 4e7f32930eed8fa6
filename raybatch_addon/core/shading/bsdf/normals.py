"""Normals that closures are about: the surface's or their own, bent where facets would mirror into the surface."""

import functools

import warp as wp

from ..sampling import bitangent_of, tangent_of
from ..surface import SurfacePoint
from .materials import ClosureRecord, ShadingFrame

# Least height of a mirrored direction above the triangle: a share of wo's height, and no more than this. As in Cycles,
# so that pictures agree
_HEIGHT_SHARE = wp.constant(0.9)
_HEIGHT_MOST = wp.constant(0.01)


@wp.func
def shading_frame(surface: SurfacePoint, wo: wp.vec3) -> ShadingFrame:
    """The shading frame on the side of `wo`."""
    frame = ShadingFrame()
    frame.geometric_normal = surface.geometric_normal
    frame.normal = surface.normal
    frame.entering = 1
    if wp.dot(wo, surface.geometric_normal) < 0.0:
        frame.geometric_normal = -frame.geometric_normal
        frame.normal = -frame.normal
        frame.entering = 0
    frame.tangent = tangent_of(frame.normal)
    frame.bitangent = bitangent_of(frame.normal)
    return frame


@wp.func
def mirroring_normal(n: wp.vec3, g: wp.vec3, wo: wp.vec3) -> wp.vec3:
    """Unit normal `n`, bent towards the triangle's, `g`, where wo's mirror direction would be below the triangle.

    The mirror direction of the bent normal is just above the triangle. In the plane of both normals, with the
    triangle's as the second axis, a normal (x, z) mirrors wo to the height 2 z (x wo_x + z wo_z) - wo_z. With x =
    sqrt(1 - z^2) that is quadratic in z^2. A normal that is not bent may be turned away from wo.
    """
    wo_z = wp.dot(wo, g)
    least = wp.min(_HEIGHT_SHARE * wo_z, _HEIGHT_MOST)
    n_z = wp.dot(n, g)
    if 2.0 * wp.dot(n, wo) * n_z - wo_z >= least:
        return n
    across = n - n_z * g
    length = wp.length(across)
    if length == 0.0:
        return n
    across = across / length
    wo_x = wp.dot(wo, across)
    a = wp.max(wo_x * wo_x + wo_z * wo_z, 1.0e-30)
    # both squares are sums of terms that are not negative: no digits are lost
    root = wp.abs(wo_x) * wp.sqrt(wp.max(a - least * least, 0.0))
    sum = wo_z + least
    difference = wo_z - least
    upper = a + wo_z * least + root
    lower = a - wo_z * least + root
    if wo_x < 0.0:
        return wp.normalize(wp.sqrt(0.5 / lower) * difference * across + wp.sqrt(0.5 * upper / a) * g)
    return wp.normalize(wp.sqrt(0.5 * lower / a) * across + wp.sqrt(0.5 / upper) * sum * g)


@wp.func
def facet_normal(n: wp.vec3, frame: ShadingFrame, wo: wp.vec3) -> wp.vec3:
    """`mirroring_normal` of `n` with the geometric normal of `frame`."""
    return mirroring_normal(n, frame.geometric_normal, wo)


@wp.func
def bump_shadow(n: wp.vec3, frame: ShadingFrame, wi: wp.vec3) -> float:
    """Share of diffuse light from `wi` that remains where a closure's own normal `n` tilts the facets of a surface.

    Without it light ends abruptly where the surface turns away (Conty Estevez, Lecocq and Stein, "A Microfacet-Based
    Shadowing Function to Solve the Bump Terminator Problem", 2019).
    """
    cos_d = wp.dot(frame.normal, n)
    cos_i = wp.dot(frame.normal, wi)
    if cos_d * cos_i * wp.dot(n, wi) < 0.0:
        return 0.0  # above one of the normals alone: light would leak through the surface
    cos_d = wp.abs(cos_d)
    cos_i = wp.abs(cos_i)
    if cos_d >= 1.0 or cos_i >= 1.0:
        return 1.0
    if cos_i == 0.0:
        return 0.0
    alpha2 = wp.min(0.125 * (1.0 / wp.max(cos_d * cos_d, 1.0e-20) - 1.0), 1.0)
    return 2.0 * cos_i / (cos_i + wp.sqrt(cos_i * cos_i + alpha2 * (1.0 - cos_i * cos_i)))


@functools.cache
def make_normals(own: bool) -> tuple[wp.Function, wp.Function]:
    """Two functions, of a closure's own normal.

    (closures, c: int) -> bool: whether a closure has a normal of its own; (closures, c: int, frame) -> vec3: the normal
    that it is about.
    """

    @wp.func
    def has_own_normal(closures: wp.array(dtype=ClosureRecord), c: int) -> bool:
        if wp.static(own):
            n = closures[c].normal
            return n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0
        return False

    @wp.func
    def own_normal(closures: wp.array(dtype=ClosureRecord), c: int, frame: ShadingFrame) -> wp.vec3:
        if has_own_normal(closures, c):
            return closures[c].normal
        return frame.normal

    return has_own_normal, own_normal
