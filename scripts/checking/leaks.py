"""Rays from inside a closed mesh: every one of them must meet it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import warp as wp
from benchmarking.judge import RELATIVE_BOUND, placed_triangles
from benchmarking.scenes import BenchmarkScene

from checking.comparing import ray_record
from checking.placing import with_instances
from checking.rays import PLACE_GROWN, RaySource, make_source, random_direction, with_component
from checking.trees import TreeTracer, build_tracer, reference_tracer, slot_lists, thread_count_of
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.description import Instances, Mesh, Visibility
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.rays import allocate_rays

CANDIDATES = 256  # places that are looked at
CLEARANCE = 64  # an inner place is so many times the bound away from the surface
BALL = 0.9  # of the distance to the surface: rays start in a ball so large
REFERENCE_RAYS = 10**6
BALL_INSTANCES = 4
BALL_RINGS = 160  # 102,000 triangles
BALL_SIZES = (1.0, 1e-16, 1e16)  # near the limits products of coordinates all but leave float32 [m]
OFFSET = 20.0  # of generated meshes from the origin, in radii
MIXED_KINDS = wp.constant(4)  # any direction, at a corner, at an edge, axis-parallel


@wp.struct
class InnerPlaces:
    """Balls inside a closed mesh."""

    centre: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)


@wp.func
def nearest_on_triangle(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """The point of a triangle nearest to 0 (Ericson 2005, "Real-time collision detection", 5.1.5)."""
    ab, ac, zero = b - a, c - a, wp.float64(0.0)
    d1, d2 = -wp.dot(ab, a), -wp.dot(ac, a)
    d3, d4 = -wp.dot(ab, b), -wp.dot(ac, b)
    d5, d6 = -wp.dot(ab, c), -wp.dot(ac, c)
    if d1 <= zero and d2 <= zero:
        return a
    if d3 >= zero and d4 <= d3:
        return b
    if d6 >= zero and d5 <= d6:
        return c
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if vc <= zero and d1 >= zero and d3 <= zero:
        return a + ab * (d1 / (d1 - d3))
    if vb <= zero and d2 >= zero and d6 <= zero:
        return a + ac * (d2 / (d2 - d6))
    if va <= zero and d4 >= d3 and d5 >= d6:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    total = va + vb + vc
    return a + ab * (vb / total) + ac * (vc / total)


@wp.kernel(**KERNEL_OPTIONS)
def enclosure_kernel(
    source: RaySource,
    places: wp.array(dtype=wp.vec3),
    chunk: int,
    winding: wp.array2d(dtype=wp.float64),
    distance: wp.array2d(dtype=wp.float64),
):
    """How often the mesh winds around each place (Van Oosterom and Strackee 1983), and its least distance [m]; by parts
    of the mesh.
    """
    place, part = wp.tid()
    o = wp.vec3d(places[place])
    angle = wp.float64(0.0)
    nearest = wp.float64(wp.inf)
    for i in range(part * chunk, wp.min((part + 1) * chunk, source.triangles.shape[0])):
        corners = source.triangles[i]
        a, b = wp.vec3d(source.positions[corners[0]]) - o, wp.vec3d(source.positions[corners[1]]) - o
        c = wp.vec3d(source.positions[corners[2]]) - o
        nearest = wp.min(nearest, wp.length(nearest_on_triangle(a, b, c)))
        la, lb, lc = wp.length(a), wp.length(b), wp.length(c)
        angle += wp.atan2(
            wp.dot(a, wp.cross(b, c)), la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
        )
    winding[place, part] = angle / wp.float64(2.0 * wp.pi)
    distance[place, part] = nearest


@wp.kernel(**KERNEL_OPTIONS)
def inner_rays_kernel(source: RaySource, inner: InnerPlaces, first: int, rays: Rays):
    """Rays `first`, `first` + 1 ... from `inner`."""
    i = wp.tid()
    state = wp.rand_init(source.seed, first + i)
    ball = wp.randi(state, 0, inner.centre.shape[0])
    corners = source.triangles[wp.randi(state, 0, source.triangles.shape[0])]
    a, b = source.positions[corners[0]], source.positions[corners[1]]
    x, r = wp.randf(state), wp.randf(state)
    kind = wp.randi(state, 0, MIXED_KINDS)
    axis = wp.randi(state, 0, 3)
    d = random_direction(state)
    state += wp.uint32(7919)
    o = inner.centre[ball] + random_direction(state) * (inner.radius[ball] * wp.cbrt(r))
    if kind == 1:
        d = a - o
    elif kind == 2:
        d = a + x * (b - a) - o
    elif kind == 3:
        sign = wp.sign(d[axis])
        d = with_component(d - d, axis, sign)
    rays.origin[i] = o
    rays.direction[i] = d
    rays.t_max[i] = wp.float32(wp.inf)
    rays.visibility[i] = 1


@wp.kernel(**KERNEL_OPTIONS)
def escapes_kernel(rays: Rays, count: wp.array(dtype=int), which: wp.array(dtype=int)):
    """Count the rays that met nothing, and keep one of them."""
    i = wp.tid()
    if rays.hit_instance[i] < 0:
        wp.atomic_add(count, 0, 1)
        which[0] = i


def is_closed(positions: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether every edge is used as often in one direction as in the other; corners at one place are the same."""
    _, corner = np.unique(positions, axis=0, return_inverse=True)
    corner = corner.reshape(-1).astype(np.int64)[triangles]
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = len(positions)
    return np.array_equal(np.sort(edges[:, 0] * count + edges[:, 1]), np.sort(edges[:, 1] * count + edges[:, 0]))


