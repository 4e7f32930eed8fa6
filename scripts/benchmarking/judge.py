"""Whose hit is right, where tracers disagree: every triangle is asked, in float64.

Tracers work in float32, so what they must find is known up to an error: a ray that passes an edge nearer than the bound
below may hit the triangle or miss it. For each ray this file finds the farthest distance at which a closest hit may
still be (the nearest triangle that is hit for certain), and the nearest at which one can be (the nearest triangle that
is not missed for certain). An answer outside of these is a fault.

The bound is that of the project's own triangle test, in roundings of the largest coordinate of the triangle's corners,
taken from the ray's origin: 32 of where edges are, 25 a coordinate of where the plane is. Where there are instances,
rays are carried to them first: 32 roundings of the largest coordinate of the ray's origin and of the geometry, both
taken from the middle of the geometry's box, come on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.tracers.interface import Hits
from raybatch_addon.core.bvh.margin import TRIANGLE_TEST  # surfaces move the origins of rays that leave them by no less
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.float32 import UNIT_ROUNDOFF
from raybatch_addon.core.scene.description import Visibility
from raybatch_addon.core.scene.flatten import FlatGeometry

ROUNDINGS = 32
RELATIVE_BOUND = ROUNDINGS * UNIT_ROUNDOFF * 3**0.5  # of a length, from that of a coordinate
# A ray that passes through a triangle and no nearer to its edges than the bound meets its plane at more than 16
# roundings [rad]; what float64 finds for flatter ones is noise
FLATTEST = 2.0**-23
CHUNK = 1 << 14  # triangles of one thread
FAULTY_MOST = 100
PAIRS_MAX = {"cpu": 500_000_000, "cuda": 200_000_000_000}  # rays times triangles of one judgement


@dataclass(frozen=True)
class Verdict:
    """How one tracer's hits compare with those of another."""

    disagreements: int  # rays whose hits differ from the other's by more than roundings
    judged: int  # of these, for how many float64 was asked
    faults: int  # of these, how many answers of this tracer are wrong
    faulty: tuple[int, ...] = ()  # of these, the first `FAULTY_MOST`, as indices of the rays that were judged


@wp.struct
class Certainty:
    """The limits of answers that float32 may find."""

    hit_before: wp.float64  # an answer beyond this is too far [m]; infinite: a miss is right
    hit_after: wp.float64  # an answer before this is too near [m]; infinite: a hit is wrong


@wp.func
def edge_closest(p: wp.vec3d, e: wp.vec3d, d: wp.vec3d) -> wp.vec2d:
    """Distance of the edge from `p` to `p + e` to the line through the origin along the unit vector `d`, and how far
    along `d`.
    """
    across = p - d * wp.dot(p, d)
    along = e - d * wp.dot(e, d)
    length = wp.dot(along, along)
    share = wp.float64(0.0)
    if length > wp.float64(0.0):
        share = wp.clamp(-wp.dot(across, along) / length, wp.float64(0.0), wp.float64(1.0))
    return wp.vec2d(wp.length(across + along * share), wp.dot(p + e * share, d))


