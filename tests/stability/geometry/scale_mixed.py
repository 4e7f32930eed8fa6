"""Small things on, in and before large ones."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np

from raybatch_addon.core.scene.description import CameraKind, Frame, Mesh, Scene
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Skipped, Sweep, case
from tests.stability.geometry.scale import U, mean_of_seeds
from tests.stability.lights.form_factors import sphere_form_factor
from tests.support import scenes


def graded_plane(half: float, least: float) -> Mesh:
    """A square in z = 0 whose cells grow from the middle, where they are `least` wide, to the rim at `half` [m]."""
    steps = least * 2.0 ** np.arange(math.ceil(math.log2(half / least)))
    axis = np.concatenate([-steps[::-1], [0.0], steps, [half]])
    axis = np.concatenate([[-half], axis]) if axis[0] > -half else axis
    axis = np.unique(axis)
    n = len(axis)
    positions = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((n, n))], -1).reshape(-1, 3)
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + n, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + 1], 1)]
    )
    return Mesh("graded plane", positions.astype(np.float32), triangles.astype(np.int32))


def _shaded_floor(floor: Mesh, radius: float) -> Scene:
    """A white floor below a black ball, two radii above it, in a white world.

    It is seen closely, two radii aside of the point below the ball.
    """
    ball = scenes.sphere("ball", 96, 48, smooth=False)
    aim = np.array([2 * radius, 0, 0])
    view = scenes.camera(eye=(2 * radius, -1.5 * radius, 1.5 * radius), target=aim, half_width=2**-10)
    black = scenes.material(name="black")
    return scenes.scene(
        [(floor, scenes.IDENTITY, scenes.diffuse(1.0)), (ball, scenes.translation(0, 0, 2 * radius, radius), black)],
        view=view,
        frame=Frame(8, 8),
        world=1.0,
    )


# A ball of 96 x 48 flat quads is inside the sphere: its silhouette is smaller by the mean of both directions, in
# radius
FACETS = (math.pi / 96) ** 2 / 2 + (math.pi / 96) ** 2 / 2


def _shade(bench: Bench, floor: Mesh, radius: float, lift: float, note: str) -> Outcome:
    blocked = sphere_form_factor(radius, 2 * radius, 2 * radius)
    mean, error = mean_of_seeds(bench, _shaded_floor(floor, radius), sample_count=1024, bounce_max=1)
    return Outcome(mean, 1 - blocked, error + blocked * (2 * FACETS + 3 * lift / radius), note)


@case(
    "a 1 mm ball over a plane of 1e7 m",
    "scale",
    """A black ball of 1 mm over a white plane of 1e7 m whose cells grow from 0.1 mm in the middle: the radiance of the
    plane beside the ball in a white world, against 1 minus the ball's form factor.""",
    """5 standard errors (Student); the ball's facets (2 pi^2 / 96^2 of the form factor); the point is moved off the
    plane by 25 x 2^-24 of its triangle, which is no larger than the ball""",
)
def small_over_large(bench: Bench) -> Outcome:
    return _shade(bench, graded_plane(5e6, 1e-4), 0.5e-3, 32 * U * 1e-3, "")


@case(
    "a teapot in a stadium",
    "scale",
    """A black ball of 20 cm over the floor of a stadium of 200 m that is one square: the radiance of the floor beside
    the ball in a white world, against 1 minus the ball's form factor.""",
    """5 standard errors (Student); the ball's facets (2 pi^2 / 96^2 of the form factor); the point is moved off the
    floor by the error of a test of its triangle, 25 x 2^-24 times 200 m, and a rounding, of a ball of 0.1 m radius: 3
    times that ratio of the form factor""",
)
def teapot_in_a_stadium(bench: Bench) -> Outcome:
    return _shade(bench, scenes.plane("stadium", 200.0), 0.1, 26 * U * 200, "")


