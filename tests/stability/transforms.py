"""Instances that are stretched, mirrored, sheared and all but flat: hits, distances, normals and light."""

from __future__ import annotations

import math

import numpy as np
import scenes

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Mesh, Scene
from raybatch_addon.core.scene.validate import checked_scene

from .bench import Bench, Hits
from .case import Outcome, Sweep, case
from .exact import U, WRONG, Judgement, certain_hits, distance_to_triangles, reach_of, roundings
from .meshes import GREY, SHEAR, corners_of, directions, icosphere, rotation

FAMILY = "transforms"
CARRIED = """Measured: the largest distance of a hit from its triangle, in units of the bound, plus 1e6 for each wrong answer. Both are
taken in object space, so that an ill-conditioned matrix does not widen the bound. With M the inverse of the instance's matrix and m its
offset, an origin o is carried there by products and sums of float32, off by 5 u (|M| |o| + |m|) in each coordinate, and a direction d
by 4 u |M| |d|; the triangle test adds 19 u (25 u on CUDA) of its corners' largest coordinate from the origin."""


def placed_by(mesh: Mesh, matrices: list[np.ndarray], **more) -> Scene:
    """`mesh` placed by each matrix, [3, 4]: at least twice, so that it stays in object space."""
    assert len(matrices) > 1
    return scenes.scene([(mesh, matrix, scenes.diffuse(GREY)) for matrix in matrices], **more)


def affine(linear: np.ndarray, place: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A matrix, float32, shape [3, 4]."""
    return np.concatenate([linear, np.reshape(place, (3, 1))], 1).astype(np.float32)


def in_world(mesh: Mesh, matrices: list[np.ndarray]) -> np.ndarray:
    """Corners of all instances, float64, shape [instances, triangles, 3, 3]."""
    corners = corners_of(mesh)
    return np.stack([corners @ m[:, :3].astype(np.float64).T + m[:, 3].astype(np.float64) for m in matrices])


def judge_instances(
    bench: Bench, mesh: Mesh, matrices: list[np.ndarray], origin: np.ndarray, direction: np.ndarray, hits: Hits
) -> Judgement:  # fmt: skip
    """The hits of instances, each judged in its object space; the largest error in units of the bound."""
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
        worst = max(worst, float((error / np.linalg.norm(moved[here] + t * turned[here] + own[:, None], axis=1)).max(initial=0.0)))
        # no triangle of the mesh is farther along the ray than this
        farthest = (np.linalg.norm(o, axis=1) + np.linalg.norm(corners, axis=2).max()) / np.linalg.norm(d, axis=1)
        before = np.minimum(before, certain_hits(o, d, corners, np.linalg.norm(moved + farthest[:, None] * turned, axis=1)))
    wrong = int(((before < np.inf) & (~hits.hit | (hits.t > before))).sum())
    note = f"{int(hits.hit.sum()):,} of {len(origin):,} rays hit, {int(np.isfinite(before).sum()):,} for certain, {wrong} answers are wrong"
    return Judgement(worst, wrong, note)


def aimed_rays(seed: int, mesh: Mesh, matrices: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays at corners, edges and insides of triangles of all instances, from around them; float32."""
    rng = np.random.default_rng(seed)
    corners = in_world(mesh, matrices)
    instance = rng.integers(len(matrices), size=count)
    some = corners[instance, rng.integers(corners.shape[1], size=count)]
    weights = rng.dirichlet((1, 1, 1), count)
    weights[::4] = np.eye(3)[rng.integers(3, size=len(weights[::4]))]
    target = np.einsum("nc,nck->nk", weights, some)
    extent = np.ptp(corners, axis=(1, 2)).max(1)[instance]
    origin = (target + directions(rng, count) * (extent * 10.0 ** rng.uniform(-2, 0.5, count))[:, None]).astype(np.float32)
    direction = target - origin
    size = np.linalg.norm(direction, axis=1, keepdims=True)
    return origin, (direction / np.where(size > 0, size, 1)).astype(np.float32)


def _swept(bench: Bench, families: dict[str, list[np.ndarray]], count: int = 1500, levels: int = 2) -> Outcome:
    """Worst of all families of matrices."""
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
    "stretched instances", FAMILY,
    "Spheres stretched 3, 100 and 10,000 times more along one axis than along another, turned before and after. All triangles are asked "
    "in float64.",
    CARRIED,
    quick=True,
)  # fmt: skip
def stretched_instances(bench: Bench) -> Outcome:
    rng = np.random.default_rng(1)
    return _swept(bench, {f"{ratio:g} to 1": stretched(rng, ratio) for ratio in (3, 1e2, 1e4)})


