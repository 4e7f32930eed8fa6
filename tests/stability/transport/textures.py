"""Textures: noise where floats are coarse, coordinates that are not finite."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.textures.noise import FractalKind
from raybatch_addon.core.programs.ops.textures.perlin import PERIOD, SHIFTED_FROM
from raybatch_addon.core.programs.ops.values.vector_math import VectorOperation
from raybatch_addon.core.scene.description import ClosureKind, Frame, Material, Scene
from tests.core.programs.op_probe import run_op
from tests.stability.bench import SETTINGS, Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.uniform import SIGMAS, UNIT_ROUNDOFF, mean_and_error
from tests.support import scenes
from tests.twins.noise_reference import SCALES, signed_noise

DIMENSIONS = (1, 2, 3, 4)
REACHES = (1.0, 1e3, 9e4, 3e5, 9e5, 1e7, 1e8)
POINTS = 40
# Largest contribution of a lattice point at a distance of less than 1 along every axis, by dimensions
SLOPES = (8.0, 3.0, 2.0, 3.0)
AWKWARD = (0.0, -0.0, 1e-40, 1e7, -1e7, 1e12, 1e30, -1e38, 3.4e38, math.inf, -math.inf, math.nan)
# immediates, and operands: v coordinates, c colours, n numbers
TEXTURES = {
    "noise_1d": ([FractalKind.FBM, 1], "nnnnnnnn"),
    "noise_2d": ([FractalKind.MULTIFRACTAL, 1], "vnnnnnnn"),
    "noise_3d": ([FractalKind.HYBRID_MULTIFRACTAL, 1], "vnnnnnnn"),
    "noise_4d": ([FractalKind.HETERO_TERRAIN, 1], "vnnnnnnnn"),
    "white_noise": ([4], "vn"),
    "wave": ([7, 1], "vnnnnnn"),
    "magic": ([10], "vnn"),
    "gradient": ([4], "v"),
    "checker": ([], "vccn"),
    "brick": ([2, 3], "vcccnnnnnnnn"),
}
SAMPLES = 256


def _within(x: float) -> float:
    """A coordinate within the noise's period: the exact remainder, and half a cell where only whole numbers remain."""
    return math.fmod(x, PERIOD) + (0.5 if abs(x) >= SHIFTED_FROM else 0.0)


def _operands(dimensions: int, points: np.ndarray) -> list:
    coordinates = {1: [points[:, 0]], 2: [points[:, :3]], 3: [points[:, :3]], 4: [points[:, :3], points[:, 3]]}[
        dimensions
    ]
    return [*coordinates, 1.0, 0.0, 0.5, 2.0, 0.0, 1.0, 0.0]


@case(
    "noise, near and far",
    "textures",
    """Gradient noise in 1 to 4 dimensions at random float32 coordinates up to 1, 1e3, ... 1e8 against the same in
    float64 over exact remainders.""",
    """Fractions of float32 coordinates are exact, or have the error u. d interpolations of values up to G: each adds 2
    G times the error of the quintic step (10 u) and 3 roundings of 2 G, and what lattice points give has 2 roundings:
    (26 d + 2) G u times the noise's scale""",
    traces=False,
    quick=True,
)
def noise_near_and_far(bench: Bench) -> Outcome:
    rng = np.random.default_rng(1)
    sweep = Sweep()
    for dimensions in DIMENSIONS:
        bound = (26 * dimensions + 2) * SLOPES[dimensions - 1] * SCALES[dimensions - 1] * UNIT_ROUNDOFF
        for reach in REACHES:
            points = rng.uniform(-reach, reach, (POINTS, 4)).astype(np.float32)
            found, _ = run_op(
                f"noise_{dimensions}d", [FractalKind.FBM, 0], _operands(dimensions, points), device=bench.wp_device
            )
            for point, value in zip(points, found):
                expected = signed_noise([_within(float(x)) for x in point[:dimensions]])
                sweep.add(value, expected, bound, f"{dimensions} dimensions, up to {reach:g}")
    return sweep.outcome()


