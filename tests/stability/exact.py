"""Hits that rays must have: every triangle is tested in float64, and on lattices in whole numbers.

Roundings are half units in the last place of float32, u = 2**-24, of m, the largest coordinate of the triangle's
corners relative to the ray's origin. `margin.py` proves that the ray's point at the distance that the triangle test
finds is within 19 u m, in each coordinate, of a point of the triangle. `traverse/quantised/ray.h` counts 6 more of them
for CUDA's approximate operations, all of which are allowed here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.stability.bench import Bench, Hits
from tests.stability.case import Outcome

U = 2.0**-24
CPU_ROUNDINGS, CUDA_ROUNDINGS = 19, 25
# A ray that passes a triangle's edges at more than this [u m] hits it for certain: the test sees the corners moved by
# 5 u m in each of two coordinates, on CUDA by 6
CERTAIN = 32 * 3**0.5
WRONG = 1e6  # added to the measured value for every answer that is wrong, not only inexact
IN_ROUNDINGS = """Measured: the largest distance of a hit from the triangle that it names, in u m a coordinate (u =
2^-24, m: the largest coordinate of its corners from the ray's origin), plus 1e6 for each answer that is wrong.
margin.py proves 19 u m; 25 u m with CUDA's approximate operations."""
PAIRS = 1 << 19  # pairs of rays and triangles that are compared at once


def roundings(bench: Bench) -> int:
    """The bound for triangle tests on the bench's device [u m]."""
    return CUDA_ROUNDINGS if bench.wp_device.is_cuda else CPU_ROUNDINGS


def along_roundings(bench: Bench) -> int:
    """The bound for distances along the largest component of a direction [u m]; `margin.py` says 14."""
    return roundings(bench) - 5


def reach_of(origin: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """m of each ray and its triangle: rays [n, 3], triangles [n, 3, 3]."""
    return np.abs(corners - origin[:, None]).max((1, 2))


def distance_to_triangles(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances of points [n, 3] to a triangle each, [n, 3, 3], float64, shape [n]; triangles may have no area."""
    best = np.full(len(point), np.inf)
    for k in range(3):
        a, e = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        square = (e * e).sum(1)
        share = np.clip(((point - a) * e).sum(1) / np.where(square > 0, square, 1), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + share[:, None] * e - point, axis=1))
    a, b, c = (corners - point[:, None]).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(length > 0, length, 1)[:, None]
    sides = np.stack([(np.cross(p, q) * unit).sum(1) for p, q in ((a, b), (b, c), (c, a))])
    inside = (length > 0) & ((sides > 0).all(0) | (sides < 0).all(0))
    return np.where(inside, np.minimum(best, np.abs((a * unit).sum(1))), best)


def hit_errors(origin: np.ndarray, direction: np.ndarray, t: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances of the rays' points at `t` to their triangles, the largest over the coordinates [m], shape [n]."""
    point = origin.astype(np.float64) + t.astype(np.float64)[:, None] * direction
    return distance_to_triangles(point, corners) / 3**0.5


def backward_error(origin: np.ndarray, direction: np.ndarray, hits: Hits, corners: np.ndarray) -> float:
    """The largest distance of a hit from its triangle [u m]; `corners` of all triangles, float64, shape [m, 3, 3]."""
    found = np.flatnonzero(hits.hit)
    origin, direction, met = (
        origin[found].astype(np.float64),
        direction[found].astype(np.float64),
        corners[hits.primitive[found]],
    )
    return float((hit_errors(origin, direction, hits.t[found], met) / (U * reach_of(origin, met))).max(initial=0.0))


def certain_hits(
    origin: np.ndarray, direction: np.ndarray, corners: np.ndarray, carried: np.ndarray | float = 0.0
) -> np.ndarray:
    """The distance beyond which no closest hit can be, in lengths of the direction, float64, shape [n].

    It is infinite where nothing is certain.

    Args:
        origin, direction: shape [n, 3]. corners: all triangles [m, 3, 3].
        carried: how far off rays come to the triangles, besides the test's own error [m], shape [n].
    """
    origin, direction = origin.astype(np.float64), direction.astype(np.float64)
    size = np.linalg.norm(direction, axis=1)
    d = direction / size[:, None]
    aside = np.cross(d, np.eye(3)[np.abs(d).argmin(1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    other = np.cross(d, aside)
    before = np.full(len(d), np.inf)
    carried = np.broadcast_to(carried, len(d))
    step = max(1, PAIRS // len(corners))
    for first in range(0, len(d), step):
        part = slice(first, first + step)
        x, y = (
            (corners @ axis[part].T).transpose(2, 0, 1) - (origin[part] * axis[part]).sum(1)[:, None, None]
            for axis in (aside, other)
        )
        u, v, w = (x[..., i] * y[..., j] - y[..., i] * x[..., j] for i, j in ((1, 2), (2, 0), (0, 1)))
        ray, triangle = np.nonzero((np.minimum(np.minimum(u, v), w) > 0) | (np.maximum(np.maximum(u, v), w) < 0))
        if not len(ray):
            continue
        flat = np.stack([x[ray, triangle], y[ray, triangle]], -1)  # corners across the ray
        edges = [np.linalg.norm(flat[:, j] - flat[:, i], axis=1) for i, j in ((1, 2), (2, 0), (0, 1))]
        clear = np.min([np.abs(area[ray, triangle]) / edge for area, edge in zip((u, v, w), edges)], axis=0)
        ray += first
        relative = corners[triangle] - origin[ray][:, None]
        bound = carried[ray] + CERTAIN * U * np.abs(relative).max((1, 2))
        normal = np.cross(relative[:, 1] - relative[:, 0], relative[:, 2] - relative[:, 0])
        facing = (normal * d[ray]).sum(1)
        along = (relative * d[ray][:, None]).sum(2)
        with np.errstate(divide="ignore", invalid="ignore"):
            t, error = (
                (relative[:, 0] * normal).sum(1) / facing,
                bound * np.linalg.norm(normal, axis=1) / np.abs(facing),
            )
        low, high = np.maximum(t - error, along.min(1) - bound), np.minimum(t + error, along.max(1) + bound)
        sure = (clear > bound) & (low > 0)
        np.minimum.at(before, ray[sure], high[sure])
    return before / size


@dataclass
class Judgement:
    """Errors of a tracer's answers."""

    worst: float  # worst error of a hit, in units of its bound
    wrong: int  # rays that missed a triangle that they must hit, or hit it too late
    note: str

    def outcome(self, tolerance: float) -> Outcome:
        """The outcome of a case."""
        return Outcome(self.worst + WRONG * self.wrong, 0.0, tolerance, self.note)


def judge(
    origin: np.ndarray, direction: np.ndarray, hits: Hits, corners: np.ndarray, must_hit: bool = False
) -> Judgement:
    """Judge closest hits with triangles `corners`, float64, shape [m, 3, 3], in the world.

    `must_hit`: a miss is wrong in any case.
    """
    before = certain_hits(origin, direction, corners)
    late = (before < np.inf) & (~hits.hit | (hits.t > before))
    if must_hit:
        late |= ~hits.hit
    note = f"{int(hits.hit.sum()):,} of {len(origin):,} rays hit, {int(late.sum())} answers are wrong"
    return Judgement(backward_error(origin, direction, hits, corners), int(late.sum()), note)


@dataclass(frozen=True)
class LatticeHits:
    """Exact hits of rays along whole numbers with triangles of whole coordinates."""

    t: np.ndarray  # nearest distance above 0, in lengths of the direction; infinite: no hit. float64, shape [n]
    nearest: np.ndarray  # triangles that are hit at that distance, bool, shape [n, m]
    at_origin: np.ndarray  # triangles that hold the origin, bool, shape [n, m]
    at_corner: np.ndarray  # whether the ray hits something at a corner, shape [n]
    at_edge: np.ndarray  # ... within an edge
    along_edge: np.ndarray  # ... or its line holds an edge
    in_plane: np.ndarray  # ... or lies in the plane of a triangle


def lattice_hits(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> LatticeHits:
    """Exact answers: whole numbers up to 64, of rays [n, 3] and triangles [m, 3, 3], stay below 2**31 here."""
    o, d, p = (np.asarray(a).astype(np.int64) for a in (origin, direction, corners))
    a, b, c = (p[None, :, k] - o[:, None] for k in range(3))
    ray = d[:, None]
    crosses = [np.cross(c, b), np.cross(a, c), np.cross(b, a)]
    volumes = np.stack([(ray * each).sum(-1) for each in crosses], -1)
    total = volumes.sum(-1)
    met = (total != 0) & ((volumes >= 0).all(-1) | (volumes <= 0).all(-1))
    along = np.stack([(ray * each).sum(-1) for each in (a, b, c)], -1)
    height = (volumes * along).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(met, height / (total * (ray * ray).sum(-1)), np.inf)
    ahead = np.where(met & (t > 0), t, np.inf)
    first = ahead.min(1)
    nearest = (ahead < first[:, None] + 1e-9) & np.isfinite(ahead)
    zeros = (volumes == 0).sum(-1)
    # the line holds a corner when the corner, seen from the origin, is parallel to it
    on_line = np.stack([(np.cross(each, ray) == 0).all(-1) for each in (a, b, c)], -1)
    return LatticeHits(
        first,
        nearest,
        met & (t == 0),
        (nearest & (zeros == 2)).any(1),
        (nearest & (zeros == 1)).any(1),
        (on_line.sum(-1) >= 2).any(1),
        ((total == 0) & (np.abs(volumes).sum(-1) == 0)).any(1),
    )