@case("mirrored instances", FAMILY, "The same with three, and with one, negative scale, up to 1,000 to 1. Float64.", CARRIED)
def mirrored_instances(bench: Bench) -> Outcome:
    rng = np.random.default_rng(2)
    families = {f"mirrored, {ratio:g} to 1": stretched(rng, ratio, mirrored=True) for ratio in (1, 1e3)}
    one = np.diag([1.0, 1.0, -1.0])
    families["one axis mirrored"] = [affine(rotation(3) @ one, (0, 0, 1)), affine(one), affine(one @ rotation(4), (0, 2, 0))]
    return _swept(bench, families)


@case(
    "sheared instances", FAMILY,
    "Spheres with x + k y in place of x, k = 1, 30 and 1,000 (condition 1e6), and turned. Float64.", CARRIED,
)  # fmt: skip
def sheared_instances(bench: Bench) -> Outcome:
    families = {}
    for k in (1.0, 30.0, SHEAR):
        shear = np.eye(3)
        shear[0, 1] = k
        families[f"shear {k:g}"] = [affine(shear), affine(rotation(5) @ shear, (1, 0, 0)), affine(shear @ rotation(6), (0, 1, 2))]
    return _swept(bench, families)


@case(
    "nearly singular instances", FAMILY,
    "Spheres flattened to 3e-7 and 1e-6 of their size: all but what counts as flat (1.2e-7, the rounding of float32). Float64, in the "
    "world.",
    CARRIED,
)  # fmt: skip
def nearly_singular(bench: Bench) -> Outcome:
    families = {}
    for flat in (3e-7, 1e-6):
        squash = np.diag([1.0, 1.0, flat])
        turned = [affine(rotation(7) @ squash @ rotation(8), (0, 0, 1)), affine(squash @ rotation(9), (3, 0, 0))]
        families[f"flattened to {flat:g}"] = [affine(squash), *turned]
    return _swept(bench, families)


@case(
    "instances of 1e-12 and 1e12", FAMILY,
    "Spheres of 1 m scaled to 1e-12 and 1e12 of their size, so that directions in object space are 1e12 and 1e-12 long. Float64.",
    CARRIED,
)  # fmt: skip
def far_scales(bench: Bench) -> Outcome:
    def two(scale: float) -> list[np.ndarray]:
        return [affine(scale * rotation(10)), affine(scale * rotation(11), (3 * scale, 0, 0))]

    return _swept(bench, {f"{scale:g}": two(scale) for scale in (1e-12, 1e-6, 1e6, 1e12)})


@case(
    "instances beyond what is singular", FAMILY,
    "Beside two spheres: instances flattened to 0 and to 1e-8, of scale 0, and not finite. They are left out with a warning each, and "
    "hits are those of the two alone, to the bit.",
    "A count of hits that differ, and of warnings that are missing: 0.",
    quick=True,
)  # fmt: skip
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
    return Outcome(int(differs.sum()) + missing, 0.0, 0.0, f"{int(one.hit.sum()):,} of 5,000 rays hit; {len(warnings)} warnings")