def bumpy_ball(seed: int, size: float = 1.0, rings: int = BALL_RINGS) -> Mesh:
    """A closed ball with bumps and slivers, of the radius `size` [m], far from the origin for that."""
    generator = np.random.default_rng(seed)
    segments = 2 * rings
    polar = np.pi * np.arange(1, rings)[:, None] / rings
    around = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)), -1
    )
    ring = ring * generator.uniform(0.6, 1.4, ring.shape[:2])[..., None]
    # every fifth vertex all but meets its neighbour: slivers of an aspect of 1e5 and more
    pairs = np.arange(0, segments - 1, 5)
    ring[:, pairs] += (ring[:, pairs + 1] - ring[:, pairs]) * (
        1 - 10.0 ** generator.uniform(-6, -3, (rings - 1, len(pairs), 1))
    )
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1.0], [0, 0, -1.0]]]) + OFFSET
    north, south = len(vertices) - 2, len(vertices) - 1
    here = np.arange((rings - 1) * segments).reshape(rings - 1, segments)
    beside = np.roll(here, -1, axis=1)
    sides = [(here[:-1], here[1:], beside[1:]), (here[:-1], beside[1:], beside[:-1])]
    triangles = [
        np.stack(np.broadcast_arrays(*corners), -1).reshape(-1, 3)
        for corners in (*sides, (north, here[0], beside[0]), (south, beside[-1], here[-1]))
    ]
    return Mesh(
        f"bumpy ball of {size:g} m", (size * vertices).astype(np.float32), np.concatenate(triangles).astype(np.int32)
    )