@case(
    "a thing on a square of 1e7 m",
    "scale",
    """A white ball of 1 mm, 2 mm above a white plane of 1e7 m that is one square, in a white world, from straight
    above: every pixel is 1, and the ball covers its share of the frame (its depth differs from the plane's).""",
    """share of the frame: pi r^2 / w^2 as the ball is seen by an orthographic camera, less its facets; 5 standard
    errors of a binomial share. No pixel's radiance may differ from 1 by more than 4 roundings a bounce""",
)
def thing_on_a_square(bench: Bench) -> Outcome:
    radius, half = 0.5e-3, 1e-3
    ball = (scenes.sphere("ball", 96, 48), scenes.translation(0, 0, 2e-3, radius), scenes.diffuse(1.0))
    view = scenes.camera(eye=(0, 0, 5e-3), target=(0, 0, 0), half_width=half, up=(0, 1, 0))
    view = dataclasses.replace(view, kind=CameraKind.ORTHOGRAPHIC)
    scene = scenes.scene(
        [(scenes.plane("plane", 1e7), scenes.IDENTITY, scenes.diffuse(1.0)), ball],
        view=view,
        world=1.0,
        frame=Frame(48, 48),
    )
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=("Combined", "Depth")))
    film = bench.film(scene, nee="OFF", bounce_max=32, roulette_bounce=32, pixel_filter="BOX")
    off = np.abs(film.passes["Combined"][..., :3].astype(np.float64) - 1).max()
    depth, pixels = film.passes["Depth"][..., 0].astype(np.float64), 48 * 48
    covered, expected = (depth < 4e-3).mean(), math.pi * radius**2 / (2 * half) ** 2
    if off > 4 * 32 * U:
        return Outcome(1 + off, 1, 4 * 32 * U, "radiance")
    if not np.allclose(depth[depth >= 4e-3], 5e-3, rtol=16 * U, atol=0):
        return Outcome(float(np.abs(depth[depth >= 4e-3] - 5e-3).max()), 0, 16 * U * 5e-3, "depth of the plane")
    return Outcome(
        covered,
        expected,
        5 * math.sqrt(expected * (1 - expected) / pixels) + 2 * FACETS * expected,
        "share of the frame",
    )


@case(
    "through a telescope",
    "scale",
    """Glowing squares 1e2 to 1e8 m away that fill a quarter of a narrow frame, 16,384 times smaller than their
    distance: the mean of the picture is a quarter.""",
    """5 standard errors (Student) of points inside a square by stratified samples; a direction of float32 is known to
    2^-24, and so is an edge: 4 x 2^-24 x 16,384 of the share""",
)
def telescope(bench: Bench) -> Outcome:
    sweep = Sweep()
    for far in (1e2, 1e4, 1e6, 1e8):
        square = (scenes.plane("square", far / 16384), scenes.IDENTITY, scenes.emitter(1.0))
        view = scenes.camera(eye=(0, 0, far), target=(0, 0, 0), half_width=1 / 16384, up=(0, 1, 0))
        scene = scenes.scene([square], view=view, frame=Frame(16, 16))
        mean, error = mean_of_seeds(bench, scene, pixel_filter="BOX", bounce_max=0)
        sweep.add(mean, 0.25, error + 0.25 * 16 * U * 16384, f"{far:g} m")
    return sweep.outcome()


def _scene_file(name: str) -> Path:
    """A file of the folder RAYBATCH_SCENES; raises `Skipped` without it."""
    folder = os.environ.get("RAYBATCH_SCENES")
    if not folder or not (Path(folder) / name).is_file():
        raise Skipped(f"set RAYBATCH_SCENES to a folder that holds {name}")
    return Path(folder) / name


@case(
    "hotel room",
    "scale",
    """The room of hotel_room.npz as it is, with coordinates near 10,000, from a point inside it and in a white world,
    against the same room moved to the origin by whole steps of float32, which is exact: share of rays from that point
    whose distance differs by more than the bound.""",
    "corners relative to the ray's origin are exact in both: distances are those of the same numbers, and none may "
    "differ",
)
def hotel_room(bench: Bench) -> Outcome:
    with np.load(_scene_file("hotel_room.npz")) as arrays:
        positions, triangles = arrays["v"].astype(np.float32), arrays["f"].astype(np.int32)
    low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
    step = np.spacing(np.float32(np.abs([low, high]).max()))
    centre = np.round((low + high) / 2 / step) * step
    generator = np.random.default_rng(3)
    directions = generator.normal(size=(50_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here = Mesh("room", positions, triangles)
    there = Mesh("room at the origin", (positions.astype(np.float64) - centre).astype(np.float32), triangles)
    found = [
        bench.trace(
            scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse(0.5))], world=1.0),
            np.broadcast_to(origin, directions.shape),
            directions,
        )
        for mesh, origin in ((here, centre), (there, centre - centre))
    ]
    differs = (found[0].t != found[1].t) | (found[0].primitive != found[1].primitive)
    return Outcome(float(differs.sum()), 0, 0, f"rays, of {found[0].hit.sum():,} that hit")
