"""Random rays into closed meshes: not one may slip between two triangles.

A ray that starts inside must hit the mesh, and so must one that starts outside and ends inside. On CUDA all cases
together trace 1e8 rays; on a CPU as many as fit in a few seconds each. `Bench.leak_rays` sets how many every case
traces, on any device.
"""

from __future__ import annotations

import time

import numpy as np
import warp as wp

from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from tests.stability.bench import Bench
from tests.stability.case import Outcome, case
from tests.stability.geometry.meshes import SHEAR, Closed, closed_mesh, placed

FAMILY = "leaks"
MESHES = ("icosphere", "torus knot", "bunny")
CUDA_RAYS = 100_000_000  # rays of all cases
SECONDS, SECONDS_QUICK = 7.0, 2.0  # time of a case on the CPU [s]
BLOCK, CUDA_BLOCK = 1 << 16, 1 << 21  # rays between looks at the clock
OUTSIDE = wp.constant(1.25)  # distance of the origin of outside rays from their end, in diagonals of the mesh's box


@wp.struct
class InnerSource:
    """Source of random rays: the mesh before it is sheared, and balls inside it."""

    positions: wp.array(dtype=wp.vec3)
    triangles: wp.array(dtype=wp.vec3i)
    centre: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    shear: wp.float64  # shear of x by y
    size: float  # diagonal of the mesh's box
    seed: int


@wp.func
def any_direction(state: wp.uint32) -> wp.vec3:
    """A direction, uniform on the sphere; it takes two random numbers."""
    z = 2.0 * wp.randf(state) - 1.0
    angle = 2.0 * wp.pi * wp.randf(state)
    radius = wp.sqrt(wp.max(0.0, 1.0 - z * z))
    return wp.vec3(radius * wp.cos(angle), radius * wp.sin(angle), z)


@wp.func
def sheared(shear: wp.float64, v: wp.vec3) -> wp.vec3:
    """`v` sheared as the mesh is; rounded once."""
    return wp.vec3(float(wp.float64(v[0]) + shear * wp.float64(v[1])), v[1], v[2])


@wp.kernel(**KERNEL_OPTIONS)
def leak_rays_kernel(source: InnerSource, first: int, rays: Rays):
    """Fill in rays `first`, `first` + 1 ... of a run.

    Four in five of them are aimed at features that random rays rarely hit.
    """
    i = wp.tid()
    state = wp.rand_init(source.seed, first + i)
    ball = wp.randi(state, 0, source.centre.shape[0])
    corners = source.triangles[wp.randi(state, 0, source.triangles.shape[0])]
    a, b, c = source.positions[corners[0]], source.positions[corners[1]], source.positions[corners[2]]
    kind = wp.randi(state, 0, 5)
    axis = wp.randi(state, 0, 3)
    inwards = wp.randi(state, 0, 2) == 1
    x, r = wp.randf(state), wp.randf(state)
    d = any_direction(state)
    state += wp.uint32(7919)
    o = source.centre[ball] + any_direction(state) * (source.radius[ball] * wp.cbrt(r))
    if kind == 1:
        d = wp.normalize(a - o)
    elif kind == 2:
        d = wp.normalize(a + x * (b - a) - o)
    elif kind == 3:
        d = wp.normalize((a + b + c) / 3.0 - o)
    inner = sheared(source.shear, o)
    if inwards:
        # from outside to the inner point, where the direction ends
        start = sheared(source.shear, o + d * (OUTSIDE * source.size))
        rays.origin[i] = start
        rays.direction[i] = inner - start
        rays.t_max[i] = 1.0
    else:
        along = sheared(source.shear, d)
        if kind == 4:
            # along an axis, or in any direction of the world
            if r < 0.5:
                along = wp.vec3(0.0, 0.0, 0.0)
                along[axis] = wp.sign(d[axis])
            else:
                along = d
        rays.origin[i] = inner
        rays.direction[i] = wp.normalize(along)
        rays.t_max[i] = wp.float32(wp.inf)
    rays.visibility[i] = 1


@wp.kernel(**KERNEL_OPTIONS)
def escapes_kernel(rays: Rays, first: int, count: wp.array(dtype=int), which: wp.array(dtype=int)):
    """Count the rays that hit nothing, and keep the number of one."""
    i = wp.tid()
    if rays.hit_instance[i] < 0:
        wp.atomic_add(count, 0, 1)
        which[0] = first + i


