"""Instances that are stretched, mirrored, sheared and all but flat: hits and distances."""

from __future__ import annotations

import numpy as np

from raybatch_addon.core.scene.description import Mesh, Scene
from raybatch_addon.core.scene.validate import checked_scene
from tests.stability.bench import Bench, Hits
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import WRONG, Judgement, U, certain_hits, distance_to_triangles, reach_of, roundings
from tests.stability.geometry.meshes import GREY, SHEAR, corners_of, directions, icosphere, rotation
from tests.support import scenes

FAMILY = "transforms"
CARRIED = """Measured: the largest distance of a hit from its triangle, in units of the bound, plus 1e6 for each wrong
answer. Both are taken in object space, so that an ill-conditioned matrix does not widen the bound. With M the inverse
of the instance's matrix and m its offset, an origin o is carried there by products and sums of float32, off by 5 u (|M|
|o| + |m|) in each coordinate, and a direction d by 4 u |M| |d|; the triangle test adds 19 u (25 u on CUDA) of its
corners' largest coordinate from the origin."""


def placed_by(mesh: Mesh, matrices: list[np.ndarray], **more) -> Scene:
    """`mesh` placed by each matrix, [3, 4]: at least twice, so that it stays in object space."""
    assert len(matrices) > 1
    return scenes.scene([(mesh, matrix, scenes.diffuse(GREY)) for matrix in matrices], **more)


