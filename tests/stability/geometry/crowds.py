"""Many triangles at one position: copies of one, layers, and a thousand around one corner."""

from __future__ import annotations

import math
import time

import numpy as np

from raybatch_addon.core.scene.description import Frame, Mesh
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import IN_ROUNDINGS, WRONG, U, along_roundings, backward_error, judge, roundings
from tests.stability.geometry.meshes import GREY, corners_of, directions, icosphere, mesh_of, placed, rotation, unit
from tests.support import scenes

FAMILY = "geometry"


# --- many in one place


@case(
    "every triangle six times",
    FAMILY,
    "A sphere with each triangle three times as it is and three times reversed, in random order. The hit names "
    "the first of the triangles that are the same to the bit; the distance is judged in float64.",
    IN_ROUNDINGS,
)
def six_times(bench: Bench) -> Outcome:
    rng = np.random.default_rng(7)
    positions, triangles = icosphere(3)
    copies = np.concatenate([triangles] * 3 + [triangles[:, [0, 2, 1]]] * 3)
    order = rng.permutation(len(copies))
    mesh = Mesh("six spheres", positions.astype(np.float32), np.ascontiguousarray(copies[order]))
    kind = order % len(triangles) + len(triangles) * (order >= 3 * len(triangles))
    first = np.full(2 * len(triangles), len(copies))
    np.minimum.at(first, kind, np.arange(len(copies)))
    count = 1500
    origin = rng.uniform(-0.5, 0.5, (count, 3)).astype(np.float32)
    direction = directions(rng, count).astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    found = judge(origin, direction, hits, corners_of(mesh), must_hit=True)
    found.wrong += int((first[kind[hits.primitive]] != hits.primitive).sum())
    return found.outcome(roundings(bench))


def _bytes_per_triangle(tracer: object, count: int) -> tuple[float, int]:
    """Bytes per triangle of the tracer's trees, and their depth."""
    statistics = tracer.scene.built.statistics
    return statistics["bytes"] / count, statistics["depth"]


COINCIDENT = 1_000_000
# Triangles take 40 to 48 bytes each where blocks are full. At worst a leaf of the layout BOXES holds one triangle of
# eight, in 320 bytes, below a node of 256 bytes that has eight children
TREE_BYTES_MAX = 320 + 256 / 7
# halves of a million are one triangle after 20 levels; nodes have two children at least
DEPTH_MAX = 21


@case(
    "a million coincident triangles",
    FAMILY,
    "One triangle a million times: the tree is built, no larger and no deeper than its layout allows, every ray meets "
    "triangle 0, and its distance is right.",
    "Bytes a triangle at most 320 + 256 / 7 and depth at most 21 (halving a million), else 1e6 is added. "
    "Triangles that are the same give distances that are the same, of which the first counts; 19 u m (25 on CUDA) for "
    "the distance.",
)
def coincident(bench: Bench) -> Outcome:
    rng = np.random.default_rng(8)
    one = np.array([[-1, -1, 0.3], [1, -1, -0.2], [0, 1, 0.1]], np.float32)
    mesh = Mesh("a million times", one, np.broadcast_to(np.int32([0, 1, 2]), (COINCIDENT, 3)).copy())
    began = time.perf_counter()
    tracer = bench.tracer_of(placed(mesh), 64)
    built = time.perf_counter() - began
    size, depth = _bytes_per_triangle(tracer, COINCIDENT)
    target = rng.dirichlet((1, 1, 1), 64) @ one.astype(np.float64)
    origin = (target + 3 * directions(rng, 64)).astype(np.float32)
    direction = unit(target - origin).astype(np.float32)
    hits = tracer.trace(origin, direction)
    seconds = time.perf_counter() - began - built
    wrong = ~hits.hit | (hits.primitive != 0)
    worst = backward_error(origin, direction, hits, np.broadcast_to(one.astype(np.float64), (COINCIDENT, 3, 3)))
    measured = worst + WRONG * (int(wrong.sum()) + (size > TREE_BYTES_MAX) + (depth > DEPTH_MAX))
    note = f"{size:.0f} bytes a triangle, depth {depth}, built in {built:.1f} s, 64 rays in {seconds:.1f} s"
    return Outcome(measured, 0.0, roundings(bench), note)


@case(
    "a million triangles in one point",
    FAMILY,
    "A sphere, and a million triangles whose corners are all the same point in its middle: hits are those of the "
    "sphere alone, to the bit.",
    "Nothing may differ; bytes and depth as for a million coincident triangles, else 1e6 is added.",
)
def coincident_points(bench: Bench) -> Outcome:
    rng = np.random.default_rng(9)
    positions, triangles = icosphere(3)
    vertices = np.concatenate([positions, [[0.1, 0.2, 0.3]]]).astype(np.float32)
    points = np.full((COINCIDENT, 3), len(positions), np.int32)
    count = 500
    origin = (1.5 * directions(rng, count)).astype(np.float32)
    direction = directions(rng, count)
    direction[::5] = vertices[-1] - origin[::5]
    direction = direction.astype(np.float32)
    one = bench.trace(placed(Mesh("sphere", vertices, triangles)), origin, direction)
    began = time.perf_counter()
    tracer = bench.tracer_of(placed(Mesh("sphere and points", vertices, np.concatenate([triangles, points]))), count)
    built = time.perf_counter() - began
    size, depth = _bytes_per_triangle(tracer, COINCIDENT)
    both = tracer.trace(origin, direction)
    differs = (one.hit != both.hit) | (one.t != both.t) | (one.hit & (one.primitive != both.primitive))
    measured = int(differs.sum()) + WRONG * ((size > TREE_BYTES_MAX) + (depth > DEPTH_MAX + 2))
    seconds = time.perf_counter() - began - built
    note = f"{size:.0f} bytes a triangle, depth {depth}, built in {built:.1f} s, {count} rays in {seconds:.1f} s"
    return Outcome(measured, 0.0, 0.0, note)


