"""Segments of curves and points: hits against float64, against other trees, and from their own surface."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.cpu import traversal_source
from raybatch_addon.core.bvh.traverse.cuda import trace_source
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.features import needs_instancing
from raybatch_addon.core.scene.flatten import IDENTITY, flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.scene.segments import _unpacked_normal, pack_segments, segment_boxes
from raybatch_addon.core.shading.segments import make_segment_point
from raybatch_addon.core.shading.surface import spawn_origin
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from tests.core.bvh.traverse.boxes_scenes import Hits, fill_rays
from tests.support import scenes

CPU = wp.get_device("cpu")
RADIUS = 0.05


def strand(points, radii) -> Mesh:
    """One strand."""
    first = np.arange(len(points) - 1, dtype=np.int32)
    return Mesh(
        "strand",
        np.asarray(points, np.float32),
        np.stack([first, first + 1, first], 1),
        radii=np.broadcast_to(np.asarray(radii, np.float32), len(points)).copy(),
    )


def bent(seed: int = 0, count: int = 30) -> Mesh:
    """A strand that turns by up to 40 degrees at each point."""
    rng = np.random.default_rng(seed)
    step, points = np.array([0.0, 0.0, 0.2]), [np.zeros(3)]
    for _ in range(count - 1):
        points.append(points[-1] + step)
        step = step + rng.normal(0, 0.04, 3)
        step *= 0.2 / np.linalg.norm(step)
    return strand(points, RADIUS)


def hair(seed: int = 1, count: int = 300) -> Mesh:
    """Strands of four segments that become thin, some points, and segments that cannot be met."""
    rng = np.random.default_rng(seed)
    roots = rng.uniform(-1, 1, (count, 1, 3))
    points = roots + np.cumsum(np.concatenate([np.zeros((count, 1, 3)), rng.normal(0, 0.15, (count, 4, 3))], 1), 1)
    radii = np.repeat([[0.03, 0.02, 0.015, 0.01, 0.0]], count, 0)
    i = np.arange(count * 5, dtype=np.int32).reshape(count, 5)
    rows = np.stack([i[:, :-1], i[:, 1:], i[:, :-1]], -1).reshape(-1, 3)
    rows[::40, 1] = rows[::40, 0]  # spheres
    radii[::7] = 0
    return Mesh("hair", points.reshape(-1, 3).astype(np.float32), rows, radii=radii.ravel().astype(np.float32))


@functools.cache
def stage(layout: Layout, any_hit: bool = False, curves: bool = True, instancing: bool = False):
    refill = 8 if layout is Layout.BOXES else 0
    options = TraceOptions(any_hit=any_hit, instancing=instancing, curves=curves, refill=refill)
    return trace_stage(layout, options)


class Traced:
    """The trees of a scene, whose meshes are placed by `placements`: mesh and matrix."""

    def __init__(self, placements, layout: Layout = Layout.BOXES):
        self.scene = scenes.scene([(mesh, matrix, scenes.diffuse()) for mesh, matrix in placements])
        self.flat = flatten(self.scene)
        self.layout, self.instancing = layout, needs_instancing(self.scene)
        geometry = upload_geometry(self.flat, self.scene, CPU)
        visibility = self.scene.instances.visibility
        self.built = build_scene_tree(self.flat, geometry, visibility, self.instancing, CPU, layout, on_device=False)

    def trace(self, origin, direction, t_max=np.inf, **options) -> Hits:
        rays = fill_rays(origin, direction, t_max)
        count = len(origin)
        slots = wp.array(np.arange(count, dtype=np.int32), dtype=int, device="cpu")
        listed = RayList(slots, wp.array([count], dtype=int, device="cpu"), count)
        tracing = stage(self.layout, instancing=self.instancing, **options)
        tracing.launch(self.built.tree, rays, listed, None)
        return Hits(rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


def alone(mesh: Mesh, layout: Layout = Layout.BOXES) -> Traced:
    return Traced([(mesh, IDENTITY)], layout)


def rays_around(count: int, seed: int = 0, size: float = 2.0, centre=(0.0, 0.0, 0.0)):
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=(count, 3))
    origin = 3 * size * origin / np.linalg.norm(origin, axis=1, keepdims=True) + centre
    direction = rng.uniform(-size, size, (count, 3)) + centre - origin
    return origin.astype(np.float32), (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)


def entered(mesh: Mesh, origin, direction):
    """Least distance at which each ray enters a segment, in float64; inf for nothing."""
    corners, triangles = pack_segments(mesh.positions, mesh.radii, mesh.triangles)
    best = np.full(len(origin), np.inf)
    o, d = origin.astype(np.float64), direction.astype(np.float64)
    for a, b, c in triangles:
        words = corners[c].view(np.uint32)
        r0, r1 = (np.uint32(x).astype(np.uint32) for x in ((words[0] & 0xFFFF) << 15, (words[0] >> 16) << 15))
        r0, r1 = (float(np.array(x, np.uint32).view(np.float32)) for x in (r0, r1))
        p, axis = corners[a].astype(np.float64), corners[b].astype(np.float64) - corners[a]
        length = np.linalg.norm(axis)
        unit = axis / length if length else axis
        slope = (r1 - r0) / length if length else 0.0
        q = o - p
        along, speed = q @ unit, d @ unit
        radius = r0 + slope * along
        across, moves = q - along[:, None] * unit, d - speed[:, None] * unit
        A = (moves**2).sum(1) - (slope * speed) ** 2
        B = (across * moves).sum(1) - radius * slope * speed
        C = (across**2).sum(1) - radius**2
        with np.errstate(all="ignore"):
            t = (-B - np.sqrt(B * B - A * C)) / A
            at = q + t[:, None] * d
            good = (t > 0) & (r0 + slope * (at @ unit) > 0)
            if length:
                first, second = unpacked(words[1]), unpacked(words[2])
                good &= (at @ first >= 0) & ((at - axis) @ second <= 0)
            best = np.where(good & (t < best), t, best)
    return best


def unpacked(word):
    return _unpacked_normal(np.array([word], np.uint32))[0]


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("make", [bent, hair])
def test_hits_are_those_of_float64(make, layout):
    mesh = make()
    rng = np.random.default_rng(3)
    target = mesh.positions[rng.integers(0, len(mesh.positions), 3000)] + rng.normal(0, 0.04, (3000, 3))
    outwards = rng.normal(size=(3000, 3))
    outwards = (outwards / np.linalg.norm(outwards, axis=1, keepdims=True)).astype(np.float32)
    origin, direction = (target + 3 * outwards).astype(np.float32), -outwards
    expected = entered(mesh, origin, direction)
    found = alone(mesh, layout).trace(origin, direction)
    hit = found.instance >= 0
    # rays that graze a surface or a plane may be judged otherwise
    assert np.isfinite(expected).sum() > 400
    assert (hit != np.isfinite(expected)).sum() <= 3
    both = hit & np.isfinite(expected)
    off = np.abs(found.t[both] - expected[both])
    assert np.quantile(off, 0.99) < 2e-5 and (off > 1e-3).sum() <= 3


def test_a_cylinder_is_met_at_its_distance():
    traced = alone(strand([(0, 0, -1), (0, 0, 1)], 0.25))
    heights = np.linspace(-0.9, 0.9, 7)
    origin = np.stack([np.full(7, 2.0), np.full(7, 0.15), heights], 1)
    found = traced.trace(origin, np.broadcast_to([-1.0, 0.0, 0.0], (7, 3)))
    assert found.t == pytest.approx(2 - 0.2, abs=1e-6)  # 0.15, 0.2, 0.25
    assert found.uv[:, 0] == pytest.approx((heights + 1) / 2, abs=1e-6)
    inside = traced.trace(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))
    assert inside.instance[0] == -1, "a ray that begins inside leaves without a hit"


def test_a_sphere_is_met_from_all_sides():
    point = Mesh("p", np.float32([[1, 2, 3]]), np.int32([[0, 0, 0]]), radii=np.float32([0.5]))
    outwards = np.random.default_rng(5).normal(size=(500, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    found = alone(point).trace([1, 2, 3] + 4 * outwards, -outwards)
    assert (found.instance == 0).all()
    assert found.t == pytest.approx(3.5, abs=1e-5)


@pytest.mark.parametrize("layout", list(Layout))
def test_nothing_passes_between_segments(layout):
    """Rays at the axis of a strand that bends: all are stopped, within a radius of where they meet it."""
    mesh = bent(4)
    rng = np.random.default_rng(5)
    k, u = rng.integers(1, len(mesh.positions) - 2, 4000), rng.random((4000, 1))
    u[::2] = rng.choice([0.0, 1.0, 1e-4, 0.9999], (2000, 1))
    target = mesh.positions[k] * (1 - u) + mesh.positions[k + 1] * u
    outwards = rng.normal(size=(4000, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    axis = mesh.positions[k + 1] - mesh.positions[k]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    steep = np.abs((outwards * axis).sum(1)) < 0.7
    origin = (target + outwards).astype(np.float32)
    found = alone(mesh, layout).trace(origin, -outwards)
    assert (found.instance[steep] == 0).all()
    assert (found.t[steep] < 1 - 0.9 * RADIUS).all()


@pytest.mark.parametrize("layout", list(Layout))
def test_any_hit_agrees_with_closest_hit(layout):
    mesh = hair()
    origin, direction = rays_around(3000, 7)
    traced = alone(mesh, layout)
    closest = traced.trace(origin, direction)
    hit = closest.instance >= 0
    limit = np.where(hit, closest.t, np.float32(1e30))
    for t_max, expected in ((limit, ~hit & False), (np.nextafter(limit, np.float32(np.inf)), hit)):
        found = traced.trace(origin, direction, t_max, any_hit=True)
        assert np.array_equal(found.instance >= 0, expected)


def test_hits_do_not_depend_on_the_tree():
    """A tree of all strands; trees that each hold a third of them; segments among triangles; and instances."""
    mesh = hair()
    origin, direction = rays_around(4000, 8)
    whole = alone(mesh).trace(origin, direction)
    parts = [Mesh("part", mesh.positions, rows, radii=mesh.radii) for rows in np.array_split(mesh.triangles, 3)]
    # a strand that is cut ends straight there: the split is between strands
    assert all(len(part.triangles) % 4 == 0 for part in parts)
    counts = np.cumsum([0] + [len(part.triangles) for part in parts])
    several = Traced([(part, IDENTITY) for part in parts]).trace(origin, direction)
    assert np.array_equal(whole.t, several.t) and np.array_equal(whole.uv, several.uv)
    hit = whole.instance >= 0
    assert np.array_equal(whole.primitive[hit], (counts[several.instance] + several.primitive)[hit])
    ball = scenes.sphere(radius=0.6)
    mixed = Traced([(mesh, IDENTITY), (ball, IDENTITY)]).trace(origin, direction)
    balls = Traced([(ball, IDENTITY)]).trace(origin, direction)
    nearer = np.where((balls.instance >= 0) & (balls.t < whole.t), balls.t, whole.t)
    assert np.array_equal(mixed.t, nearer)


@pytest.mark.parametrize("radius", [0.05, 1e-3, 1e-6])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_a_ray_that_leaves_does_not_come_back(radius, offset):
    """From points of a straight strand, out into all directions: nothing is there to be met, whatever the scale."""
    mesh = strand([(offset, offset, -1), (offset, offset, 0), (offset + 0.2, offset, 1)], radius)
    traced = alone(mesh)
    rng = np.random.default_rng(9)
    count = 3000
    uv = np.stack([rng.random(count), rng.uniform(-2, 2, count)], 1).astype(np.float32)
    out = surface_points(traced, rng.integers(0, 2, count), uv)
    position, error, normal = out
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = spawned(position, error, normal, directions)
    found = traced.trace(origin, directions.astype(np.float32))
    # the strand bends by 11 degrees: rays along it may meet the other segment
    across = np.abs(directions[:, 2]) < 0.9
    assert (found.instance[across] == -1).all()


def surface_points(traced: Traced, primitive, uv):
    point = make_segment_point(False)

    @wp.kernel(**KERNEL_OPTIONS)
    def points(
        geometry: Geometry, primitive: wp.array(dtype=int), uv: wp.array(dtype=wp.vec2), out: wp.array2d(dtype=wp.vec3)
    ):
        i = wp.tid()
        surface = point(geometry, 0, primitive[i], uv[i], 0.0)
        out[i, 0] = surface.position
        out[i, 1] = surface.error
        out[i, 2] = surface.geometric_normal

    count = len(uv)
    out = wp.zeros((count, 3), dtype=wp.vec3, device="cpu")
    geometry = upload_geometry(traced.flat, traced.scene, CPU)
    inputs = [geometry, wp.array(primitive, dtype=int, device="cpu"), wp.array(uv, dtype=wp.vec2, device="cpu"), out]
    wp.launch(points, count, inputs, device="cpu")
    return out.numpy().transpose(1, 0, 2)


def spawned(position, error, normal, direction):
    @wp.kernel(**KERNEL_OPTIONS)
    def spawn(
        position: wp.array(dtype=wp.vec3),
        error: wp.array(dtype=wp.vec3),
        normal: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid()
        out[i] = spawn_origin(position[i], error[i], normal[i], direction[i])

    arrays = [
        wp.array(np.ascontiguousarray(x, np.float32), dtype=wp.vec3, device="cpu")
        for x in (position, error, normal, direction)
    ]
    out = wp.zeros(len(position), dtype=wp.vec3, device="cpu")
    wp.launch(spawn, len(position), [*arrays, out], device="cpu")
    return out.numpy()


def test_boxes_hold_what_is_met():
    mesh = hair(6)
    corners, triangles = pack_segments(mesh.positions, mesh.radii, mesh.triangles)
    low, high = segment_boxes(corners, triangles)
    origin, direction = rays_around(20_000, 10)
    found = alone(mesh).trace(origin, direction)
    hit = found.instance >= 0
    at = (origin + found.t[:, None] * direction)[hit]
    which = found.primitive[hit]
    assert hit.sum() > 1000
    assert (at >= low[which] - 1e-5).all() and (at <= high[which] + 1e-5).all()


def test_kernels_without_curves_have_no_code_for_them():
    plain = TraceOptions(any_hit=False, instancing=False)
    assert "enter_segment" not in traversal_source(plain) and "segment" not in trace_source(plain)
    curved = TraceOptions(any_hit=False, instancing=False, curves=True)
    assert "enter_segment" in traversal_source(curved) and "enter_segment" in trace_source(curved)
