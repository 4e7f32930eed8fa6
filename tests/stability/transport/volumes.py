"""Volumes: of every optical depth, in one another, very large, almost empty, and that scatter nearly straight on."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.scene.description import Frame, Scene, Volume
from tests.renders.volumes.test_volumes import filled, medium
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import U
from tests.stability.volume_scenes import boxed, in_grid, in_tiles
from tests.support import scenes

FAMILY = "transport"
# A ray begins up to 25 roundings of the longest edge beyond a face, and its length is so much shorter; that and the
# exponential are multiplied by the depth
ROUNDINGS = 64 * U
LONG = {"bounce_max": 10_000, "roulette_bounce": 10_000}


def by_height(name: str, coefficient: float, half: float = 1.0) -> Volume:
    """A program in a cube of half edge `half`: `coefficient` times 0.75 (z / half + 1)^2, whose mean is 1."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    raised = builder.value("math", 0, False, builder.value("math", 2, False, height, 1 / half, 0.0), 1.0, 0.0)
    factor = builder.value("math", 2, False, builder.value("math", 2, False, raised, raised, 0.0), 0.75, 0.0)
    weight = builder.value("multiply_colors", Value.of((coefficient,) * 3), builder.value("splat", factor))
    builder.closure(name, weight, *((0.0,) if name == "volume_henyey_greenstein" else ()))
    return Volume(program=builder.finish())


def add_mean(sweep: Sweep, bench: Bench, scene: Scene, expected: float, rounding: float, note: str, **settings) -> None:
    """Compare the mean of pictures of several seeds with `expected`."""
    settings = dict(sample_count=16, sample_sequence="SOBOL") | settings
    means = bench.render_seeds(scene, 8, **settings).mean((1, 2, 3))
    error = means.std(ddof=1) / math.sqrt(len(means))
    # Student's t of 7 degrees of freedom exceeds 10 as seldom as a normal value 4.2
    sweep.add(means.mean(), expected, 10 * error + rounding * expected + 1e-30, note)


@case(
    "volumes of optical depth 1e-6 to 1e6",
    FAMILY,
    "A cube that absorbs, from hardly any light to all of it: Beer's law, for a constant and for a program. The same "
    "cube that scatters alone, in a white world: it is not seen where it is thin, and gives back no more than it gets "
    "where it is thick.",
    "Constants: 64 roundings of the result, and of it times the depth: rays begin up to 25 roundings of the longest "
    "edge beyond a face. Programs and scattering: ten standard errors of eight pictures, and 64 roundings. Where "
    "nothing comes through the smallest number of float32.",
    traces=False,
    quick=True,
)
def depths(bench: Bench) -> Outcome:
    sweep = Sweep()
    for depth in (1e-6, 1e-3, 1.0, 10.0, 1e3, 1e6):
        expected = math.exp(-depth)
        picture = bench.render(boxed(medium(depth / 2)), sample_count=1, sample_sequence="SOBOL")
        tolerance = ROUNDINGS * (1 + depth) * expected + 1e-38
        sweep.add(float(picture[0, 0, 0]), expected, tolerance, f"constant of depth {depth:g}")
    for depth in (1e-6, 1.0, 1e6):
        volume = by_height("volume_absorption", depth / 2)
        add_mean(sweep, bench, boxed(volume), math.exp(-depth), 64 * U, f"program of depth {depth:g}")
    for depth in (1e-6, 1.0):
        add_mean(sweep, bench, boxed(medium(scattering=depth / 2)), 1.0, 64 * U, f"white, depth {depth:g}", **LONG)
    for depth in (1e3, 1e6):
        picture = bench.render(boxed(medium(scattering=depth / 2)), bounce_max=16, sample_sequence="SOBOL")
        over = max(float(picture.max()) - 1.0, -float(picture.min()), 0.0)
        sweep.add(over, 0.0, 64 * U, f"white, depth {depth:g}: how much more than there is comes back")
    return sweep.outcome()