@case(
    "instances in the same place", FAMILY,
    "Three instances with the same sheared matrix: every hit names the first of them, with the distance that it has alone, to the bit.",
    "The same ray in the same matrix gives the same numbers: nothing may differ.",
    quick=True,
)  # fmt: skip
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
    "an instance as if it were baked", FAMILY,
    "A mesh placed by the unit matrix, as an instance and in world space: the same hits, to the bit.",
    "Products with 1 and 0 and sums with 0 are exact: nothing may differ.",
)  # fmt: skip
def unit_instance(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("sphere", positions.astype(np.float32), triangles)
    unit, aside = affine(np.eye(3)), affine(np.eye(3), (1e3, 0, 0))
    origin, direction = aimed_rays(17, mesh, [unit], 20_000)
    one = bench.trace(placed_by(mesh, [unit, aside]), origin, direction)
    baked = bench.trace(scenes.scene([(mesh, unit, scenes.diffuse(GREY))]), origin, direction)
    differs = (one.hit != baked.hit) | (one.t != baked.t) | (one.hit & ((one.primitive != baked.primitive) | (one.uv != baked.uv).any(1)))
    return Outcome(float(differs.sum()), 0.0, 0.0, f"{int(one.hit.sum()):,} of 20,000 rays hit")


@case(
    "leaks of an instance sheared by 1,000", FAMILY,
    "Rays from the inner twentieth of a sphere that is an instance sheared to the condition 1e6: all must meet it.",
    "Carried to the sphere, an origin is off by 8 u |M| |o|, |M| = 1,001 and |o| = 50 m: 0.024 of its radius; directions do not matter. "
    "The test is watertight: not one.",
)  # fmt: skip
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


@case(
    "a mirrored ball of glass", FAMILY,
    "A ball of glass (IOR 1.5) before a lit square and a dark one, as it is and mirrored: its triangles lie where they lay, so the "
    "picture stays. Were inside and outside "
    "exchanged, it would be a lens of IOR 1 / 1.5.",
    "The mean difference of pixels over the mean. Samples have the same random numbers, so only those differ that roundings carry over "
    "an edge: of 40,000 paths with some "
    "3 events each, 1e-3 at most, in ten events. 1e-2.",
)  # fmt: skip
def mirrored_glass(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("ball", positions.astype(np.float32), triangles)
    glass = scenes.material(Closure(ClosureKind.GLASS, (1.0, 1.0, 1.0), ior=1.5))
    lamp = scenes.plane("lamp", 6.0)
    upright = affine(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T, (3.0, 4.0, 0.0))
    pictures = []
    for matrix in (np.eye(3), np.diag([-1.0, 1, 1])):
        objects = [(mesh, affine(matrix), glass), (mesh, affine(matrix, (0, -50, 0)), glass), (lamp, upright, scenes.emitter(1.0))]
        scene = scenes.scene(objects, view=scenes.camera(eye=(0, -4, 0), half_width=0.35), frame=Frame(32, 32), world=0.05)
        pictures.append(bench.render(scene, sample_count=40))
    change = np.abs(pictures[0] - pictures[1]).mean() / pictures[0].mean()
    return Outcome(float(change), 0.0, 1e-2, f"mean {pictures[0].mean():.4f} and {pictures[1].mean():.4f}")


# --- light on instances

SQUARE = Mesh("square", np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def _floors() -> dict[str, np.ndarray]:
    """Matrices of a square that stays around the origin."""
    shear = np.array([[1.0, SHEAR, 0], [0, 1, 0], [0, 0, 1]])
    return {
        "stretched": np.diag([100.0, 0.5, 3.0]),
        "flattened to 1e-6 across": np.diag([1.0, 1, 1e-6]),
        "mirrored": np.diag([1.0, -1, 1]),
        "mirrored across": np.diag([1.0, 1, -1]),
        "turned, mirrored": rotation(19) @ np.diag([-1.0, 1, 1]),
        "sheared along itself by 1,000": shear,
        "sheared out of its plane by 1,000": shear[[2, 1, 0]][:, [2, 1, 0]],
        "turned, sheared by 30": rotation(20) @ [[1, 30, 0], [0, 1, 0], [0, 0, 1]],
    }


def _tangents(linear: np.ndarray) -> tuple[np.ndarray, float]:
    """The unit normal that the square has in the world, and 1 / sine of the angle between its sides there."""
    linear = linear.astype(np.float32).astype(np.float64)
    normal = np.cross(linear[:, 0], linear[:, 1])
    size = np.linalg.norm(normal)
    return normal / size, float(np.linalg.norm(linear[:, 0]) * np.linalg.norm(linear[:, 1]) / size)


@case(
    "normals of instances", FAMILY,
    "A square stretched, flattened, mirrored and sheared by up to 1,000: the pass Normal, which faces the viewer, is the cross product "
    "of its sides in the world, in float64.",
    "The normal is carried by cofactors, here a b' - b a' of the sides a, b: 6 u |a| |b| / |a x b| in all, and 8 u for lengths. "
    "Measured in units of that.",
)  # fmt: skip
def normals(bench: Bench) -> Outcome:
    sweep = Sweep()
    for name, linear in _floors().items():
        expected, flat = _tangents(linear)
        picture = _seen(bench, linear, (), passes=("Combined", "Normal")).passes["Normal"].astype(np.float64)
        tolerance = 8 * U + 6 * U * flat
        sweep.add(np.abs(picture - expected).max() / tolerance, 0.0, 1.0, name)
    return sweep.outcome()


def _seen(bench: Bench, linear: np.ndarray, lights: tuple, passes: tuple[str, ...] = ("Combined",)):
    """The film of the square from straight above it; the square fills the picture."""
    normal, _ = _tangents(linear)
    aside = linear[:, 0] / np.linalg.norm(linear[:, 0])
    # so near that the smallest of the sides' shadows on each other fills the window
    size = np.linalg.norm(np.cross(linear[:, 0], linear[:, 1])) / max(np.linalg.norm(linear[:, 0]), np.linalg.norm(linear[:, 1]))
    view = scenes.camera(eye=tuple(normal), target=(0, 0, 0), half_width=0.2 * min(1.0, size), up=tuple(aside))
    away = affine(linear, 50 * normal * -1 + 0 * aside)
    scene = placed_by(SQUARE, [affine(linear), away], view=view, frame=Frame(16, 16, passes=passes), lights=lights)
    return bench.film(scene, sample_count=4, bounce_max=0)


@case(
    "instances in the sun", FAMILY,
    "The same squares with the sun straight above and 70 degrees off: albedo / pi times irradiance times the cosine with the exact "
    "normal. No pixel is in its own shadow.",
    "32 u for light and closure, and the error of the normal (as for the pass Normal) times tan 70 degrees, relatively.",
)  # fmt: skip
def lit(bench: Bench) -> Outcome:
    sweep = Sweep()
    for name, linear in _floors().items():
        normal, flat = _tangents(linear)
        aside = linear[:, 0] / np.linalg.norm(linear[:, 0])
        tolerance = 32 * U + (8 * U + 6 * U * flat) * math.tan(math.radians(70))
        for angle in (0.0, 70.0):
            towards = math.cos(math.radians(angle)) * normal + math.sin(math.radians(angle)) * aside
            matrix = scenes.look_at(towards, (0, 0, 0), np.cross(normal, aside))
            cosine = float(matrix[:, 2].astype(np.float64) @ normal)
            picture = _seen(bench, linear, (scenes.sun(1.0, 0.0, matrix),)).passes["Combined"][..., :3].astype(np.float64)
            sweep.add(np.abs(picture / (GREY / math.pi * cosine) - 1).max(), 0.0, tolerance, f"{name}, sun at {angle:g} degrees")
    return sweep.outcome()
