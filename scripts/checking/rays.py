"""Rays that try a tracer: random ones, and such as meet what is rare in pictures. They are made on the device."""

from __future__ import annotations

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.description import Visibility

# What ray i of a run is, by `i % len(PATTERN)`: an index into KINDS
KINDS = (
    "random",  # from anywhere in and around the box, in any direction
    "at corners",  # of triangles
    "at edges",
    "along edges",  # from a corner, or from the edge's line
    "in planes",  # from a triangle's plane, to a point of it
    "axis-parallel",  # with exact zeros of either sign, many through corners
    "from surfaces",  # from corners, edges and points of triangles, in any direction
    "from afar",  # at corners, edges and points of triangles, from 1e3 to 1e5 times the box away
    "tiny components",  # down to the numbers below the normal ones
    "any length",  # of the direction: 1e-6 to 1e6
)
# From afar the bound on errors is as large as parts of the scene, and rays visit as much: these are few
PATTERN = (0, 1, 2, 3, 4, 5, 6, 0, 8, 9, 0, 0) * 7 + (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0, 0)
(AT_CORNERS, AT_EDGES, ALONG_EDGES, IN_PLANES, AXIS_PARALLEL, FROM_SURFACES, FROM_AFAR, TINY_COMPONENTS, ANY_LENGTH) = (
    map(wp.constant, range(1, 10))
)
VISIBILITY_BITS = wp.constant(int(Visibility.ALL).bit_count())
PLACE_GROWN = 1.5  # origins lie in the box, made so much larger


@wp.struct
class RaySource:
    """The triangles that rays are made from."""

    positions: wp.array(dtype=wp.vec3)  # in the world [m]
    triangles: wp.array(dtype=wp.vec3i)
    centre: wp.vec3  # of the box of all that is used
    half: wp.vec3  # of its sides
    extent: float  # the longest side
    seed: int


def make_source(positions: np.ndarray, triangles: np.ndarray, seed: int, device: wp.Device) -> RaySource:
    """Rays at `triangles`, int32 [m, 3], of `positions`, float32 [v, 3], all in the world."""
    used = positions[np.unique(triangles)].astype(np.float64)
    low, high = used.min(0), used.max(0)
    source = RaySource()
    source.positions = wp.array(positions, dtype=wp.vec3, device=device)
    source.triangles = wp.array(triangles, dtype=wp.vec3i, device=device)
    source.centre = wp.vec3(*((low + high) / 2).tolist())
    source.half = wp.vec3(*(PLACE_GROWN * (high - low) / 2).tolist())
    source.extent = float((high - low).max())
    source.seed = seed
    return source


@wp.func
def random_direction(state: wp.uint32) -> wp.vec3:
    """Uniform on the sphere; the state after it is that of two numbers later."""
    z = 2.0 * wp.randf(state) - 1.0
    angle = 2.0 * wp.pi * wp.randf(state)
    radius = wp.sqrt(wp.max(0.0, 1.0 - z * z))
    return wp.vec3(radius * wp.cos(angle), radius * wp.sin(angle), z)


@wp.func
def with_component(v: wp.vec3, axis: int, value: float) -> wp.vec3:
    """`v` with another component."""
    if axis == 0:
        v = wp.vec3(value, v[1], v[2])
    elif axis == 1:
        v = wp.vec3(v[0], value, v[2])
    else:
        v = wp.vec3(v[0], v[1], value)
    return v


