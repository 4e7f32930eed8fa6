"""Rays through corners, along edges, in planes, parallel to axes and from the faces of boxes: exact answers.

Directions have the components -1, 0 and 1 alone. Then the triangle test rounds nothing that decides about a hit:
differences, shears and edge functions are small whole numbers, so that its answer must be that of the closed triangle
in whole numbers.
"""

from __future__ import annotations

import functools

import numpy as np

from raybatch_addon.core.scene.description import Mesh
from tests.stability.bench import Bench
from tests.stability.case import Outcome, case
from tests.stability.exact import WRONG, LatticeHits, U, along_roundings, judge, lattice_hits, reach_of, roundings
from tests.stability.geometry.meshes import corners_of, mesh_of, placed

FAMILY = "geometry"
SCALE = 2.0**-4  # metres of a whole number: exact
WAYS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
BOUND = """Measured: the error of distances in u m, plus 1e6 for each ray that meets another triangle than the nearest
ones (in whole numbers), or nothing where it must. margin.py proves 14 u m along the largest component of the direction,
20 u m with CUDA's approximate operations. """


@functools.cache
def triangles() -> np.ndarray:
    """Boxes in a row on a floor of squares, and disordered triangles, many of which lie in planes of others.

    Whole numbers, shape [n, 3, 3].
    """
    rng = np.random.default_rng(0)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    parts = [
        np.array([x, y, z]) + 2 * cube[quads]
        for x, y, z in ((-8, 0, 0), (-6, 0, 0), (-2, 0, 0), (2, -6, 2), (2, -4, 2))
    ]
    i, j = np.meshgrid(np.arange(-8, 8, 2), np.arange(-8, 8, 2), indexing="ij")
    flat = np.array([[0, 0, -8], [2, 0, -8], [2, 2, -8], [0, 2, -8]])
    parts.append(np.stack([i.ravel(), j.ravel(), 0 * i.ravel()], 1)[:, None] + flat)
    squares = np.concatenate(parts)
    soup = rng.integers(-4, 5, (250, 3, 3)) * 2
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]], soup]).astype(np.int64)


@functools.cache
def random_rays(count: int = 4000) -> tuple[np.ndarray, np.ndarray, LatticeHits]:
    """Origins on corners, midway between them, and anywhere on the lattice; all 26 ways."""
    rng = np.random.default_rng(1)
    corners, way = triangles(), WAYS[rng.integers(len(WAYS), size=count)]
    some = corners[rng.integers(len(corners), size=count)]
    middle = (some[:, 0] + some[:, 1]) // 2
    target = np.where(rng.integers(2, size=(count, 1)) == 0, some[:, 0], middle)
    target[::3] = rng.integers(-10, 11, (len(target[::3]), 3))
    origin = target - way * rng.integers(1, 20, (count, 1))
    return origin, way, lattice_hits(origin, way, corners)


def _traced(
    bench: Bench, origin: np.ndarray, way: np.ndarray, exact: LatticeHits, chosen: np.ndarray, any_hit: bool = False
) -> Outcome:
    """Outcome for the `chosen` rays."""
    corners = triangles() * SCALE
    o, d = (origin[chosen] * SCALE).astype(np.float32), way[chosen].astype(np.float32)
    hits = bench.trace(placed(mesh_of(corners)), o, d)
    t, rays = exact.t[chosen] * SCALE, np.arange(len(o))
    right = exact.nearest[chosen][rays, hits.primitive] & hits.hit
    met = corners[hits.primitive]
    least = roundings(bench) * U * reach_of(o.astype(np.float64), met)
    # a triangle that holds the origin may be found at a distance that is 0 but for rounding
    at_origin = hits.hit & exact.at_origin[chosen][rays, hits.primitive] & (hits.t <= least)
    wrong = np.where(np.isfinite(t), ~right & ~at_origin, hits.hit & ~at_origin)
    error = np.abs(hits.t[right] - t[right]) / (U * reach_of(o.astype(np.float64), met)[right])
    # for any hit only its existence counts
    anything = bench.trace(placed(mesh_of(corners)), o, d, any_hit=True)
    wrong |= anything.hit != hits.hit
    note = (
        f"{len(o):,} rays, {int(hits.hit.sum()):,} hit, {int(wrong.sum())} wrong, {int(at_origin.sum())} met where "
        "they start"
    )
    return Outcome(float(error.max(initial=0)) + WRONG * int(wrong.sum()), 0.0, along_roundings(bench), note)


