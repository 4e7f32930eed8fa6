"""Triangles that are hard to hit: slivers, tiny ones, and those without area."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import Frame, Mesh
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import IN_ROUNDINGS, WRONG, U, along_roundings, backward_error, judge, roundings
from tests.stability.geometry.meshes import (
    GREY,
    corners_of,
    directions,
    grid,
    icosphere,
    mesh_of,
    placed,
    rotation,
    strip,
    unit,
)
from tests.support import scenes

FAMILY = "geometry"


# --- slivers


def _at_strip(bench: Bench, turn: np.ndarray) -> Outcome:
    """Rays at the inner half of the strip, turned; each must hit it."""
    rng = np.random.default_rng(1)
    count = 20_000
    mesh = strip()
    mesh = Mesh(mesh.name, (mesh.positions.astype(np.float64) @ turn.T).astype(np.float32), mesh.triangles)
    target = np.stack([rng.uniform(-10, 10, count), rng.uniform(-1e-3, 1e-3, count), np.zeros(count)], 1)
    d = directions(rng, count)
    d[:, 2] = np.copysign(np.maximum(np.abs(d[:, 2]), 0.15), d[:, 2])
    d = unit(d)
    origin = (target - d * 10.0 ** rng.uniform(-3, 1, (count, 1))) @ turn.T
    origin, direction = origin.astype(np.float32), (d @ turn.T).astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    missed = int((~hits.hit).sum())
    worst = backward_error(origin, direction, hits, corners_of(mesh))
    return Outcome(worst + WRONG * missed, 0.0, roundings(bench), f"{count:,} rays, {missed} slipped through")


@case(
    "slivers of aspect 1e8, side by side",
    FAMILY,
    "A rectangle of 8,000 triangles, 100 m long and 1 um wide. Rays at its inner half, down to 8 degrees, all meet it "
    "(a closed form).",
    IN_ROUNDINGS
    + " Rays pass the outline at 1e-3 m times the sine of 8 degrees; corners, as the test sees them, move by 5 u m = "
    "2e-5 m.",
    quick=True,
)
def slivers(bench: Bench) -> Outcome:
    return _at_strip(bench, np.eye(3))


@case(
    "slivers of aspect 1e8, turned",
    FAMILY,
    "The same, turned: corners are rounded by more than slivers are wide, so that these overlap and are folded over. "
    "No ray slips through: neighbours share their corners, and the outline is where it was.",
    IN_ROUNDINGS,
)
def slivers_turned(bench: Bench) -> Outcome:
    return _at_strip(bench, rotation(5))


@case(
    "slivers among triangles",
    FAMILY,
    "600 slivers of aspect 1e7 and more (some without area, by rounding) and 200 triangles, without order. All "
    "triangles are tested in float64.",
    IN_ROUNDINGS
    + " A triangle that is met farther from its edges than 32 sqrt(3) u m is met for certain: a hit beyond it is "
    "wrong.",
)
def sliver_soup(bench: Bench) -> Outcome:
    rng = np.random.default_rng(2)
    a, along = rng.uniform(-1, 1, (600, 3)), directions(rng, 600)
    c = a + along * rng.uniform(0, 1, (600, 1)) + 1e-8 * rng.normal(size=(600, 3))
    soup = rng.uniform(-1, 1, (200, 1, 3)) + rng.uniform(-0.3, 0.3, (200, 3, 3))
    mesh = mesh_of(np.concatenate([np.stack([a, a + along, c], 1), soup]))
    corners = corners_of(mesh)
    count = 4000
    weights = rng.dirichlet((0.5, 0.5, 0.5), count)
    target = np.einsum("nc,nck->nk", weights, corners[rng.integers(len(corners), size=count)])
    origin = (target + directions(rng, count) * 10.0 ** rng.uniform(-4, 1, (count, 1))).astype(np.float32)
    direction = unit(target - origin).astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    return judge(origin, direction, hits, corners).outcome(roundings(bench))


@case(
    "slivers in the sun",
    FAMILY,
    "The rectangle of slivers under suns at 0, 60 and 80 degrees from its normal: albedo / pi times irradiance times "
    "cosine in every pixel that shows it.",
    "Light, cosine and closure take some 20 operations of float32: 32 u, relatively. A pixel whose shadow ray met the "
    "surface again would be black.",
)
def slivers_lit(bench: Bench) -> Outcome:
    sweep = Sweep()
    for angle in (0.0, 60.0, 80.0):
        light = (math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle)))
        view = scenes.camera(eye=(0, 0, 2), half_width=5e-4, up=(0.0, 1.0, 0.0))
        scene = placed(
            strip(),
            lights=[scenes.sun(1.0, 0.0, scenes.look_at(light, (0, 0, 0), (0, 1, 0)))],
            view=view,
            frame=Frame(24, 24),
        )
        picture = bench.render(scene, sample_count=4, bounce_max=0)
        sweep.add(np.abs(picture / (GREY / math.pi * light[2]) - 1).max(), 0.0, 32 * U, f"sun at {angle:g} degrees")
    return sweep.outcome()


# --- tiny triangles


@case(
    "triangles of areas that are denormal",
    FAMILY,
    "A sphere of 6e-19 m, 1,280 triangles of 3e-39 m2 or less. Rays from inside all meet it; all triangles are tested "
    "in float64.",
    IN_ROUNDINGS + " Edge functions below 2^-80 are computed again in float64, where products of float32 are exact.",
    quick=True,
)
def denormal_areas(bench: Bench) -> Outcome:
    rng = np.random.default_rng(3)
    sphere, triangles = icosphere(3)
    mesh = Mesh("tiny sphere", (6e-19 * sphere).astype(np.float32), triangles)
    count = 2000
    origin = (6e-19 * 0.8 * directions(rng, count) * rng.uniform(0, 1, (count, 1))).astype(np.float32)
    direction = directions(rng, count)
    aimed = mesh.positions[rng.integers(len(sphere), size=count)].astype(np.float64) - origin
    direction[::2] = unit(aimed[::2] * 1e18)
    direction = direction.astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    return judge(origin, direction, hits, corners_of(mesh), must_hit=True).outcome(roundings(bench))


@case(
    "triangles of 1e-19 m from 1 m away",
    FAMILY,
    "A square of 8,192 triangles with steps of 2^-63 m; rays straight down at its corners, edges and insides, from 1 "
    "m above. Whole numbers show which triangles hold the point that a ray hits.",
    "Differences and shears are exact here, so the triangle must be one of those that hold the point; the distance is "
    "right but for 14 u (margin.py; 20 u on CUDA). Measured in u, plus 1e6 for each wrong triangle.",
)
def tiny_from_afar(bench: Bench) -> Outcome:
    rng = np.random.default_rng(4)
    cells, step = 64, 2.0**-63
    mesh = grid(cells, step)
    position = rng.integers(0, 4 * cells + 1, (1000, 2))  # positions in quarters of a step
    origin = np.concatenate([position * (step / 4), np.ones((1000, 1))], 1).astype(np.float32)
    direction = np.broadcast_to(np.float32([0, 0, -1]), origin.shape)
    hits = bench.trace(placed(mesh), origin, direction)
    corner = np.rint(corners_of(mesh)[hits.primitive, :, :2] * (4 / step)).astype(np.int64) - position[:, None]
    sides = np.stack(
        [corner[:, i, 0] * corner[:, j, 1] - corner[:, i, 1] * corner[:, j, 0] for i, j in ((0, 1), (1, 2), (2, 0))]
    )
    wrong = ~hits.hit | ~((sides >= 0).all(0) | (sides <= 0).all(0))
    error = np.abs(hits.t[~wrong].astype(np.float64) - 1).max(initial=0) / U
    note = f"{int(wrong.sum())} of 1,000 triangles are wrong"
    return Outcome(error + WRONG * int(wrong.sum()), 0.0, along_roundings(bench), note)


@case(
    "corners used twice",
    FAMILY,
    "A sphere, and 2,000 triangles without area more, in each of which a corner is used twice or three times. Hits "
    "are those of the sphere alone, to the bit.",
    "Two corners that are the same stay the same in the test, so the edge functions add up to exactly 0, which is no "
    "hit: nothing may differ.",
    quick=True,
)
def repeated_corners(bench: Bench) -> Outcome:
    rng = np.random.default_rng(5)
    positions, triangles = icosphere(3)
    extra = rng.integers(len(positions), size=(2000, 3)).astype(np.int32)
    for part, (i, j) in enumerate(((0, 1), (1, 2), (2, 0), (0, 1))):
        extra[part::4, j] = extra[part::4, i]
    extra[3::4] = extra[3::4, :1]
    alone = Mesh("sphere", positions.astype(np.float32), triangles)
    count = 20_000
    origin = rng.uniform(-1.5, 1.5, (count, 3)).astype(np.float32)
    ends = positions[extra[rng.integers(2000, size=count)]]
    direction = directions(rng, count)
    direction[::2] = ends[::2, 0] - origin[::2]
    # along triangles that are lines
    line = (ends[:, 2] - ends[:, 0] + ends[:, 1] - ends[:, 0])[::5]
    direction[::5] = np.where(np.abs(line).max(1, keepdims=True) > 0, line, direction[::5])
    origin[::5] = (ends[::5, 0] - 2 * line).astype(np.float32)
    direction = direction.astype(np.float32)
    more = Mesh("sphere and lines", alone.positions, np.concatenate([triangles, extra]))
    one, both = (bench.trace(placed(mesh), origin, direction) for mesh in (alone, more))
    differs = (
        (one.hit != both.hit)
        | (one.t != both.t)
        | (one.hit & ((one.primitive != both.primitive) | (one.uv != both.uv).any(1)))
    )
    return Outcome(float(differs.sum()), 0.0, 0.0, f"of {count:,} rays, {int(one.hit.sum()):,} of which hit")


@case(
    "corners on a line",
    FAMILY,
    "A sphere, and 1,000 triangles whose corners, but for rounding, lie on a line. All triangles are tested in "
    "float64.",
    IN_ROUNDINGS,
)
def collinear(bench: Bench) -> Outcome:
    rng = np.random.default_rng(6)
    positions, triangles = icosphere(2)
    a, e = rng.uniform(-1.5, 1.5, (1000, 1, 3)), rng.normal(size=(1000, 1, 3))
    lines = a + e * rng.uniform(-1, 1, (1000, 3, 1))
    mesh = mesh_of(np.concatenate([positions[triangles], lines]))
    count = 4000
    some = lines[rng.integers(1000, size=count)]
    origin = (rng.uniform(-2, 2, (count, 3))).astype(np.float32)
    direction = some[:, 0] + rng.uniform(0, 1, (count, 1)) * (some[:, 1] - some[:, 0]) - origin
    origin[::4] = (some[::4, 0] + 3 * (some[::4, 0] - some[::4, 1])).astype(np.float32)
    direction[::4] = some[::4, 1] - some[::4, 0]  # along them
    direction = unit(direction).astype(np.float32)
    hits = bench.trace(placed(mesh), origin, direction)
    return judge(origin, direction, hits, corners_of(mesh)).outcome(roundings(bench))
