"""Normals that closures are about: the surface's or their own, bent where facets would mirror into the surface."""

import functools

import warp as wp

from .materials import ClosureRecord, ShadingFrame

# Share of wo's height above the triangle that a mirrored direction keeps at least, by bending the
# normal. A choice of look, as any treatment of interpolated normals; flat surfaces have the share 1.
_HEIGHT_KEPT = wp.constant(0.25)


@wp.func
def facet_normal(n: wp.vec3, frame: ShadingFrame, wo: wp.vec3) -> wp.vec3:
    """Unit normal `n`, bent so that wo is above it and wo's mirror direction above the triangle.

    After Keller et al., "The Iray Light Transport Simulation and Rendering System" (2017), A.3.
    """
    c = wp.dot(n, wo)
    # a normal that faces away from wo is first turned to be perpendicular to it
    mirrored = 2.0 * wp.max(c, 0.0) * n - wo
    height = wp.dot(mirrored, frame.geometric_normal)
    least = _HEIGHT_KEPT * wp.dot(wo, frame.geometric_normal)
    if c > 0.0 and height >= least:
        return n
    return wp.normalize(wo + wp.normalize(mirrored + (least - height) * frame.geometric_normal))


@wp.func
def bump_shadow(n: wp.vec3, frame: ShadingFrame, wi: wp.vec3) -> float:
    """What is left of diffuse light from `wi` where a normal `n` of its own tilts the facets of a surface.

    Without it light ends abruptly where the surface turns away (Conty Estevez, Lecocq and Stein, "A Microfacet-Based Shadowing
    Function to Solve the Bump Terminator Problem", 2019).
    """
    cos_d = wp.abs(wp.dot(frame.normal, n))
    cos_i = wp.dot(frame.normal, wi)
    if cos_d >= 1.0:
        return 1.0
    if cos_i <= 0.0:
        return 0.0
    if cos_i >= 1.0:
        return 1.0
    alpha2 = wp.min(0.125 * (1.0 / wp.max(cos_d * cos_d, 1.0e-20) - 1.0), 1.0)
    return 2.0 * cos_i / (cos_i + wp.sqrt(cos_i * cos_i + alpha2 * (1.0 - cos_i * cos_i)))


@functools.cache
def make_normals(own: bool) -> tuple[wp.Function, wp.Function]:
    """Functions (closures, c: int) -> bool: whether a closure has a normal of its own, and (closures, c: int, frame) -> vec3: its normal."""

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