# --- layers

LAYERS, APART = 64, 1e-7


def _layers(turn: np.ndarray) -> Mesh:
    """Squares of 2 m in layers APART; the highest has the last two triangles."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    corners = np.concatenate(
        [square[[0, 1, 2, 0, 2, 3]].reshape(2, 3, 3) + [0, 0, APART * (k - LAYERS + 1)] for k in range(LAYERS)]
    )
    return mesh_of(corners @ turn.T)


@case(
    "layers 1e-7 m apart, from near",
    FAMILY,
    "64 squares of 2 m, rays straight down from 1e-9 to 1e-3 m above the highest: that one is met, at the height of "
    "the origin (a closed form).",
    "Straight down only heights enter the distance: it is right but for 14 u of the height (20 u on CUDA), which is "
    "below 2e-9 m, less than the layers' distance. Measured in u, plus 1e6 for each wrong layer.",
    quick=True,
)
def layers_near(bench: Bench) -> Outcome:
    rng = np.random.default_rng(10)
    count = 5000
    height = 10.0 ** rng.uniform(-9, -3, count)
    origin = np.concatenate([rng.uniform(-0.9, 0.9, (count, 2)), height[:, None]], 1).astype(np.float32)
    direction = np.broadcast_to(np.float32([0, 0, -1]), origin.shape)
    hits = bench.trace(placed(_layers(np.eye(3))), origin, direction)
    wrong = ~hits.hit | (hits.primitive // 2 != LAYERS - 1)
    error = np.abs(hits.t.astype(np.float64) / origin[:, 2] - 1)[~wrong].max(initial=0) / U
    note = f"{int(wrong.sum())} of {count:,} rays met another layer"
    return Outcome(error + WRONG * int(wrong.sum()), 0.0, along_roundings(bench), note)


@case(
    "layers 1e-7 m apart, from anywhere",
    FAMILY,
    "The same squares, level and turned, and rays from 1e-7 to 10 m away in all directions. All triangles are tested "
    "in float64: a hit is no farther than the first layer that is met for certain.",
    IN_ROUNDINGS,
)
def layers_far(bench: Bench) -> Outcome:
    rng = np.random.default_rng(11)
    sweep = Sweep()
    for name, turn in (("level", np.eye(3)), ("turned", rotation(12))):
        mesh = _layers(turn)
        count = 4000
        target = np.concatenate([rng.uniform(-0.9, 0.9, (count, 2)), rng.uniform(-LAYERS * APART, 0, (count, 1))], 1)
        origin = ((target + directions(rng, count) * 10.0 ** rng.uniform(-7, 1, (count, 1))) @ turn.T).astype(
            np.float32
        )
        direction = target @ turn.T - origin
        direction = unit(direction).astype(np.float32)
        hits = bench.trace(placed(mesh), origin, direction)
        found = judge(origin, direction, hits, corners_of(mesh)).outcome(roundings(bench))
        sweep.add(found.measured, 0.0, found.tolerance, f"{name}: {found.note}")
    return sweep.outcome()


@case(
    "layers 1e-7 m apart in the sun",
    FAMILY,
    "The 64 squares seen from above and lit from above: albedo / pi times irradiance times cosine, whichever of the "
    "layers rays take for the highest.",
    "32 u for light and closure, relatively. Seen from 0.75 m away heights are off by 19 u of that (CUDA): a layer "
    "taken for the highest is within 29 u = 1.7e-6 m of it. A ray leaves a point at 25 u of the longest side, 2 m "
    "here: 50 u, above all of these.",
)
def layers_lit(bench: Bench) -> Outcome:
    sweep = Sweep()
    for angle in (0.0, 45.0, 80.0):
        light = (math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle)))
        view = scenes.camera(eye=(0, 0, 0.75), half_width=1.0, up=(0.0, 1.0, 0.0))
        sun = scenes.sun(1.0, 0.0, scenes.look_at(light, (0, 0, 0), (0, 1, 0)))
        scene = placed(_layers(np.eye(3)), lights=[sun], view=view, frame=Frame(24, 24))
        picture = bench.render(scene, sample_count=4, bounce_max=0)
        sweep.add(np.abs(picture / (GREY / math.pi * light[2]) - 1).max(), 0.0, 32 * U, f"sun at {angle:g} degrees")
    return sweep.outcome()


@case(
    "a thousand triangles at one corner",
    FAMILY,
    "A closed double cone whose two corners are shared by 1,000 triangles each. Rays from inside at these corners, "
    "exactly and nearly, all meet it.",
    IN_ROUNDINGS,
    quick=True,
)
def many_at_a_corner(bench: Bench) -> Outcome:
    rng = np.random.default_rng(13)
    around, count = 1000, 4000
    angle = np.arange(around) * (2 * np.pi / around)
    positions = np.concatenate(
        [np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1), [[0, 0, 1], [0, 0, -1]]]
    ).astype(np.float32)
    i = np.arange(around)
    j = (i + 1) % around
    triangles = np.concatenate([np.stack([i, j, 0 * i + around], 1), np.stack([j, i, 0 * i + around + 1], 1)]).astype(
        np.int32
    )
    mesh = Mesh("double cone", positions, triangles)
    origin = (rng.integers(-8, 9, (count, 3)) / 32).astype(np.float32)
    direction = positions[around + rng.integers(2, size=count)] - origin  # exact
    direction[1::2] += (10.0 ** rng.uniform(-9, -5, (count // 2, 1)) * directions(rng, count // 2)).astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    return judge(origin, direction, hits, corners_of(mesh), must_hit=True).outcome(roundings(bench))
