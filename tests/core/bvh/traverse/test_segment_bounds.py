"""How far hits on segments are off: the bounds of docs/stability.md, by cones and rays that ask most of them."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.flatten import IDENTITY
from raybatch_addon.core.scene.segments import _unpacked_radii, pack_segments
from tests.core.bvh.traverse.test_segments import Traced, alone, spawned, strand, surface_points

U = 2.0**-24
# Length, and radii at both ends: thin and thick, straight, tapered, pointed, nearly flat
CONES = (
    (1, 0.1, 0.1),
    (1, 0.1, 0.02),
    (1, 0.1, 0),
    (1, 1e-4, 1e-4),
    (1, 1e-4, 0),
    (1, 1, 1),
    (1, 1, 0.5),
    (1, 0, 1),
    (0.1, 1, 0.95),
    (0.1, 1, 0.1),
    (1e-3, 1, 0.9),
)
STEEP = ((1e-3, 1, 0.5), (1e-4, 1, 0))  # hardly thicker than discs
STEEPER = ((1e-4, 0.5, 1), (1e-5, 1, 0.5), (1e-6, 1, 0.1))  # which few rays meet that come from afar
SINES = (1, 0.5, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # of the angle between ray and axis
FARS = (0.6, 1, 3, 100, 1e4)  # from where rays come, in sizes of the segment
COUNT = 20_000


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def norm(v):
    return np.sqrt((v * v).sum(-1))


class Cone:
    """A segment of a random direction at `place`, and its numbers as they are packed, as long doubles."""

    def __init__(self, sizes, place, seed, ribbon=False):
        self.random = np.random.default_rng(seed)
        length, *radii = sizes
        points = np.array([np.zeros(3), length * unit(self.random.normal(size=3))]) + place
        self.mesh = mesh = replace(strand(points, radii), ribbons=ribbon)
        corners, ((a, b, c),) = pack_segments(mesh.positions, mesh.radii, mesh.triangles, ribbon)
        self.first, self.second = corners[[a, b]].astype(np.longdouble)
        packed = corners[[c], 0].view(np.uint32)
        self.radii = np.array([each[0] for each in _unpacked_radii(packed)], np.longdouble)
        self.axis = self.second - self.first
        self.length, self.taper = norm(self.axis), self.radii[1] - self.radii[0]
        self.slope, self.most = self.taper / self.length, self.radii.max()
        self.size = np.abs(self.axis).sum() + 2 * self.most
        self.window = 2 * self.most / abs(self.slope) if self.slope else np.inf

    def across(self, count):
        """The unit axis and two unit vectors across it."""
        axis = (self.axis / self.length).astype(float)
        one = unit(np.cross(axis, self.random.normal(size=(count, 3))))
        return axis, one, np.cross(axis, one)

    def rays(self, count):
        """Rays at the surface and inside of it, many of them along the axis and many that graze."""
        random = self.random
        axis, one, other = self.across(count)
        at = random.uniform(-0.05, 1.05, count)
        radius = np.maximum(self.radii[0] + at * self.taper, 0) * random.choice(
            [0, 0.5, 0.99, 1 - 1e-4, 1 - 1e-6], count
        )
        target = self.first + at[:, None] * self.axis + radius[:, None] * one
        turn = random.choice([0, np.pi / 2, *random.uniform(0, 2 * np.pi, 2)], count)[:, None]
        sine = random.choice(SINES, count)[:, None]
        side = np.cos(turn) * one + np.sin(turn) * other
        direction = random.choice([-1, 1], count)[:, None] * np.sqrt(1 - sine**2) * axis + sine * side
        far = random.choice(FARS, count)[:, None] * self.size
        return (target - far * direction).astype(np.float32), unit(direction).astype(np.float32)

    def hits(self, layout):
        """Points of rays at the distances found, what these were, and origins' and segment's largest coordinates."""
        origin, direction = self.rays(COUNT)
        found = alone(self.mesh, layout).trace(origin, direction)
        hit = found.instance >= 0
        assert hit.sum() > COUNT / 20
        origin, direction = origin[hit].astype(np.longdouble), direction[hit].astype(np.longdouble)
        point = origin + found.t[hit].astype(np.longdouble)[:, None] * direction
        way = np.abs(origin).max(1) + np.maximum(np.abs(self.first), np.abs(self.second)).max() + self.size
        return point, direction, found.uv[hit].astype(np.longdouble), way


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("place", [0.0, 30.0])
def test_hits_on_cones_are_within_the_bound(place, layout):
    worst = 0.0
    for seed, sizes in enumerate(CONES + STEEP):
        cone = Cone(sizes, place, seed)
        point, _, _, way = cone.hits(layout)
        along = (point - cone.first) @ cone.axis / cone.length**2
        radius = cone.radii[0] + along * cone.taper
        distance = norm(point - cone.first - along[:, None] * cone.axis)
        off = np.abs(distance - radius) / np.sqrt(1 + cone.slope**2)
        moved = np.sqrt(2 * cone.length**2 + 48 * cone.most**2)
        square = 75 * U * cone.size * (np.maximum(radius, 0) + abs(cone.slope) * moved)
        # of radii near 0 it is the square that is known
        near = 2 * square / (np.sqrt(np.maximum(radius, 0) ** 2 + 2 * square) + np.maximum(radius, 0))
        # of steep cones it is the place along the axis that is known
        near = np.minimum(near, 75 * U * cone.size + cone.window)
        share = off / (14 * U * way + near)
        assert share.max() < 1, sizes
        worst = max(worst, float(share.max()))
    print(f"{worst:.2f} of the bound")


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("place", [0.0, 30.0])
def test_hits_on_ribbons_are_within_the_bound(place, layout):
    """The ray's point is nearest to the axis's, that to the ray but for ends, and they are a radius apart at most."""
    worst = 0.0
    for seed, sizes in enumerate(CONES):
        cone = Cone(sizes, place, seed, ribbon=True)
        point, direction, uv, way = cone.hits(layout)
        bound = 14 * U * way + 20 * U * cone.size
        apart = point - cone.first - uv[:, :1] * cone.axis
        direction = direction / norm(direction)[:, None]
        seen = cone.axis - (direction @ cone.axis)[:, None] * direction
        seen = seen / np.maximum(norm(seen), 1e-30)[:, None]
        inner = (uv[:, 0] > 0) & (uv[:, 0] < 1)
        shares = (
            np.abs((apart * direction).sum(1)) / bound,
            np.where(inner, np.abs((apart * seen).sum(1)), 0) / bound,
            (norm(apart) - cone.radii[0] - uv[:, 0] * cone.taper) / bound,
        )
        assert np.max(shares) < 1, sizes
        worst = max(worst, float(np.max(shares)))
    print(f"{worst:.2f} of the bound")


@pytest.mark.parametrize("scale, place", [(1.0, 0.0), (1.0, 100.0), (1e-3, 1.0)])
def test_no_ray_meets_the_cone_that_it_left(scale, place):
    """From all over the surface, most of them close to its ends, along the axis, along the surface and away."""
    for seed, sizes in enumerate(CONES + STEEP + STEEPER):
        if sizes[0] * scale < 10 * U * place:
            continue  # its ends are one place
        cone = Cone(np.multiply(sizes, scale), place, seed)
        random, count = cone.random, COUNT
        along = random.choice([0, 1], count) + random.choice([-1, 1], count) * 10.0 ** random.uniform(-7, 0, count)
        along = np.where((along < 0) | (along > 1), random.random(count), along)
        uv = np.stack([along, random.uniform(-2, 2, count)], 1).astype(np.float32)
        traced = alone(cone.mesh)
        position, error, normal = surface_points(traced, np.zeros(count, np.int32), uv)
        axis, one, _ = cone.across(count)
        sine = 10.0 ** random.uniform(-6, 0, count)[:, None]
        direction = random.choice([-1, 1], count)[:, None] * np.sqrt(1 - sine**2) * axis + sine * one
        outwards = unit(normal.astype(float))
        grazing = unit(np.cross(outwards, random.normal(size=(count, 3)))) + sine * outwards
        direction = np.where(random.random(count)[:, None] < 0.5, grazing, direction)
        inwards = np.minimum((direction * outwards).sum(1), 0)[:, None]
        direction = unit(direction - 2 * inwards * outwards).astype(np.float32)
        leaves = (direction.astype(float) * normal).sum(1) > 1e-6
        origin = spawned(position[leaves], error[leaves], normal[leaves], direction[leaves])
        met = traced.trace(origin, direction[leaves]).instance >= 0
        assert met.sum() == 0, sizes


@pytest.mark.parametrize("length", [1.0, 1e-2, 1e-3, 1e-4, 1e-5, 1e-10, 1e-33, 1e-37, 1e-44])
@pytest.mark.parametrize("radii", [(1, 0.5), (0.5, 1), (1, 0), (1, 1 - 2**-7), (1, 1), (2**-10, 0)])
def test_rays_start_close_to_steep_cones(length, radii):
    """However short a segment is, a scattered ray starts within a few of its lengths, and roundings of its size."""
    cone = Cone((1, 1, 1), 0.0, 0)
    axis = np.array([0, 0, length])
    traced = alone(replace(cone.mesh, positions=np.float32([0 * axis, axis]), radii=np.float32(radii)))
    uv = np.stack([cone.random.random(1000), cone.random.uniform(-2, 2, 1000)], 1).astype(np.float32)
    position, error, _ = surface_points(traced, np.zeros(1000, np.int32), uv)
    assert np.isfinite(position).all() and np.isfinite(error).all()
    most, taper = max(radii), abs(radii[1] - radii[0])
    if taper:
        roundings = 75 * U * (length + 2 * most) + 3 * U * np.abs(position)
        assert (error <= 1.01 * (roundings + 2 * most * length / taper)).all()
    assert error.max() <= 0.05 * max(most, length), "of rays at the tip, where squares of radii are known"


def test_rays_along_tapered_curves_meet_the_same_in_every_tree():
    """A bundle of pointed strands that is looked at from its ends."""
    random = np.random.default_rng(8)
    count = 2000
    roots = random.uniform(-1, 1, (count, 1, 3))
    points = roots + np.array([0, 0, 0.3]) * np.arange(2)[:, None] + random.normal(0, 1e-3, (count, 2, 3))
    first = np.arange(0, 2 * count, 2, dtype=np.int32)
    rows = np.stack([first, first + 1, first], 1)
    radii = np.tile(np.float32([0.06, 0.004]), count)
    bundle = Mesh("bundle", points.reshape(-1, 3).astype(np.float32), rows, radii=radii)
    parts = [replace(bundle, name=f"part {k}", triangles=rows[k::7]) for k in range(7)]
    target = points[random.integers(0, count, COUNT), 0] + random.normal(0, 0.03, (COUNT, 3)) * (1, 1, 0)
    sine = random.choice(SINES[2:], COUNT)[:, None]
    direction = unit(np.array([0, 0, -1.0]) + sine * random.normal(size=(COUNT, 3)))
    origin, direction = (target - 3 * direction).astype(np.float32), direction.astype(np.float32)
    found = [alone(bundle, layout).trace(origin, direction) for layout in Layout]
    found.append(Traced([(part, IDENTITY) for part in parts]).trace(origin, direction))
    assert (found[0].instance >= 0).mean() > 0.5
    for each in found[1:]:
        assert np.array_equal(each.t, found[0].t) and np.array_equal(each.uv, found[0].uv)