@wp.func
def certainty(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, d: wp.vec3d, t_max: wp.float64, carried: wp.float64) -> Certainty:
    """Certainty of the triangle a, b, c, taken relative to the origin of a ray along the unit vector `d`, which was
    carried there with the error `carried`.
    """
    result = Certainty()
    reach = wp.max(wp.max(wp.abs(a)), wp.max(wp.max(wp.abs(b)), wp.max(wp.abs(c))))
    bound = carried + wp.float64(RELATIVE_BOUND) * reach
    result.hit_before = wp.float64(wp.inf)
    result.hit_after = wp.float64(wp.inf)
    normal = wp.cross(b - a, c - a)
    facing = wp.dot(normal, d)
    # across the ray corners are small, and so is what the products round off, however far away the origin is
    pa, pb, pc = a - d * wp.dot(a, d), b - d * wp.dot(b, d), c - d * wp.dot(c, d)
    u = wp.dot(d, wp.cross(pb, pc))
    v = wp.dot(d, wp.cross(pc, pa))
    w = wp.dot(d, wp.cross(pa, pb))
    inside = wp.abs(facing) > wp.float64(FLATTEST) * wp.length(normal) and (
        wp.min(wp.min(u, v), w) >= wp.float64(0.0) or wp.max(wp.max(u, v), w) <= wp.float64(0.0)
    )
    nearest = edge_closest(a, b - a, d)
    second = edge_closest(b, c - b, d)
    third = edge_closest(c, a - c, d)
    if second[0] < nearest[0]:
        nearest = second
    if third[0] < nearest[0]:
        nearest = third
    if not inside and nearest[0] > bound:
        return result
    t = nearest[1]
    error = wp.float64(wp.inf)
    if facing != wp.float64(0.0):
        across = wp.abs(normal[0]) + wp.abs(normal[1]) + wp.abs(normal[2])
        error = (carried * wp.length(normal) + wp.float64(TRIANGLE_TEST) * reach * across) / wp.abs(facing)
    if inside:
        t = wp.dot(a, normal) / facing
    # however flat it is met, the hit is on the triangle
    low = wp.max(t - error, wp.min(wp.min(wp.dot(a, d), wp.dot(b, d)), wp.dot(c, d)) - bound)
    high = wp.min(t + error, wp.max(wp.max(wp.dot(a, d), wp.dot(b, d)), wp.dot(c, d)) + bound)
    if high > wp.float64(0.0) and low < t_max:
        result.hit_after = low
    if inside and nearest[0] > bound and low > wp.float64(0.0) and high < t_max:
        result.hit_before = high
    return result


@wp.struct
class JudgedRays:
    """Rays under judgement, in float64."""

    origin: wp.array(dtype=wp.vec3d)
    direction: wp.array(dtype=wp.vec3d)  # unit length
    t_max: wp.array(dtype=wp.float64)
    visibility: wp.array(dtype=int)
    carried: wp.array(dtype=wp.float64)  # error of their way to instances [m]


@wp.kernel(**KERNEL_OPTIONS)
def judge_kernel(
    positions: wp.array(dtype=wp.vec3),
    triangles: wp.array(dtype=wp.vec3i),
    visibility: wp.array(dtype=int),
    rays: JudgedRays,
    chunk: int,
    hit_before: wp.array2d(dtype=wp.float64),
    hit_after: wp.array2d(dtype=wp.float64),
):
    ray, part = wp.tid()
    origin = rays.origin[ray]
    before = wp.float64(wp.inf)
    after = wp.float64(wp.inf)
    for i in range(part * chunk, wp.min((part + 1) * chunk, triangles.shape[0])):
        if visibility.shape[0] == 0 or (visibility[i] & rays.visibility[ray]) != 0:
            corners = triangles[i]
            found = certainty(
                wp.vec3d(positions[corners[0]]) - origin,
                wp.vec3d(positions[corners[1]]) - origin,
                wp.vec3d(positions[corners[2]]) - origin,
                rays.direction[ray],
                rays.t_max[ray],
                rays.carried[ray],
            )
            before = wp.min(before, found.hit_before)
            after = wp.min(after, found.hit_after)
    hit_before[ray, part] = before
    hit_after[ray, part] = after


