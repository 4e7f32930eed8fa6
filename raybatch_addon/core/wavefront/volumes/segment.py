"""A piece of a ray in volumes: what of its light passes, and where it scatters."""

from __future__ import annotations

import functools

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...float32 import UNIT_ROUNDOFF
from ...programs.point import IN_VOLUME, ShadingPoint
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import address_of
from ...shading.bsdf.subsurface import channel_shares
from ...shading.volumes.enclosures import FARTHEST
from ...shading.volumes.phase import PhaseLobe
from .along import Sought, lit_length
from .medium import LOBES_MOST, PHASE_LOBE_FLOATS, Coefficients, make_constant_medium, may_vary, passes, varies_along
from .table import VolumeData
from .track import SCATTERED, Track, make_transmitted

# Depths below which 1 - exp(-x) is x, to rounding
_SHALLOW = 1e-4


@wp.func
def ray_point(origin: wp.vec3, direction: wp.vec3, ray_kind: int, bounce: int, time: float) -> ShadingPoint:
    """What programs of volumes know of a ray at its begin, at `time`."""
    point = ShadingPoint()
    point.position = origin
    point.incoming = -direction
    point.normal = -direction
    point.geometric_normal = -direction
    point.instance = -1
    point.primitive = wp.static(IN_VOLUME)
    point.time = time
    point.ray_kind = ray_kind
    point.bounce = bounce
    return point


@wp.func
def _light_along(extinction: float, length: float) -> float:
    """The integral of the transmittance over `length` [m]."""
    depth = extinction * length
    if depth < wp.static(_SHALLOW):
        return length * (1.0 - 0.5 * depth)
    return (1.0 - wp.exp(-depth)) / extinction


@functools.cache
def make_passed(programs: ProgramFeatures) -> wp.Function:
    """Function (volumes, inside: vec4i, point: ShadingPoint, length: float, stream: uint32) -> vec3: the share of light
    that passes `length` [m] from `point` on; exact where coefficients are constant, else an estimate.
    """
    medium = make_constant_medium(programs)
    varies = may_vary(programs)
    transmitted = make_transmitted(programs) if varies else None

    @wp.func
    def passed(volumes: VolumeData, inside: wp.vec4i, point: ShadingPoint, length: float, stream: wp.uint32) -> wp.vec3:
        reach = wp.min(length, wp.static(FARTHEST))
        if wp.static(varies):
            if varies_along(volumes, inside):
                return transmitted(volumes, inside, point, reach, stream)
        floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        m = medium(volumes, inside, point, lobes)
        return passes(m.extinction, reach)

    return passed


@wp.func
def scattering_shares(throughput: wp.vec3, scattering: wp.vec3, extinction: wp.vec3) -> wp.vec3:
    """Probability that each channel decides where a path of `throughput` scatters."""
    albedo = wp.vec3(0.0)
    for axis in range(3):
        if extinction[axis] > 0.0:
            albedo[axis] = scattering[axis] / extinction[axis]
    return channel_shares(throughput, albedo)


@wp.func
def constant_way(
    m: Coefficients,
    length: float,
    throughput: wp.vec3,
    scatters: bool,
    seeks: bool,
    sought: Sought,
    u_lit: wp.vec2,
    u: wp.vec2,
) -> Track:
    """The way of light of `throughput` through a medium that is the same everywhere, `length` [m] at most: sampled by
    one channel, weighed by all of them. `u` decides the channel and the length, `u_lit` the same of the point from
    which light is looked for, if it `seeks` one; the lobes are the same everywhere.
    """
    way = Track()
    way.length = length
    shares = scattering_shares(throughput, m.scattering, m.extinction)
    if seeks and length > 0.0 and wp.dot(throughput, m.scattering) > 0.0:
        found = lit_length(m.extinction, shares, length, sought, u_lit)
        if found[1] > 0.0:
            way.lit.length = found[0]
            way.lit.weight = wp.cw_mul(m.scattering, passes(m.extinction, found[0])) / found[1]
            way.lit.medium = m
    if scatters and m.lobes > 0:
        chosen = m.extinction[2]
        if u[0] < shares[0]:
            chosen = m.extinction[0]
        elif u[0] < shares[0] + shares[1]:
            chosen = m.extinction[1]
        # the middle of the numbers that u stands for, so that no flight has length 0
        flight = float(wp.static(FARTHEST))
        if chosen > 0.0:
            flight = -wp.log(1.0 - u[1] - wp.static(0.5 * UNIT_ROUNDOFF)) / chosen
        if flight < length:
            left = passes(m.extinction, flight)
            density = wp.dot(shares, wp.cw_mul(m.extinction, left))
            way.weight = wp.cw_mul(m.scattering, left) / wp.max(density, 1.0e-30)
            way.length = flight
            way.event = wp.static(SCATTERED)
            way.medium = m
        else:
            left = passes(m.extinction, length)
            way.weight = left / wp.max(wp.dot(shares, left), 1.0e-30)
    else:
        way.weight = passes(m.extinction, length)
    for axis in range(3):
        if m.emission[axis] > 0.0:
            way.emitted[axis] = m.emission[axis] * _light_along(m.extinction[axis], length)
    return way