@case(
    "textures of what is no number",
    "textures",
    """Every procedural texture at coordinates, and with numbers, of which many are NaN, infinite, denormal or near the
    end of float32: values that are not finite.""",
    "Any operand is allowed, and every result is finite: none may be otherwise",
    traces=False,
)
def textures_of_no_number(bench: Bench) -> Outcome:
    rng = np.random.default_rng(2)
    count = 2000
    bad = 0
    for name, (immediates, letters) in TEXTURES.items():
        for wild in (False, True):
            shapes = {"v": (count, 3), "c": (1,), "n": (count,) if wild or name == "noise_1d" else (1,)}
            operands = [0.5 if shapes[letter] == (1,) else rng.choice(AWKWARD, shapes[letter]) for letter in letters]
            bad += sum(
                int((~np.isfinite(found)).sum()) for found in run_op(name, immediates, operands, device=bench.wp_device)
            )
    return Outcome(bad, 0, 0)


def _textured(builder: ProgramBuilder, coordinates: Value) -> Scene:
    """A plane that emits normalised noise at `coordinates`, seen from above."""
    _, color = builder.value("noise_3d", FractalKind.FBM, 1, coordinates, 1.0, 0.0, 0.5, 2.0, 0.0, 1.0, 0.0)
    builder.closure("emission", color)
    material = Material("noise", (), (ClosureKind.EMISSION,), program=builder.finish())
    view = scenes.camera(eye=(0, -1e-3, 8), target=(0, 0, 0), half_width=0.5)
    return scenes.scene([(scenes.plane("plane", 16.0), scenes.IDENTITY, material)], view=view, frame=Frame(16, 16))


@case(
    "coordinates that are NaN",
    "textures",
    """A plane emits noise at coordinates of which a program makes NaN (infinity minus infinity). They are taken as 0,
    where normalised noise is 1/2.""",
    "noise on the lattice is exactly 0, and sums of samples are exact: no bit may differ",
)
def coordinates_that_are_nan(bench: Bench) -> Outcome:
    builder = ProgramBuilder()
    zero = (0.0, 0.0, 0.0)
    coordinates = builder.value("object_coordinates", 0)
    huge, _ = builder.value("vector_math", VectorOperation.MULTIPLY_ADD, coordinates, zero, (3e38, 3e38, 3e38), 0.0)
    endless, _ = builder.value("vector_math", VectorOperation.ADD, huge, huge, zero, 0.0)
    nothing, _ = builder.value("vector_math", VectorOperation.SUBTRACT, endless, endless, zero, 0.0)
    picture = bench.film(_textured(builder, nothing), SETTINGS, sample_count=4, nee="OFF").passes["Combined"][..., :3]
    return Outcome(float(picture.ravel()[np.abs(picture.ravel() - 0.5).argmax()]), 0.5, 0.0)


@case(
    "a picture of noise 1e7 away",
    "textures",
    """A plane emits noise at its coordinates plus 1e7, where float32 holds whole numbers only: pixels against means of
    the same op over a grid of 16 x 16 points in each.""",
    """Six standard errors of the mean difference, measured over pixels, which are independent; and the grid's own
    error: edges of cells are edges of pixels, and across them the midpoint rule at distance h errs by h^2 / 24 of the
    second derivative, at most 30""",
    traces=False,
)
def picture_of_noise_far_away(bench: Bench) -> Outcome:
    far = np.float32(1e7)
    builder = ProgramBuilder()
    there = (float(far), 0.0, 0.0)
    coordinates, _ = builder.value(
        "vector_math", VectorOperation.ADD, builder.value("object_coordinates", 0), there, (0.0, 0.0, 0.0), 0.0
    )
    scene = dataclasses.replace(_textured(builder, coordinates), frame=Frame(64, 64))
    picture = bench.film(scene, SETTINGS, sample_count=SAMPLES, nee="OFF", pixel_filter="BOX", filter_width=1.0).passes[
        "Combined"
    ]
    step = 8 / 1024
    steps = (np.arange(1024) + 0.5) * step - 4
    x, y = np.meshgrid(steps.astype(np.float32) + far, steps)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    grid = run_op(
        "noise_3d", [FractalKind.FBM, 1], [points, 1.0, 0.0, 0.5, 2.0, 0.0, 1.0, 0.0], skip="V", device=bench.wp_device
    )[0]
    expected = grid.reshape(64, 16, 64, 16).mean((1, 3))
    difference, error = mean_and_error(picture[..., :3] - expected[..., None])
    return Outcome(difference, 0.0, SIGMAS * error + 30 * step**2 / 24)