def affine(linear: np.ndarray, offset: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A matrix, float32, shape [3, 4]."""
    return np.concatenate([linear, np.reshape(offset, (3, 1))], 1).astype(np.float32)


def in_world(mesh: Mesh, matrices: list[np.ndarray]) -> np.ndarray:
    """Corners of all instances, float64, shape [instances, triangles, 3, 3]."""
    corners = corners_of(mesh)
    return np.stack([corners @ m[:, :3].astype(np.float64).T + m[:, 3].astype(np.float64) for m in matrices])


def judge_instances(
    bench: Bench, mesh: Mesh, matrices: list[np.ndarray], origin: np.ndarray, direction: np.ndarray, hits: Hits
) -> Judgement:
    """Judgement of the hits of instances, each in its object space; the largest error in units of the bound."""
    corners = corners_of(mesh)
    worst, before = 0.0, np.full(len(origin), np.inf)
    for i, matrix in enumerate(matrices):
        inverse = np.linalg.inv(matrix[:, :3].astype(np.float64))
        offset = -inverse @ matrix[:, 3].astype(np.float64)
        o, d = origin.astype(np.float64) @ inverse.T + offset, direction.astype(np.float64) @ inverse.T
        moved = 5 * U * (np.abs(origin) @ np.abs(inverse).T + np.abs(offset))
        turned = 4 * U * (np.abs(direction) @ np.abs(inverse).T)
        here = np.flatnonzero(hits.instance == i)
        met, t = corners[hits.primitive[here]], hits.t[here].astype(np.float64)[:, None]
        own = roundings(bench) * U * reach_of(o[here], met)
        error = distance_to_triangles(o[here] + t * d[here], met)
        worst = max(
            worst,
            float((error / np.linalg.norm(moved[here] + t * turned[here] + own[:, None], axis=1)).max(initial=0.0)),
        )
        # no triangle of the mesh is farther along the ray than this
        farthest = (np.linalg.norm(o, axis=1) + np.linalg.norm(corners, axis=2).max()) / np.linalg.norm(d, axis=1)
        before = np.minimum(
            before, certain_hits(o, d, corners, np.linalg.norm(moved + farthest[:, None] * turned, axis=1))
        )
    wrong = int(((before < np.inf) & (~hits.hit | (hits.t > before))).sum())
    note = (
        f"{int(hits.hit.sum()):,} of {len(origin):,} rays hit, {int(np.isfinite(before).sum()):,} for certain, "
        f"{wrong} answers are wrong"
    )
    return Judgement(worst, wrong, note)


def aimed_rays(seed: int, mesh: Mesh, matrices: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, edges and insides of triangles of all instances, from points around them; float32."""
    rng = np.random.default_rng(seed)
    corners = in_world(mesh, matrices)
    instance = rng.integers(len(matrices), size=count)
    some = corners[instance, rng.integers(corners.shape[1], size=count)]
    weights = rng.dirichlet((1, 1, 1), count)
    weights[::4] = np.eye(3)[rng.integers(3, size=len(weights[::4]))]
    target = np.einsum("nc,nck->nk", weights, some)
    extent = np.ptp(corners, axis=(1, 2)).max(1)[instance]
    origin = (target + directions(rng, count) * (extent * 10.0 ** rng.uniform(-2, 0.5, count))[:, None]).astype(
        np.float32
    )
    direction = target - origin
    size = np.linalg.norm(direction, axis=1, keepdims=True)
    return origin, (direction / np.where(size > 0, size, 1)).astype(np.float32)


def _swept(bench: Bench, families: dict[str, list[np.ndarray]], count: int = 1500, levels: int = 2) -> Outcome:
    """Worst outcome over all families of matrices."""
    positions, triangles = icosphere(levels)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    sweep = Sweep()
    for number, (name, matrices) in enumerate(families.items()):
        origin, direction = aimed_rays(number, mesh, matrices, count)
        hits = bench.trace(placed_by(mesh, matrices), origin, direction)
        found = judge_instances(bench, mesh, matrices, origin, direction, hits)
        sweep.add(found.worst + WRONG * found.wrong, 0.0, 1.0, f"{name}: {found.note}")
    return sweep.outcome()


def stretched(rng: np.random.Generator, ratio: float, count: int = 3, mirrored: bool = False) -> list[np.ndarray]:
    """Matrices of the condition `ratio`, turned both ways, a few metres apart."""
    made = []
    for _ in range(count):
        scale = np.array([1.0, ratio ** -rng.uniform(0, 1), 1 / ratio]) * (-1 if mirrored else 1)
        before, after = (rotation(int(rng.integers(1 << 30))) for _ in range(2))
        made.append(affine(after * rng.permutation(scale) @ before, rng.uniform(-2, 2, 3)))
    return made


@case(
    "stretched instances",
    FAMILY,
    "Spheres stretched 3, 100 and 10,000 times more along one axis than along another, turned before and after. All "
    "triangles are tested in float64.",
    CARRIED,
    quick=True,
)
def stretched_instances(bench: Bench) -> Outcome:
    rng = np.random.default_rng(1)
    return _swept(bench, {f"{ratio:g} to 1": stretched(rng, ratio) for ratio in (3, 1e2, 1e4)})


@case(
    "mirrored instances",
    FAMILY,
    "The same with three, and with one, negative scale, up to 1,000 to 1. Float64.",
    CARRIED,
)
def mirrored_instances(bench: Bench) -> Outcome:
    rng = np.random.default_rng(2)
    families = {f"mirrored, {ratio:g} to 1": stretched(rng, ratio, mirrored=True) for ratio in (1, 1e3)}
    one = np.diag([1.0, 1.0, -1.0])
    families["one axis mirrored"] = [
        affine(rotation(3) @ one, (0, 0, 1)),
        affine(one),
        affine(one @ rotation(4), (0, 2, 0)),
    ]
    return _swept(bench, families)


@case(
    "sheared instances",
    FAMILY,
    "Spheres with x + k y in place of x, k = 1, 30 and 1,000 (condition 1e6), and turned. Float64.",
    CARRIED,
)
def sheared_instances(bench: Bench) -> Outcome:
    families = {}
    for k in (1.0, 30.0, SHEAR):
        shear = np.eye(3)
        shear[0, 1] = k
        families[f"shear {k:g}"] = [
            affine(shear),
            affine(rotation(5) @ shear, (1, 0, 0)),
            affine(shear @ rotation(6), (0, 1, 2)),
        ]
    return _swept(bench, families)


@case(
    "nearly singular instances",
    FAMILY,
    "Spheres flattened to 3e-7 and 1e-6 of their size: nearly what counts as flat (1.2e-7, the rounding of float32). "
    "Float64, in the world.",
    CARRIED,
)
def nearly_singular(bench: Bench) -> Outcome:
    families = {}
    for flat in (3e-7, 1e-6):
        squash = np.diag([1.0, 1.0, flat])
        turned = [affine(rotation(7) @ squash @ rotation(8), (0, 0, 1)), affine(squash @ rotation(9), (3, 0, 0))]
        families[f"flattened to {flat:g}"] = [affine(squash), *turned]
    return _swept(bench, families)


@case(
    "instances of 1e-12 and 1e12",
    FAMILY,
    "Spheres of 1 m scaled to 1e-12 and 1e12 of their size, so that directions in object space are 1e12 and 1e-12 "
    "long. Float64.",
    CARRIED,
)
def far_scales(bench: Bench) -> Outcome:
    def two(scale: float) -> list[np.ndarray]:
        return [affine(scale * rotation(10)), affine(scale * rotation(11), (3 * scale, 0, 0))]

    return _swept(bench, {f"{scale:g}": two(scale) for scale in (1e-12, 1e-6, 1e6, 1e12)})


@case(
    "instances beyond what is singular",
    FAMILY,
    "Two spheres, and instances flattened to 0 and to 1e-8, of scale 0, and not finite. They are left out with a "
    "warning each, and hits are those of the two alone, to the bit.",
    "A count of hits that differ, and of warnings that are missing: 0.",
    quick=True,
)
def singular(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    good = [affine(rotation(12)), affine(0.5 * rotation(13), (1, 0, 0))]
    bad = [np.diag([1.0, 1, 0]), np.diag([1.0, 1, 1e-8]), np.zeros((3, 3)), np.diag([np.nan, 1, 1])]
    both = placed_by(mesh, good + [affine(matrix) for matrix in bad])
    origin, direction = aimed_rays(14, mesh, good, 5000)
    one, other = bench.trace(placed_by(mesh, good), origin, direction), bench.trace(both, origin, direction)
    differs = (one.instance != other.instance) | (one.t != other.t)
    differs |= one.hit & ((one.primitive != other.primitive) | (one.uv != other.uv).any(1))
    warnings = checked_scene(both).warnings
    missing = sum(not any(f"object {len(good) + i}”" in text for text in warnings) for i in range(len(bad)))
    return Outcome(
        int(differs.sum()) + missing, 0.0, 0.0, f"{int(one.hit.sum()):,} of 5,000 rays hit; {len(warnings)} warnings"
    )


@case(
    "instances in the same place",
    FAMILY,
    "Three instances with the same sheared matrix: every hit names the first of them, with the distance that it has "
    "alone, to the bit.",
    "The same ray in the same matrix gives the same numbers: nothing may differ.",
    quick=True,
)
def same_place(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    shear = affine(rotation(15) @ [[1, 30, 0], [0, 1, 0], [0, 0, 1]], (1, 2, 3))
    aside = affine(np.eye(3), (1e3, 0, 0))  # keeps the mesh in object space
    origin, direction = aimed_rays(16, mesh, [shear], 5000)
    one = bench.trace(placed_by(mesh, [shear, aside]), origin, direction)
    three = bench.trace(placed_by(mesh, [shear, shear, shear, aside]), origin, direction)
    differs = (one.t != three.t) | (one.hit & ((three.instance != one.instance) | (one.primitive != three.primitive)))
    return Outcome(float(differs.sum()), 0.0, 0.0, f"{int(one.hit.sum()):,} of 5,000 rays hit")


@case(
    "an instance as if it were baked",
    FAMILY,
    "A mesh placed by the unit matrix, as an instance and in world space: the same hits, to the bit.",
    "Products with 1 and 0 and sums with 0 are exact: nothing may differ.",
)
def unit_instance(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    unit, aside = affine(np.eye(3)), affine(np.eye(3), (1e3, 0, 0))
    origin, direction = aimed_rays(17, mesh, [unit], 20_000)
    one = bench.trace(placed_by(mesh, [unit, aside]), origin, direction)
    baked = bench.trace(scenes.scene([(mesh, unit, scenes.diffuse(GREY))]), origin, direction)
    differs = (
        (one.hit != baked.hit)
        | (one.t != baked.t)
        | (one.hit & ((one.primitive != baked.primitive) | (one.uv != baked.uv).any(1)))
    )
    return Outcome(float(differs.sum()), 0.0, 0.0, f"{int(one.hit.sum()):,} of 20,000 rays hit")


@case(
    "leaks of an instance sheared by 1,000",
    FAMILY,
    "Rays from the inner twentieth of a sphere that is an instance sheared to the condition 1e6: all must meet it.",
    "Carried to the sphere, an origin is off by 8 u |M| |o|, |M| = 1,001 and |o| = 50 m: 0.024 of its radius; "
    "directions do not matter. The test is watertight: not one.",
)
def instance_leaks(bench: Bench) -> Outcome:
    rng = np.random.default_rng(18)
    positions, triangles = icosphere(4)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    shear = np.eye(3)
    shear[0, 1] = SHEAR
    count = 100_000
    inside = 0.05 * directions(rng, count) * rng.uniform(0, 1, (count, 1))
    aim = positions[rng.integers(len(positions), size=count)] - inside
    aim[::2] = directions(rng, len(aim[::2]))
    direction = aim @ shear.T
    direction[1::4] = directions(rng, len(direction[1::4]))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    scene = placed_by(mesh, [affine(shear), affine(shear, (0, 1e3, 0))])
    hits = bench.trace(scene, (inside @ shear.T).astype(np.float32), direction.astype(np.float32))
    missed = int((hits.instance != 0).sum())
    return Outcome(float(missed), 0.0, 0.0, f"{count:,} rays, {missed} slipped through")