class Judge:
    """All triangles of a scene in their places."""

    def __init__(self, flat: FlatGeometry, instance_visibility: np.ndarray, device: wp.Device):
        positions, triangles, visibility = placed_triangles(flat, instance_visibility)
        low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
        self._device = device
        self._instances = len(flat.shared) > 0
        self._centre, self._extent = (low + high) / 2, float((high - low).max()) / 2
        self._positions = wp.array(positions, dtype=wp.vec3, device=device)
        self._triangles = wp.array(triangles, dtype=wp.vec3i, device=device)
        self._visibility = wp.array(visibility, dtype=int, device=device)

    def _scale(self, origin: np.ndarray) -> np.ndarray:
        """Largest coordinates of rays and geometry, from the middle of the geometry [m], float64, shape [n]."""
        return np.abs(origin - self._centre).max(1) + self._extent

    def certainties(self, rays: CapturedRays) -> tuple[np.ndarray, np.ndarray]:
        """The farthest and the nearest right answer, float64, shape [n] each; see `Certainty`."""
        judged = JudgedRays()
        origin, direction = rays.origin.astype(np.float64), rays.direction.astype(np.float64)
        length = np.linalg.norm(direction, axis=1)
        with wp.ScopedDevice(self._device):
            judged.origin = wp.array(origin, dtype=wp.vec3d)
            judged.direction = wp.array(direction / length[:, None], dtype=wp.vec3d)
            judged.t_max = wp.array(rays.t_max * length, dtype=wp.float64)
            judged.visibility = wp.array(rays.visibility, dtype=int)
            judged.carried = wp.array(RELATIVE_BOUND * self._scale(origin) * self._instances, dtype=wp.float64)
            parts = -(-len(self._triangles) // CHUNK)
            before, after = (wp.empty((len(rays), parts), dtype=wp.float64) for _ in range(2))
            inputs = [self._positions, self._triangles, self._visibility, judged, CHUNK, before, after]
            wp.launch(judge_kernel, (len(rays), parts), inputs)
        return before.numpy().min(1) / length, after.numpy().min(1) / length

    def compare(self, rays: CapturedRays, hits: Hits, other: Hits) -> Verdict:
        """Judge `hits` where they differ from those of `other`."""
        return self._judged(rays, np.flatnonzero(self._differ(rays, hits, other)), hits)[0]

    def compare_both(self, rays: CapturedRays, hits: Hits, other: Hits) -> tuple[Verdict, Verdict]:
        """Judge `hits`, and those of `other`, where they differ from each other."""
        differ = self._differ(rays, hits, other) | self._differ(rays, other, hits)
        mine, theirs = self._judged(rays, np.flatnonzero(differ), hits, other)
        return mine, theirs

    def _differ(self, rays: CapturedRays, hits: Hits, other: Hits) -> np.ndarray:
        """By ray: whether its hits differ by more than roundings."""
        differ = hits.hit != other.hit
        if hits.t is not None:
            both = hits.hit & other.hit
            mine, theirs = (np.where(both, each.t, 0).astype(np.float64) for each in (hits, other))
            differ |= np.abs(mine - theirs) > 8 * UNIT_ROUNDOFF * (self._scale(rays.origin) + theirs)
        return differ

    def _judged(self, rays: CapturedRays, where: np.ndarray, *answers: Hits) -> list[Verdict]:
        """Judge `answers` for the rays `where`, or of more than there is time for, for some that lie evenly in them."""
        most = max(1, PAIRS_MAX["cuda" if self._device.is_cuda else "cpu"] // len(self._triangles))
        judged = where[np.linspace(0, len(where) - 1, most).astype(int)] if len(where) > most else where
        if not len(judged):
            return [Verdict(0, 0, 0)] * len(answers)
        before, after = self.certainties(rays.taken(judged))
        wrong = [
            faults(each.hit[judged], None if each.t is None else each.t[judged], before, after) for each in answers
        ]
        return [
            Verdict(len(where), len(judged), int(each.sum()), tuple(judged[each][:FAULTY_MOST].tolist()))
            for each in wrong
        ]


def faults(hit: np.ndarray, t: np.ndarray | None, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Which answers are wrong, bool, shape [n]; `before` and `after` as `Judge.certainties` gives them."""
    if t is None:
        return np.where(hit, np.isinf(after), np.isfinite(before))
    return np.where(hit, (t > before) | (t < after), np.isfinite(before))


def placed_triangles(flat: FlatGeometry, instance_visibility: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, triangles and their visibility with every instance in its place; no visibility where all see all."""
    if len(flat.shared) == 0 and [group.visibility for group in flat.merged] == [int(Visibility.ALL)]:
        return flat.positions, flat.triangles, np.zeros(0, np.int32)
    positions, triangles, visibility, vertex_count = [flat.positions], [], [], len(flat.positions)
    for group in flat.merged:
        part = flat.triangles[group.triangle_first : group.triangle_first + group.triangle_count]
        triangles.append(part)
        visibility.append(np.full(len(part), group.visibility, np.int32))
    for i in flat.shared.tolist():
        mesh = int(flat.instance_mesh[i])
        part = flat.triangles[flat.mesh_triangle_first[mesh] : flat.mesh_triangle_first[mesh + 1]]
        vertices, index = np.unique(part, return_inverse=True)
        matrix = flat.instance_transform[i].astype(np.float64)
        positions.append((flat.positions[vertices] @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32))
        triangles.append((index.reshape(-1, 3) + vertex_count).astype(np.int32))
        visibility.append(np.full(len(part), int(instance_visibility[i]), np.int32))
        vertex_count += len(vertices)
    return np.concatenate(positions), np.concatenate(triangles), np.concatenate(visibility)