@case(
    "a camera within four volumes",
    FAMILY,
    "Cubes in one another that absorb, with the camera in all of them, at four places and in four directions: every "
    "one of them dims by its own way to its face.",
    "All is constant: 64 roundings of the result.",
    traces=False,
    quick=True,
)
def nested(bench: Bench) -> Outcome:
    sweep = Sweep()
    halves, densities = (1.0, 0.75, 0.5, 0.25), (0.1, 0.2, 0.4, 0.8)
    boxes = [
        (scenes.box(f"{half}", 2 * half), scenes.IDENTITY, filled(medium(density)))
        for half, density in zip(halves, densities)
    ]
    for axis in range(3):
        for sign in (-1.0, 1.0):
            for eye in (0.0, 0.2):
                to = np.zeros(3)
                to[axis] = sign
                up = (0, 0, 1) if axis != 2 else (0, 1, 0)
                view = scenes.camera(eye=eye * to, target=9 * to, up=up, half_width=1e-6)
                scene = scenes.scene(boxes, world=1.0, view=view, frame=Frame(8, 8))
                picture = bench.render(scene, sample_count=1, sample_sequence="SOBOL")
                expected = math.exp(-sum(density * (half - eye) for half, density in zip(halves, densities)))
                sweep.add(float(picture[0, 0, 0]), expected, 64 * U * expected, f"axis {axis}, {sign:g}, {eye:g} m off")
    return sweep.outcome()


@case(
    "a volume of 1e6 m and density 1e-6",
    FAMILY,
    "A cube of 1e6 m that absorbs 1e-6 of the light in a metre: Beer's law, seen from outside and from its middle, for "
    "a constant and for a program; and one that scatters as much, in a white world, which is not seen.",
    "Constants: 64 roundings. Others: ten standard errors of eight pictures, and 64 roundings.",
    traces=False,
    quick=True,
)
def large(bench: Bench) -> Outcome:
    sweep = Sweep()
    half, density = 5e5, 1e-6
    for eye, length in (((0, 0, -2e6), 2 * half), ((0, 0, 0), half)):
        scene = boxed(medium(density), 2 * half, eye, (0, 0, 1e7))
        picture = bench.render(scene, sample_count=1, sample_sequence="SOBOL")
        expected = math.exp(-density * length)
        sweep.add(float(picture[0, 0, 0]), expected, 64 * U * expected, f"constant, from {eye[2]:g} m")
    volume = by_height("volume_absorption", density, half)
    add_mean(sweep, bench, boxed(volume, 2 * half, (0, 0, -2e6)), math.exp(-1.0), 64 * U, "program")
    scene = boxed(medium(scattering=density), 2 * half, (0, 0, -2e6))
    add_mean(sweep, bench, scene, 1.0, 64 * U, "white", **LONG)
    return sweep.outcome()


@case(
    "anisotropy of 0.999",
    FAMILY,
    "A cube of depth 4 that scatters alone, with a mean cosine of 0.999 and of -0.999: in a white world it is not "
    "seen. One of g and -g in equal parts too.",
    "Ten standard errors of eight pictures, and 64 roundings.",
    traces=False,
    quick=True,
)
def straight(bench: Bench) -> Outcome:
    sweep = Sweep()
    for g in (0.999, -0.999):
        add_mean(sweep, bench, boxed(medium(scattering=2.0, g=g)), 1.0, 64 * U, f"g = {g:g}", **LONG)
    first, second = (medium(scattering=1.0, g=g).closures[0] for g in (0.999, -0.999))
    add_mean(sweep, bench, boxed(Volume((first, second))), 1.0, 64 * U, "both together", **LONG)
    return sweep.outcome()


@case(
    "a sparse grid",
    FAMILY,
    "Grids of 160 and 320 voxels along each axis, all empty but for two cubes of 12 voxels, and one of 2, in the way "
    "of a ray: the integral of linear interpolation along it is known.",
    "Ten standard errors of eight pictures, and 64 roundings.",
    traces=False,
)
def sparse(bench: Bench) -> Outcome:
    sweep = Sweep()
    for count, parts in ((160, ((20, 12, 4.0), (120, 12, 8.0))), (320, ((100, 2, 100.0),))):
        scene, expected = in_grid(count, parts)
        add_mean(sweep, bench, scene, expected, 64 * U, f"{count}^3 voxels", sample_count=256)
    return sweep.outcome()


@case(
    "a sparse grid of 7e10 voxels",
    FAMILY,
    "A grid of 4,096 voxels along each axis, of which 60,000 tiles of 8 x 8 x 8 hold anything, some of them in the way "
    "of a ray: the integral of linear interpolation along it is known. A block of all would take 256 GiB.",
    "Ten standard errors of eight pictures, and 64 roundings.",
    traces=False,
)
def very_sparse(bench: Bench) -> Outcome:
    sweep = Sweep()
    scene, expected = in_tiles(4096, ((256, 64, 10.0), (3072, 8, 40.0)), 60_000)
    add_mean(sweep, bench, scene, expected, 64 * U, "4,096^3 voxels", sample_count=256)
    return sweep.outcome()
