"""The judge of `benchmarking/judge.py` for many rays, in float64: answers that may be found, and hits against the
triangles that they name.

Every triangle is asked, but triangles whose common box a ray misses by more than the bound are passed together: plain
loops over boxes, no tree of the project's.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from benchmarking.judge import RELATIVE_BOUND, JudgedRays, certainty, placed_triangles
from benchmarking.orders import sort_keys
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import slices

from checking.trees import on_threads, thread_count_of
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays
from raybatch_addon.core.scene.geometry import Geometry

BLOCK = 32  # triangles in a box, and boxes in a larger one
WEIGHTS_BOUND = wp.constant(wp.float64(2.0**-20))  # of barycentric weights beyond 0 and 1


@wp.struct
class Blocks:
    """Triangles in their places, along a Morton curve."""

    positions: wp.array(dtype=wp.vec3)
    triangles: wp.array(dtype=wp.vec3i)
    visibility: wp.array(dtype=int)  # no entries where all rays see all
    low: wp.array(dtype=wp.vec3)  # of BLOCK triangles
    high: wp.array(dtype=wp.vec3)
    group_low: wp.array(dtype=wp.vec3)  # of BLOCK boxes
    group_high: wp.array(dtype=wp.vec3)


@wp.func
def may_meet(low: wp.vec3, high: wp.vec3, o: wp.vec3d, d: wp.vec3d, carried: wp.float64, before: wp.float64) -> bool:
    """Whether a triangle in the box may matter to the ray along the unit vector `d`, nearer than `before`."""
    a, b = wp.vec3d(low) - o, wp.vec3d(high) - o
    margin = carried + wp.float64(1.001 * RELATIVE_BOUND) * wp.max(wp.max(wp.abs(a)), wp.max(wp.abs(b)))
    enter, leave = wp.float64(-2.0) * margin, before
    for k in range(3):
        first, last = a[k] - margin, b[k] + margin
        if wp.abs(d[k]) < wp.float64(1e-200):
            if first > wp.float64(0.0) or last < wp.float64(0.0):
                leave = wp.float64(-wp.inf)
        else:
            s, t = first / d[k], last / d[k]
            enter = wp.max(enter, wp.min(s, t))
            leave = wp.min(leave, wp.max(s, t))
    return enter <= leave


@wp.kernel(**KERNEL_OPTIONS)
def judge_blocks_kernel(
    blocks: Blocks,
    rays: JudgedRays,
    first: int,
    hit_before: wp.array(dtype=wp.float64),
    hit_after: wp.array(dtype=wp.float64),
):
    """Judge ray `first` + thread as `judge_kernel` does."""
    ray = first + wp.tid()
    o, d, carried = rays.origin[ray], rays.direction[ray], rays.carried[ray]
    before = wp.float64(wp.inf)
    after = wp.float64(wp.inf)
    for group in range(blocks.group_low.shape[0]):
        if may_meet(blocks.group_low[group], blocks.group_high[group], o, d, carried, before):
            for block in range(group * BLOCK, wp.min((group + 1) * BLOCK, blocks.low.shape[0])):
                if may_meet(blocks.low[block], blocks.high[block], o, d, carried, before):
                    for i in range(block * BLOCK, wp.min((block + 1) * BLOCK, blocks.triangles.shape[0])):
                        if blocks.visibility.shape[0] == 0 or (blocks.visibility[i] & rays.visibility[ray]) != 0:
                            corners = blocks.triangles[i]
                            found = certainty(
                                wp.vec3d(blocks.positions[corners[0]]) - o,
                                wp.vec3d(blocks.positions[corners[1]]) - o,
                                wp.vec3d(blocks.positions[corners[2]]) - o,
                                d,
                                rays.t_max[ray],
                                carried,
                            )
                            before = wp.min(before, found.hit_before)
                            after = wp.min(after, found.hit_after)
    hit_before[ray] = before
    hit_after[ray] = after


@wp.struct
class CarryBound:
    """How far off rays come to instances, and triangles of instances to the world."""

    factor: float  # of the two lengths; 0 where nothing is carried
    reach: float  # largest coordinate of the scene, and of the origins of instances [m]


@wp.func
def carried_error(bound: CarryBound, origin: wp.vec3) -> wp.float64:
    """Bound of a ray from there [m]."""
    return wp.float64(bound.factor) * (wp.float64(bound.reach) + wp.float64(wp.max(wp.abs(origin))))


@wp.kernel(**KERNEL_OPTIONS)
def take_rays_kernel(
    rays: Rays, slots: wp.array(dtype=int), bound: CarryBound, judged: JudgedRays, length: wp.array(dtype=wp.float64)
):
    """Ray `slots[i]` for the judge."""
    i = wp.tid()
    slot = slots[i]
    d = wp.vec3d(rays.direction[slot])
    most = wp.max(wp.abs(d))
    size = most * wp.length(d / most)
    judged.origin[i] = wp.vec3d(rays.origin[slot])
    judged.direction[i] = d / size
    judged.t_max[i] = wp.float64(rays.t_max[slot]) * size
    judged.visibility[i] = rays.visibility[slot]
    judged.carried[i] = carried_error(bound, rays.origin[slot])
    length[i] = size


@wp.kernel(**KERNEL_OPTIONS)
def false_hits_kernel(geometry: Geometry, rays: Rays, bound: CarryBound, wrong: wp.array(dtype=wp.uint8)):
    """Which hits are not on the triangle that they name, within the bound."""
    i = wp.tid()
    wrong[i] = wp.uint8(0)
    instance, primitive = rays.hit_instance[i], rays.hit_primitive[i]
    if instance < 0:
        return
    mesh = geometry.instance_mesh[instance]
    triangle = geometry.mesh_triangle_first[mesh] + primitive
    t, uv = wp.float64(rays.hit_t[i]), rays.hit_uv[i]
    v, w = wp.float64(uv[0]), wp.float64(uv[1])
    sound = (
        rays.hit_t[i] > 0.0
        and rays.hit_t[i] < rays.t_max[i]
        and wp.min(v, w) >= -WEIGHTS_BOUND
        and v + w <= wp.float64(1.0) + WEIGHTS_BOUND
    )
    if primitive < 0 or triangle >= geometry.mesh_triangle_first[mesh + 1]:
        sound = False
    if sound:
        corners = geometry.triangles[triangle]
        m = geometry.instance_transform[instance]
        o = wp.vec3d(rays.origin[i])
        reach = wp.float64(0.0)
        point = wp.vec3d()
        for k in range(3):
            p = wp.vec3d(geometry.positions[corners[k]])
            placed = wp.vec3d()
            for row in range(3):
                placed[row] = (
                    wp.float64(m[row, 0]) * p[0]
                    + wp.float64(m[row, 1]) * p[1]
                    + wp.float64(m[row, 2]) * p[2]
                    + wp.float64(m[row, 3])
                    - o[row]
                )
            reach = wp.max(reach, wp.max(wp.abs(placed)))
            weight = wp.float64(1.0) - v - w
            if k == 1:
                weight = v
            if k == 2:
                weight = w
            point += weight * placed
        error = wp.length(wp.vec3d(rays.direction[i]) * t - point)
        sound = error <= carried_error(bound, rays.origin[i]) + wp.float64(RELATIVE_BOUND) * reach
    if not sound:
        wrong[i] = wp.uint8(1)


class BlockJudge:
    """All triangles of a scene in their places."""

    def __init__(self, scene: BenchmarkScene, device: wp.Device):
        positions, triangles, visibility = placed_triangles(scene.flat, scene.scene.instances.visibility)
        self.positions, self.triangles = positions, triangles
        middles = positions[triangles].mean(1)
        order = np.argsort(sort_keys(middles, np.ones_like(middles)), kind="stable")
        triangles = np.ascontiguousarray(triangles[order])
        corners = positions[triangles]
        low, high = grouped(corners.min(1), corners.max(1))
        group_low, group_high = grouped(low, high)
        self._device, self._blocks = device, Blocks()
        for name, host, dtype in (
            ("positions", positions, wp.vec3),
            ("triangles", triangles, wp.vec3i),
            ("low", low, wp.vec3),
            ("high", high, wp.vec3),
            ("group_low", group_low, wp.vec3),
            ("group_high", group_high, wp.vec3),
            ("visibility", visibility[order] if len(visibility) else visibility, int),
        ):
            setattr(self._blocks, name, wp.array(host, dtype=dtype, device=device))
        self.bound = carry_bound(scene)

    def certainties(self, rays: Rays, slots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The farthest and the nearest right answer for each ray of `slots`, float64, shape [n] each
        (`judge.Certainty`).
        """
        count, judged = len(slots), JudgedRays()
        with wp.ScopedDevice(self._device):
            judged.origin, judged.direction = wp.empty(count, dtype=wp.vec3d), wp.empty(count, dtype=wp.vec3d)
            judged.t_max, judged.carried, length = (wp.empty(count, dtype=wp.float64) for _ in range(3))
            judged.visibility = wp.empty(count, dtype=int)
            wp.launch(take_rays_kernel, count, [rays, wp.array(slots, dtype=int), self.bound, judged, length])
            before, after = (wp.empty(count, dtype=wp.float64) for _ in range(2))

        def judge(part: slice) -> None:
            wp.launch(
                judge_blocks_kernel,
                part.stop - part.start,
                [self._blocks, judged, part.start, before, after],
                device=self._device,
            )

        judge_blocks_kernel.module.load(self._device)
        on_threads([lambda part=part: judge(part) for part in slices(count, thread_count_of(self._device))])
        return before.numpy() / length.numpy(), after.numpy() / length.numpy()


def grouped(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of every BLOCK boxes."""
    starts = np.arange(0, len(low), BLOCK)
    return np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def carry_bound(scene: BenchmarkScene) -> CarryBound:
    """The bound that `scene_tree.py` gives for rays that are carried to object space, and as much again for what is
    lost there.
    """
    bound, flat = CarryBound(), scene.flat
    if not len(flat.shared):
        return bound
    to_world = flat.instance_transform[flat.shared].astype(np.float64)
    linear = to_world[:, :, :3]
    condition = (np.abs(linear) @ np.abs(np.linalg.inv(linear))).sum(2).max()
    bound.factor = float(2 * RELATIVE_BOUND * condition)
    bound.reach = max(float(np.abs(scene.box()).max()), float(np.abs(to_world[:, :, 3]).max()))
    return bound