@wp.kernel(**KERNEL_OPTIONS)
def make_rays_kernel(source: RaySource, pattern: wp.array(dtype=int), first: int, rays: Rays):
    """Rays `first`, `first` + 1 ... of a run."""
    i = wp.tid()
    number = first + i
    kind = pattern[number % pattern.shape[0]]
    state = wp.rand_init(source.seed, number)
    h = source.half
    corners = source.triangles[wp.randi(state, 0, source.triangles.shape[0])]
    turn = wp.randi(state, 0, 3)
    a = source.positions[corners[turn]]
    b = source.positions[corners[(turn + 1) % 3]]
    c = source.positions[corners[(turn + 2) % 3]]
    # a point of the triangle: a corner, on an edge, or inside
    x, y = wp.randf(state), wp.randf(state)
    if x + y > 1.0:
        x = 1.0 - x
        y = 1.0 - y
    where = wp.randi(state, 0, 3)
    if kind == AT_CORNERS:
        where = 0
    if kind == AT_EDGES:
        where = 1
    target = wp.vec3(a)
    if where == 1:
        target = a + x * (b - a)
    if where == 2:
        target = a + x * (b - a) + y * (c - a)
    any_direction = random_direction(state)
    state += wp.uint32(7919)
    o = source.centre + wp.vec3(
        h[0] * (2.0 * wp.randf(state) - 1.0), h[1] * (2.0 * wp.randf(state) - 1.0), h[2] * (2.0 * wp.randf(state) - 1.0)
    )
    p, q, r = wp.randf(state), wp.randf(state), wp.randf(state)
    choice = wp.randi(state, 0, 6)
    sign = 1.0
    if choice % 2 == 1:
        sign = -1.0
    d = wp.vec3(any_direction)

    if kind == AT_CORNERS or kind == AT_EDGES or kind == ANY_LENGTH:
        d = target - o
    elif kind == ALONG_EDGES:
        # the origin is a corner, or where rounding puts it on the edge's line
        if choice < 4:
            o = a - (4.0 * p) * (b - a)
        else:
            o = a
        d = sign * (b - a)
    elif kind == IN_PLANES:
        o = a + (8.0 * p - 4.0) * (b - a) + (8.0 * q - 4.0) * (c - a)
        d = target - o
    elif kind == AXIS_PARALLEL:
        axis = choice / 2
        d = wp.vec3(sign, sign, sign)
        other = (axis + 1 + wp.randi(state, 0, 2)) % 3
        for k in range(3):
            # one axis, sometimes two; the others are +0 or -0
            if k != axis and not (k == other and p < 0.3):
                zero = 0.0
                if wp.randf(state) < 0.5:
                    zero = -0.0
                d = with_component(d, k, zero)
            elif k == other and p < 0.3:
                d = with_component(d, k, any_direction[k])
            if wp.randf(state) < 0.7:
                o = with_component(o, k, target[k])
        o = with_component(o, axis, source.centre[axis] - sign * h[axis] * q)
    elif kind == FROM_SURFACES:
        o = target
        if choice == 0:
            d = source.positions[corners[(turn + 1) % 3]] - o
    elif kind == FROM_AFAR:
        o = source.centre + any_direction * (source.extent * wp.pow(10.0, 3.0 + 2.0 * p))
        d = target - o
    elif kind == TINY_COMPONENTS:
        for k in range(3):
            if wp.randf(state) < 0.5 and k != choice / 2:
                d = with_component(d, k, d[k] * wp.pow(10.0, -44.0 * wp.randf(state)))
            if wp.randf(state) < 0.5:
                o = with_component(o, k, target[k])

    length = wp.max(wp.abs(d))
    if not (length > 0.0 and wp.isfinite(length)):  # a triangle without area, or an origin that is the target
        d = any_direction
    if r < 0.5 or kind == FROM_AFAR:
        d = wp.normalize(d / wp.max(wp.abs(d)))
    if kind == ANY_LENGTH:
        d = d * wp.pow(10.0, 12.0 * p - 6.0)
    rays.origin[i] = o
    rays.direction[i] = d
    # some end before they leave the box
    limit = float(wp.inf)
    if q < 0.25:
        limit = 2.0 * q * (source.extent + wp.length(o - source.centre)) / wp.length(d)
    rays.t_max[i] = limit
    rays.visibility[i] = 1 << wp.randi(state, 0, VISIBILITY_BITS)


def kinds_of(first: int, count: int) -> np.ndarray:
    """Indices into KINDS of rays `first`, `first` + 1 ..., int32, shape [count]."""
    return np.asarray(PATTERN, np.int32)[(first + np.arange(count)) % len(PATTERN)]