def _register(name: str, about: str, choose, quick: bool = False) -> None:
    @case(
        name,
        FAMILY,
        about + " The nearest triangles are found in whole numbers, by testing all of them.",
        BOUND,
        quick=quick,
    )
    def run(bench: Bench) -> Outcome:
        origin, way, exact = random_rays()
        return _traced(bench, origin, way, exact, choose(way, exact))


_register(
    "rays through corners",
    "Rays along lattice directions that meet a triangle exactly at a corner.",
    lambda way, exact: exact.at_corner,
    quick=True,
)
_register(
    "rays through edges",
    "Rays along lattice directions that meet a triangle exactly within an edge.",
    lambda way, exact: exact.at_edge,
)
_register(
    "rays along edges",
    "Rays whose lines hold an edge exactly: its triangles, seen edge-on, are not met, but what is behind them is.",
    lambda way, exact: exact.along_edge,
    quick=True,
)
_register(
    "rays in planes of triangles",
    "Rays that lie exactly in the plane of a triangle, which is not met then.",
    lambda way, exact: exact.in_plane,
)
_register(
    "rays parallel to axes",
    "Rays along the six axes, most of them through corners and edges.",
    lambda way, exact: (way != 0).sum(1) == 1,
)


@case(
    "rays from the faces of boxes",
    FAMILY,
    "Rays that start exactly on faces, edges and corners of boxes, which are the planes of the tree's boxes too, in "
    "all 26 ways: inwards, outwards and along. The nearest triangles are found in whole numbers, by testing all of "
    "them.",
    BOUND
    + "A triangle that holds the origin may be met where its distance, exactly 0, is rounded to 19 u m or less (25 u m "
    "on CUDA).",
)
def from_faces(bench: Bench) -> Outcome:
    rng = np.random.default_rng(2)
    corners = triangles()
    boxes = corners[rng.integers(60, size=2500)]
    weight = rng.integers(0, 3, 2500)
    a, b, c = boxes[:, 0], boxes[:, 1], boxes[:, 2]
    origin = np.choose(weight[:, None], [a, (a + b) // 2, (b + c) // 2])
    way = WAYS[rng.integers(len(WAYS), size=2500)]
    return _traced(bench, origin, way, lattice_hits(origin, way, corners), np.ones(2500, bool))


@case(
    "directions with tiny components",
    FAMILY,
    "Rays nearly parallel to axes, the other components from 1e-45 (denormal) to 1e-20, of either sign and both "
    "zeros, from planes of faces and from elsewhere. All triangles are tested in float64.",
    """Measured: the largest distance of a hit from its triangle in u m, plus 1e6 for each wrong answer; 19 u m, 25 u m
    on CUDA. In the box test a component counts as at least 2^-40 of the largest, which moves a ray by less than u m /
    2^15 (margin.py).""",
)
def tiny_components(bench: Bench) -> Outcome:
    rng = np.random.default_rng(3)
    count = 4000
    corners = triangles() * SCALE
    some = corners[rng.integers(len(corners), size=count)]
    target = np.where(
        rng.integers(2, size=(count, 1)) == 0,
        some[:, 0],
        np.einsum("nc,nck->nk", rng.dirichlet((1, 1, 1), count), some),
    )
    direction = rng.choice([-1.0, 1.0], (count, 3)) * 10.0 ** rng.uniform(-45, -20, (count, 3))
    direction[rng.random((count, 3)) < 0.2] = -0.0
    axis = rng.integers(3, size=count)
    main = rng.choice([-1.0, 1.0], count)
    direction[np.arange(count), axis] = main
    origin = target.copy()
    origin[np.arange(count), axis] -= main * rng.choice([0.25, 0.5, 1.0, 0.3], count)
    origin, direction = origin.astype(np.float32), direction.astype(np.float32)
    hits = bench.trace(placed(Mesh("lattice", *_arrays(corners))), origin, direction)
    return judge(origin, direction, hits, corners).outcome(roundings(bench))


def _arrays(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mesh = mesh_of(corners)
    assert np.array_equal(corners_of(mesh), corners)  # whole numbers times a power of two
    return mesh.positions, mesh.triangles
