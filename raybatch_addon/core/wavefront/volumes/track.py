"""Light along a ray through volumes whose coefficients programs give: by free flights between bounds of the extinction.

A flight ends where a medium of the bound's extinction scatters, and a part of that is what is there; the rest is null.
Transmittance is estimated by the ratio of the null part to the bound at each of these points (ratio tracking; Novák,
Selle and Jarosz, "Residual Ratio Tracking for Estimating Attenuation in Participating Media", 2014), distances to a
scattering by a choice that the light carried so far decides (Kutz, Habel, Li and Novák, "Spectral and Decomposition
Tracking for Rendering Heterogeneous Volumes", 2017).

Light is looked for from one of the points where flights of a path ended before it scattered, or from one more that was
sought by a light: each counts by the density of both together (flights end with that of the bound), and one is drawn by
what it is expected to bring.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...measure.volumes import SHARE_UNITS
from ...programs.point import ShadingPoint
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import address_of
from ...shading.lights.table import LightTable
from ...shading.sequences.keys import mix_bits
from ...shading.volumes.numbers import LIT_STREAM, stream_number
from ...shading.volumes.phase import PhaseLobe
from .along import Sought, density_by_light, length_by_light
from .emission.weigh import Seen
from .medium import LOBES_MOST, PHASE_LOBE_FLOATS, Coefficients, bound_ahead, make_medium, may_vary, varies_along
from .table import (
    COLLISIONS,
    DENSITY,
    DENSITY_LOST,
    EXCEEDED,
    EXTINCTION,
    FLIGHTS,
    SHADOW_RAYS,
    SHADOW_RAYS_CUT,
    VolumeData,
    note_count,
)

# Flights of a path between two rays: longer ways go on with a new ray
FLIGHTS_MOST = 256
# Flights of a shadow ray between two surfaces: what lies beyond them is taken to be empty
_SHADOW_FLIGHTS_MOST = 1 << 16
# Transmittance below which chance decides whether light goes on
_ROULETTE_BELOW = 0.05
_LENGTH_LEAST = 1e-30
# A program that exceeds its bound more often than that counts as that
_EXCESS_MOST = 1e12


@wp.struct
class Lit:
    """A point of a way from which light is looked for."""

    length: float  # from the begin of the way [m]
    weight: wp.vec3  # what light that is scattered there counts, the scattering coefficient in it; 0: there is no point
    medium: Coefficients  # at the point


@wp.struct
class Track:
    """Where a way through volumes ends."""

    length: float  # [m]
    weight: wp.vec3  # the throughput is multiplied by this
    emitted: wp.vec3  # by the volumes on the way, as seen from its begin [W/(m² sr)]
    event: int  # SCATTERED, PASSED, or STOPPED: the way goes on from here
    medium: Coefficients  # where it scattered
    lit: Lit


PASSED, SCATTERED, STOPPED = 0, 1, 2


@wp.struct
class Flights:
    """How far flights along a ray have come."""

    length: float  # from its begin [m]
    ahead: float  # a point before which they stop once, until it has been passed [m]; infinity: there is none
    bound: float  # of the extinction where programs are asked next [1/m]; 0: the way has ended, or there were too many
    collides: bool  # there: a flight has ended, which is not only the point that was ahead
    number: wp.uint32  # the next number of the stream
    count: int  # of flights so far


@wp.func
def densest(m: Coefficients, bound: float) -> float:
    """What coefficients are divided by: where a bound is exceeded no light must be gained."""
    return wp.max(bound, wp.max(m.extinction[0], wp.max(m.extinction[1], m.extinction[2])))


@wp.func
def _note_exceeded(volumes: VolumeData, stream: wp.uint32, most: float, bound: float):
    """At a collision programs gave `most`, which is more than the `bound` of the extinction there [1/m]."""
    excess = wp.min(most / bound - 1.0, wp.static(_EXCESS_MOST))
    note_count(volumes.counts, stream, wp.static(EXCEEDED), wp.int64(1))
    note_count(volumes.counts, stream, wp.static(DENSITY_LOST), wp.int64(excess * wp.static(float(SHARE_UNITS))))


@wp.func
def _note_collisions(volumes: VolumeData, stream: wp.uint32, count: int, density: float):
    """There were `count` collisions; `density`: the sum of the shares of them that were no null collisions."""
    note_count(volumes.counts, stream, wp.static(COLLISIONS), wp.int64(count))
    note_count(volumes.counts, stream, wp.static(DENSITY), wp.int64(density * wp.static(float(SHARE_UNITS))))


@functools.cache
def make_shining(programs: ProgramFeatures) -> wp.Function:
    """Function (volumes, inside: vec4i, point: ShadingPoint) -> vec3: what all volumes together emit at `point`,
    as flights find it [W/(m³ sr)]: less where the bound there is too low, and nothing where it is 0.
    """
    medium = make_medium(programs)
    varies = may_vary(programs)

    @wp.func
    def shining(volumes: VolumeData, inside: wp.vec4i, point: ShadingPoint) -> wp.vec3:
        floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        m = medium(volumes, inside, point, lobes)
        if wp.static(varies):
            if varies_along(volumes, inside):
                reach = bound_ahead(volumes, inside, point.position, -point.incoming, point.time, FLIGHTS)
                if not reach.bound > 0.0:
                    return wp.vec3(0.0)
                return m.emission * (reach.bound / densest(m, reach.bound))
        return m.emission

    return shining


@functools.cache
def make_fly(of: int, most: int, stops: bool) -> wp.Function:
    """Function (volumes, inside: vec4i, begin: vec3, direction: vec3, time: float, length: float, stream: uint32,
    flown: Flights) -> Flights: further flights along a ray from `begin`, which ends after `length` [m], to the next
    point at which programs are asked: on a GPU the threads of a warp come there together.

    `of`: bounds as of `bound_ahead`; `most`: flights at most; `stops`: whether there may be a point ahead.
    """

    @wp.func
    def fly(
        volumes: VolumeData,
        inside: wp.vec4i,
        begin: wp.vec3,
        direction: wp.vec3,
        time: float,
        length: float,
        stream: wp.uint32,
        flown: Flights,
    ) -> Flights:
        t = float(flown.length)
        ahead = float(flown.ahead)
        number = wp.uint32(flown.number)
        flights = int(flown.count)
        bound = float(0.0)
        collides = bool(False)
        while t < length and flights < wp.static(most):
            flights += 1
            here = begin + t * direction
            reach = bound_ahead(volumes, inside, here, direction, time, wp.static(of))
            end = wp.min(t + reach.length, length)
            # a flight that comes to the point ahead goes on from there as if it had begun there
            is_ahead = bool(False)
            if wp.static(stops):
                is_ahead = ahead >= t and ahead < end
                if is_ahead:
                    end = ahead
            flight = float(wp.inf)
            if reach.bound > 0.0:
                flight = -wp.log(1.0 - stream_number(stream, number)) / reach.bound
            number += wp.uint32(1)
            if t + flight < end:
                t += wp.max(flight, wp.static(_LENGTH_LEAST))
                bound = reach.bound
                collides = True
                break
            if not (end > t or is_ahead):  # the steps that are left are smaller than the distance can tell: it ends
                t = length
                break
            t = end
            if wp.static(stops):
                if is_ahead:
                    ahead = wp.inf
                    if reach.bound > 0.0:
                        bound = reach.bound
                        break
        now = Flights()
        now.length = t
        now.ahead = ahead
        now.bound = bound
        now.collides = collides
        now.number = number
        now.count = flights
        return now

    return fly


@functools.cache
def make_transmitted(programs: ProgramFeatures) -> wp.Function:
    """Function (volumes, inside: vec4i, point: ShadingPoint, length: float, stream: uint32) -> vec3: an estimate of the
    share of light that passes `length` [m] from `point` on, against `point.incoming`.
    """
    medium = make_medium(programs)
    fly = make_fly(EXTINCTION, _SHADOW_FLIGHTS_MOST, stops=False)

    @wp.func
    def transmitted(
        volumes: VolumeData, inside: wp.vec4i, point: ShadingPoint, length: float, stream: wp.uint32
    ) -> wp.vec3:
        floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        direction = -point.incoming
        begin = point.position
        share = wp.vec3(1.0)
        count = int(0)
        density = float(0.0)
        flown = Flights()
        while flown.length < length:
            flown = fly(volumes, inside, begin, direction, point.time, length, stream, flown)
            if not flown.bound > 0.0:
                if flown.length < length:
                    note_count(volumes.counts, stream, wp.static(SHADOW_RAYS_CUT), wp.int64(1))
                break
            point.position = begin + flown.length * direction
            m = medium(volumes, inside, point, lobes)
            most = densest(m, flown.bound)
            count += 1
            density += densest(m, 0.0) / most
            if most > flown.bound:
                _note_exceeded(volumes, stream, most, flown.bound)
            for axis in range(3):
                share[axis] = share[axis] * wp.max(1.0 - m.extinction[axis] / most, 0.0)
            largest = wp.max(share[0], wp.max(share[1], share[2]))
            if not largest > 0.0:
                share = wp.vec3(0.0)
                break
            if largest < wp.static(_ROULETTE_BELOW):
                survival = largest / wp.static(_ROULETTE_BELOW)
                if stream_number(stream, flown.number) >= survival:
                    share = wp.vec3(0.0)
                    break
                share = share / survival
                flown.number += wp.uint32(1)
        note_count(volumes.counts, stream, wp.static(SHADOW_RAYS), wp.int64(1))
        _note_collisions(volumes, stream, count, density)
        return share

    return transmitted


@wp.func
def _sought_length(sought: Sought, u: float) -> float:
    """A point by the distance of a light; anywhere where no light has a place, or it is far off [m]."""
    if sought.angle > 0.0:
        return length_by_light(sought, u)
    return sought.first + u * (sought.last - sought.first)


@wp.func
def _sought_density(sought: Sought, t: float) -> float:
    """Density of `_sought_length` at `t` [1/m]."""
    if sought.angle > 0.0:
        return density_by_light(sought, t)
    if t < sought.first or t > sought.last:
        return 0.0
    return 1.0 / (sought.last - sought.first)


@functools.cache
def make_track(programs: ProgramFeatures, weighed: wp.Function | None = None) -> wp.Function:
    """Function (volumes, inside: vec4i, point: ShadingPoint, length: float, throughput: vec3, scatters: bool, sought:
    Sought, stream: uint32, lobes: array of PhaseLobe, lit_lobes: array of PhaseLobe, table: LightTable,
    seen: Seen) -> Track: the way of light of `throughput` from `point` on, which ends at the latest after `length` [m].
    Where it scatters, `lobes` are those that are there; `lit_lobes` are those of the point from which light is looked
    for, if one is sought. `weighed`: as of `make_weighed`, where volumes are emitters, which `seen` and `table` are
    for.
    """
    medium = make_medium(programs)
    fly = make_fly(FLIGHTS, FLIGHTS_MOST, stops=True)

    @wp.func
    def track(
        volumes: VolumeData,
        inside: wp.vec4i,
        point: ShadingPoint,
        length: float,
        throughput: wp.vec3,
        scatters: bool,
        sought: Sought,
        stream: wp.uint32,
        lobes: wp.array(dtype=PhaseLobe),
        lit_lobes: wp.array(dtype=PhaseLobe),
        table: LightTable,
        seen: Seen,
    ) -> Track:
        direction = -point.incoming
        begin = point.position
        way = Track()
        way.weight = wp.vec3(1.0)
        way.length = length
        seeks = sought.seeks != 0
        lit_stream = mix_bits(stream + wp.uint32(wp.static(LIT_STREAM)))
        searches = seeks and sought.last > sought.first
        flown = Flights()
        flown.ahead = wp.inf
        if searches:
            flown.ahead = _sought_length(sought, stream_number(lit_stream, wp.uint32(0)))
        expected = float(0.0)  # of all points so far
        count = int(0)
        density = float(0.0)
        while flown.length < length:
            flown = fly(volumes, inside, begin, direction, point.time, length, stream, flown)
            if not flown.bound > 0.0:
                if flown.length < length:
                    way.event = wp.static(STOPPED)
                    way.length = flown.length
                break
            point.position = begin + flown.length * direction
            m = medium(volumes, inside, point, lobes)
            carried = wp.cw_mul(throughput, way.weight)
            most = densest(m, flown.bound)
            scattered = m.scattering / most
            if seeks and m.lobes > 0:
                share = float(1.0)
                worth = float(1.0)
                if searches:
                    density = _sought_density(sought, flown.length)
                    share = flown.bound / (flown.bound + density)
                    worth = 1.0 + density * (sought.last - sought.first)
                value = share * worth * wp.dot(carried, scattered)
                expected += value
                if stream_number(lit_stream, flown.number) * expected < value:
                    way.lit.length = flown.length
                    way.lit.weight = share * wp.cw_mul(way.weight, scattered) / value
                    way.lit.medium = m
                    for k in range(m.lobes):
                        lit_lobes[k] = lobes[k]
            if flown.collides:
                count += 1
                density += densest(m, 0.0) / most
                if most > flown.bound:
                    _note_exceeded(volumes, stream, most, flown.bound)
                emission = m.emission
                if wp.static(weighed is not None):
                    emission = weighed(volumes, table, seen, inside, point, emission)
                way.emitted += wp.cw_mul(way.weight, emission) / most
                null = wp.vec3(0.0)
                for axis in range(3):
                    null[axis] = wp.max(1.0 - m.extinction[axis] / most, 0.0)
                likely = wp.dot(carried, scattered)
                total = likely + wp.dot(carried, null)
                chance = float(0.0)
                if scatters and total > 0.0:
                    chance = likely / total
                if stream_number(stream, flown.number) < chance:
                    way.weight = wp.cw_mul(way.weight, scattered) / chance
                    way.event = wp.static(SCATTERED)
                    way.length = flown.length
                    way.medium = m
                    break
                way.weight = wp.cw_mul(way.weight, null) / (1.0 - chance)
                flown.number += wp.uint32(1)
                largest = wp.max(way.weight[0], wp.max(way.weight[1], way.weight[2]))
                if not largest > 0.0:
                    break
                if largest < wp.static(_ROULETTE_BELOW):
                    survival = largest / wp.static(_ROULETTE_BELOW)
                    if stream_number(stream, flown.number) >= survival:
                        way.weight = wp.vec3(0.0)
                        break
                    way.weight = way.weight / survival
                    flown.number += wp.uint32(1)
        way.lit.weight = expected * way.lit.weight
        _note_collisions(volumes, stream, count, density)
        return way

    return track
