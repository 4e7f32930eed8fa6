"""Strips that face each ray: hits against float64, on either layout, and the round surface that they stand for."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.scene.segments import pack_segments
from tests.core.bvh.traverse.test_segments import alone, bent, hair, strand, surface_points, unpacked


def ribbon(mesh: Mesh) -> Mesh:
    """The same as strips that face each ray."""
    return replace(mesh, ribbons=True)


def crossed(mesh: Mesh, origin, direction):
    """Least distance at which each ray crosses a strip that faces it, in float64; inf for nothing."""
    corners, triangles = pack_segments(mesh.positions, mesh.radii, mesh.triangles)
    best = np.full(len(origin), np.inf)
    o, d = origin.astype(np.float64), direction.astype(np.float64)
    radii = mesh.radii.astype(np.float64)
    for a, b, c in triangles:
        p, e = corners[a].astype(np.float64), corners[b].astype(np.float64) - corners[a]
        seen, from_first = e - (d @ e)[:, None] * d, (o - p) - ((o - p) * d).sum(1, keepdims=True) * d
        size = (seen**2).sum(1)
        s = np.clip((from_first * seen).sum(1) / np.maximum(size, 1e-30), 0, 1)
        t = ((p + s[:, None] * e - o) * d).sum(1)
        radius = radii[a] + s * (radii[b] - radii[a])
        at = o + t[:, None] * d - p
        good = (size > 0) & (((at - s[:, None] * e) ** 2).sum(1) <= radius**2) & (t > 2 * radius)
        words = corners[c].view(np.uint32)
        for bits, from_end, sign in ((words[1], at, 1), (words[2], at - e, -1)):
            n = unpacked(bits)
            n = n - (d @ n)[:, None] * d
            good &= sign * (from_end * n).sum(1) >= 0
        best = np.where(good & (t < best), t, best)
    return best


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("make", [bent, hair])
def test_hits_of_ribbons_are_those_of_float64(make, layout):
    mesh = ribbon(make())
    rng = np.random.default_rng(4)
    target = mesh.positions[rng.integers(0, len(mesh.positions), 3000)] + rng.normal(0, 0.04, (3000, 3))
    outwards = rng.normal(size=(3000, 3))
    outwards = (outwards / np.linalg.norm(outwards, axis=1, keepdims=True)).astype(np.float32)
    origin, direction = (target + 3 * outwards).astype(np.float32), -outwards
    expected = crossed(mesh, origin, direction)
    found = alone(mesh, layout).trace(origin, direction)
    hit = found.instance >= 0
    assert np.isfinite(expected).sum() > 400
    assert (hit != np.isfinite(expected)).sum() <= 6  # radii and planes are rounded
    both = hit & np.isfinite(expected)
    off = np.abs(found.t[both] - expected[both])
    assert np.quantile(off, 0.98) < 2e-5


def test_a_ribbon_is_met_at_its_axis_and_shaded_as_round():
    traced = alone(ribbon(strand([(0, 0, -1), (0, 0, 1)], 0.25)))
    sides = np.linspace(-0.24, 0.24, 7)
    origin = np.stack([np.full(7, 2.0), sides, np.full(7, 0.3)], 1)
    direction = np.broadcast_to([-1.0, 0.0, 0.0], (7, 3))
    found = traced.trace(origin, direction)
    assert found.t == pytest.approx(2.0, abs=1e-6) and found.uv[:, 0] == pytest.approx(0.65, abs=1e-6)
    normal = surface_points(traced, found.primitive, found.uv)[2]
    assert normal[:, 1] == pytest.approx(sides / 0.25, abs=2e-3)
    assert normal[:, 0] == pytest.approx(np.sqrt(1 - (sides / 0.25) ** 2), abs=2e-3)
    # a ray that begins on it does not meet it again, whichever way it goes
    near = traced.trace(np.float32([[0.2, 0.1, 0]] * 2), np.float32([[-1, 0, 0], [0, -1, 0]]))
    assert (near.instance == -1).all()
