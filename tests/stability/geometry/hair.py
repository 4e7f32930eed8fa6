"""Hair: strands thinner than anything near them, and ten thousand of them through one point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raybatch_addon.core.scene.description import Mesh
from tests.core.bvh.traverse.test_ribbons import crossed
from tests.core.bvh.traverse.test_segments import entered
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import WRONG, U
from tests.stability.geometry.meshes import directions, placed

FAMILY = "geometry"
THIN = 1e-7  # [m]
RADIUS = 1e-4  # [m]
UNSURE = 2.0**-9  # share to which a segment's radii and planes are rounded


def strands(points: np.ndarray, radius: float, ribbons: bool) -> Mesh:
    """Strands of two points each, shape [n, 2, 3]."""
    first = np.arange(0, 2 * len(points), 2, dtype=np.int32)
    rows = np.stack([first, first + 1, first], 1)
    radii = np.full(2 * len(points), radius, np.float32)
    return Mesh("strands", points.reshape(-1, 3).astype(np.float32), rows, radii=radii, ribbons=ribbons)


@case(
    "hair of radius 1e-7 m",
    FAMILY,
    "A strand of 10 cm and 1e-7 m radius along an axis, round and as a ribbon, and rays across it from 1 mm to 10 m "
    "away, that pass its axis at up to 0.95 and from 1.05 radii: the first meet it, at their distance, the others do "
    "not.",
    "1e6 for each ray that is judged otherwise: radii are rounded to 2^-9, and where rays pass is a number of float32 "
    "near 0. Distances: 32 roundings of the distance (u = 2^-24), and 2 % of the radius, for its roundings.",
    quick=True,
)
def thin(bench: Bench) -> Outcome:
    sweep = Sweep()
    share = np.concatenate([np.linspace(-0.95, 0.95, 64), np.linspace(1.05, 40, 32), -np.linspace(1.05, 40, 32)])
    for ribbons in (False, True):
        mesh = strands(np.array([[[0, 0, -0.05], [0, 0, 0.05]]]), THIN, ribbons)
        for away in (1e-3, 1e-1, 10.0):
            origin = np.stack([np.full(len(share), away), share * THIN, np.linspace(-0.04, 0.04, len(share))], 1)
            direction = np.broadcast_to(np.float32([-1, 0, 0]), origin.shape)
            hits = bench.trace(placed(mesh), origin.astype(np.float32), np.ascontiguousarray(direction))
            wrong = int((hits.hit != (np.abs(share) < 1)).sum())
            in_front = 0.0 if ribbons else THIN * np.sqrt(np.maximum(1 - share**2, 0))
            off = np.abs(hits.t - (np.float32(away).astype(np.float64) - in_front))[hits.hit].max(initial=0.0)
            sweep.add(off + WRONG * wrong, 0.0, 32 * U * away + 0.02 * THIN, f"{away:g} m, ribbons: {ribbons}")
    return sweep.outcome()


@case(
    "ten thousand hairs through one point",
    FAMILY,
    "10,000 strands of 1e-4 m radius in all directions through one point, round and as ribbons: rays that aim at the "
    "point and near it meet first what the same tests in float64 do.",
    "1 for each ray whose distance is none between those to the same strands in float64, once thicker and longer and "
    "once thinner and shorter, and farther off than a radius. Radii and planes of ends are rounded to 2^-9, and where "
    "a ray passes an axis is known to 32 roundings of 2.5 m, its way to the far ends: where strands pass through each "
    "other these decide at a silhouette which is first.",
)
def crowd(bench: Bench) -> Outcome:
    rng = np.random.default_rng(11)
    ends = directions(rng, 10_000)
    points = np.stack([-ends, ends], 1)
    origin = (1.5 * directions(rng, 300)).astype(np.float32)
    aim = rng.normal(0, 0.01, (300, 3)) - origin
    aim[::3] = -origin[::3]
    direction = (aim / np.linalg.norm(aim, axis=1, keepdims=True)).astype(np.float32)
    sweep = Sweep()
    for ribbons, exact in ((False, entered), (True, crossed)):
        mesh = strands(points, RADIUS, ribbons)
        hits = bench.trace(placed(replace(mesh, name=f"ribbons {ribbons}")), origin, direction)
        t = np.where(hits.hit, hits.t, np.inf)
        off = UNSURE * RADIUS + 32 * U * 2.5
        nearest = exact(strands((1 + UNSURE) * points, RADIUS + off, ribbons), origin, direction)
        farthest = exact(strands((1 - UNSURE) * points, RADIUS - off, ribbons), origin, direction)
        wrong = (t < nearest - RADIUS) | (t > farthest + RADIUS)
        sure = int((farthest < nearest + RADIUS).sum())
        sweep.add(float(wrong.sum()), 0.0, 0.0, f"ribbons: {ribbons}, {sure} hits that are sure")
    return sweep.outcome()