def source_of(closed: Closed, shear: float, device: wp.Device) -> InnerSource:
    """`closed` on `device`."""
    source = InnerSource()
    source.positions = wp.array(closed.positions.astype(np.float32), dtype=wp.vec3, device=device)
    source.triangles = wp.array(closed.triangles, dtype=wp.vec3i, device=device)
    source.centre = wp.array(closed.centres.astype(np.float32), dtype=wp.vec3, device=device)
    source.radius = wp.array(closed.radii.astype(np.float32), dtype=float, device=device)
    source.shear = shear
    source.size = float(np.linalg.norm(np.ptp(closed.positions, axis=0)))
    source.seed = 1
    return source


def _leaks(bench: Bench, name: str, shear: float, seconds: float) -> Outcome:
    """Outcome: how many rays slip through."""
    closed, device = closed_mesh(name), bench.wp_device
    source = source_of(closed, shear, device)
    wanted = bench.leak_rays
    if not wanted and device.is_cuda:
        wanted = -(-CUDA_RAYS // (2 * 2 * len(MESHES)))
    block = CUDA_BLOCK if device.is_cuda else BLOCK
    if shear and not device.is_cuda and bench.tracer == "on":
        # the margin of boxes follows the long axis, so that rays visit most treelets
        block >>= 1 if len(closed.triangles) < 100_000 else 3
    tracer = bench.tracer_of(placed(closed.sheared(shear)), block)
    found: list[tuple[int, int]] = []  # rays that hit nothing, and the number of one, by part

    def fill(rays: Rays, first: int, n: int) -> None:
        wp.launch(leak_rays_kernel, n, [source, begun + first, rays], device=device)

    def done(rays: Rays, first: int, n: int) -> None:
        count, which = (wp.zeros(1, dtype=int, device=device) for _ in range(2))
        wp.launch(escapes_kernel, n, [rays, begun + first, count, which], device=device)
        found.append((int(count.numpy()[0]), int(which.numpy()[0])))

    load_kernels([leak_rays_kernel, escapes_kernel], device, lambda done, total: None)
    begun, number, start = 0, 0, time.perf_counter()
    while begun < wanted if wanted else begun == 0 or time.perf_counter() - start < seconds:
        count = min(block, wanted - begun) if wanted else block
        # every third block looks for any hit
        tracer.run(count, fill, number % 3 == 2, done)
        begun, number = begun + count, number + 1
    leaks = sum(count for count, _ in found)
    example = next((f"; ray {which} is one of them" for count, which in found if count), "")
    return Outcome(
        float(leaks),
        0.0,
        0.0,
        f"{begun:,} rays in {time.perf_counter() - start:.1f} s, {leaks} slipped through{example}",
    )


ABOUT = """Rays from inside in all directions, at corners, at edges, along axes, and rays from outside that end inside;
every third block of them asks for any hit. A closed mesh must be met by all (the count is in the note). """
BOUND = """Neighbours share their corners, the signs of edge functions are exact, so a ray can slip through only where
rounding moves the surface past its end: not one. Ends inside are farther from the surface (0.19 of the sphere's radius,
0.13 of the knot, 0.03 of the bunny) than the 5 u m by which corners are moved. """
SHEARED = """With the shear, a corner that matters to a ray is off by 2 u (1 + 1000 e) across the shear's long axis, e
the length of an edge (0.1 at most, of the bunny 0.024); carried back through the shear that is 0.013 of the mesh's unit
(0.003), still less."""


def _register(name: str) -> None:
    @case(f"leaks: {name}", FAMILY, ABOUT, BOUND)
    def plain(bench: Bench) -> Outcome:
        return _leaks(bench, name, 0.0, SECONDS)

    quick = name == "torus knot"

    @case(
        f"leaks: {name}, sheared",
        FAMILY,
        ABOUT + "The mesh is sheared, x by 1000 y: condition 1e6.",
        BOUND + SHEARED,
        quick=quick,
    )
    def sheared_mesh(bench: Bench) -> Outcome:
        return _leaks(bench, name, SHEAR, SECONDS_QUICK if quick else SECONDS)


for _name in MESHES:
    _register(_name)