def inner_places(source: RaySource, seed: int, device: wp.Device) -> InnerPlaces:
    """Balls of many sizes in the mesh, which is closed."""
    generator = np.random.default_rng(seed)
    half, centre = np.array(source.half), np.array(source.centre)
    places = (centre + half * generator.uniform(-1, 1, (CANDIDATES, 3)) / PLACE_GROWN).astype(np.float32)
    places[0] = centre
    chunk = 1 << 14
    parts = -(-len(source.triangles) // chunk)
    winding, distance = (wp.empty((CANDIDATES, parts), dtype=wp.float64, device=device) for _ in range(2))
    wp.launch(
        enclosure_kernel,
        (CANDIDATES, parts),
        [source, wp.array(places, dtype=wp.vec3, device=device), chunk, winding, distance],
        device=device,
    )
    turns, nearest = winding.numpy().sum(1), distance.numpy().min(1)
    scale = np.abs(places - centre).max(1) + source.extent + np.abs(places).max(1)
    good = (np.abs(turns) > 0.5) & (nearest > CLEARANCE * RELATIVE_BOUND * scale)
    if not good.any():
        raise RuntimeError("no place inside the mesh was found")
    inner = InnerPlaces()
    inner.centre = wp.array(places[good], dtype=wp.vec3, device=device)
    inner.radius = wp.array((BALL * nearest[good]).astype(np.float32), dtype=float, device=device)
    return inner


class LeakTest:
    """One closed scene, its trees, and how many of its rays escaped."""

    def __init__(self, scene: BenchmarkScene, trees: list[TreeTracer], seed: int, chunk: int, device: wp.Device):
        self.name, self.triangles, self.trees = scene.name, scene.triangle_count, trees
        self.rays, self.escapes, self.example = 0, 0, None
        positions, triangles, _ = placed_triangles(scene.flat, scene.scene.instances.visibility)
        self._source = make_source(positions, triangles, seed, device)
        self._inner = inner_places(self._source, seed, device)
        self._device, self._buffer = device, allocate_rays(chunk, device)
        self._found = [wp.zeros(1, dtype=int, device=device) for _ in range(2)]

    def trace(self, tracer: TreeTracer, first: int, lists: list) -> int:
        """Escapes of rays `first`, `first` + 1 ..., as many as `lists` have."""
        count = sum(listed.bound for listed in lists)
        wp.launch(inner_rays_kernel, count, [self._source, self._inner, first, self._buffer], device=self._device)
        tracer.trace(self._buffer, lists)
        self._found[0].zero_()
        wp.launch(escapes_kernel, count, [self._buffer, *self._found], device=self._device)
        return int(self._found[0].numpy()[0])

    def run(self, count: int, chunk: int) -> None:
        """Trace `count` rays; trees take turns."""
        whole, lists = chunk, slot_lists(min(chunk, count), thread_count_of(self._device), self._device)
        for number, first in enumerate(range(0, count, chunk)):
            if count - first < whole:
                whole = count - first
                lists = slot_lists(whole, thread_count_of(self._device), self._device)
            tracer = self.trees[number % len(self.trees)]
            escaped = self.trace(tracer, first, lists)
            self.rays += whole
            self.escapes += escaped
            if escaped and self.example is None:
                self.example = {"tree": tracer.name, **ray_record(self._buffer, int(self._found[1].numpy()[0]))}

    def of_reference(self, reference: TreeTracer, count: int) -> int:
        """How many of `count` rays escape in Warp's tree."""
        return self.trace(reference, 0, slot_lists(count, thread_count_of(self._device), self._device))


def closed_scenes(scene: BenchmarkScene, seed: int) -> list[BenchmarkScene]:
    """Generated closed meshes of the sizes BALL_SIZES (with instances where `scene` has some), and `scene` itself if it
    is one closed mesh.
    """
    one = np.zeros(1, np.int32)
    placed = Instances(one, np.eye(3, 4, dtype=np.float32)[None], one, np.array([int(Visibility.ALL)], np.int32), one)
    made = []
    for size in BALL_SIZES:
        ball = dataclasses.replace(scene.scene, meshes=(bumpy_ball(seed, size, BALL_RINGS),), instances=placed)
        made.append(BenchmarkScene(ball.meshes[0].name, ball, scene.settings, flatten(ball), False))
    if scene.instancing:
        return [with_instances(each, BALL_INSTANCES, seed, seen_by_all=True) for each in made]
    return made + [scene] * is_closed(scene.flat.positions, scene.flat.triangles)


def check_leaks(
    scene: BenchmarkScene,
    trees: list[TreeTracer],
    reference: TreeTracer,
    count: int,
    chunk: int,
    seed: int,
    device: wp.Device,
) -> dict[str, Any]:
    """Trace `count` rays from inside closed meshes with `trees` of `scene`, or such as these."""
    reported = []
    closed = closed_scenes(scene, seed)
    for each in closed:
        own, peer = trees, reference
        if each is not scene:
            geometry = upload_geometry(each.flat, each.scene, device)
            own = [build_tracer(tree.name, each, geometry, device, seed) for tree in trees]
            peer = reference_tracer(each, device)
            for tracer in (*own, peer):
                tracer.load(device, thread_count_of(device))
        chunk = min(chunk, count)
        test = LeakTest(each, own, seed, chunk, device)
        test.run(-(-count // len(closed)), chunk)
        escaped = test.of_reference(peer, min(chunk, REFERENCE_RAYS))
        reported.append(
            {
                "mesh": test.name,
                "triangles": test.triangles,
                "rays": test.rays,
                "escapes": test.escapes,
                "example": test.example,
                "reference_rays": min(chunk, REFERENCE_RAYS),
                "reference_escapes": escaped,
            }
        )
    return {
        "rays": sum(each["rays"] for each in reported),
        "escapes": sum(each["escapes"] for each in reported),
        "meshes": reported,
    }
