"""Transport: what light keeps over thousands of bounces, with and without roulette, between mirrors and through keyholes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import scenes

from raybatch_addon.core.scene.description import Camera, CameraKind, Closure, ClosureKind, Frame, Light, LightKind, Material, Mesh, Scene

from .bench import Bench
from .case import Outcome, Sweep, case
from .enclosures import (
    FEW, KINDS, MANY, SCATTERED, add_exact, add_relative, facing_down, glass, icosphere_mesh, joined, lamp, mirror, stretched, turned_askew,
    view_along, wall, wall_with_hole,
)  # fmt: skip
from .form_factors import square_form_factor
from .uniform import SIGMAS, UNIT_ROUNDOFF, add_mean, mean_and_error

U = UNIT_ROUNDOFF
SPACING = 8.0  # of closed meshes beside each other [m]
EXACT = "a white path carries 1 to the bit, and sums of whole numbers below 2^24 are exact in float32: nothing may be lost or added"


def _inside(mesh, matrix, material: Material, frame=FEW, half_width: float = 0.8) -> Scene:
    """A closed mesh around the camera."""
    view = scenes.camera(eye=(0.1, -0.2, 0.05), target=(0.3, 0.8, 0.2), half_width=half_width)
    return scenes.scene([(mesh, matrix, material)], frame=frame, view=view)


def _closed_meshes(material: Material) -> Scene:
    """Three closed meshes; each of three pixels begins its paths in the middle of one, in a direction along no axis."""
    ahead = np.array([0.3, 0.8, 0.2])
    view = scenes.look_at((0, 0, 0), ahead)
    meshes = ((scenes.box("box"), scenes.IDENTITY), (icosphere_mesh(1), scenes.IDENTITY), (scenes.box("askew"), turned_askew()))
    objects = []
    for place, (mesh, matrix) in enumerate(meshes):
        matrix = matrix.copy()
        matrix[:, 3] += SPACING * (place - 1) * view[:, 0]
        objects.append((mesh, matrix, material))
    half = 1.5 * SPACING
    camera = Camera(CameraKind.ORTHOGRAPHIC, view, (-half, half, -SPACING / 2, SPACING / 2))
    return scenes.scene(objects, frame=Frame(3, 1), view=camera)


def _add_trapped(sweep: Sweep, bench: Bench, material: Material) -> None:
    picture = bench.render(_closed_meshes(material), SCATTERED, pixel_filter="GAUSSIAN", filter_width=0.05)
    for place, name in enumerate(("box", "icosphere", "sheared and mirrored box")):
        add_exact(sweep, picture[:, place], SCATTERED.bounce_max + 2, name)


@case(
    "white boxes", "transport",
    """Paths of 10,000 bounces inside a box, an icosphere and a sheared, mirrored box, all closed and white, that emit 1: each surface met
    adds 1, 10,002 in all, with roulette from the first bounce. A ray that escapes is missing from then on.""",
    EXACT,
)  # fmt: skip
def white_boxes(bench: Bench) -> Outcome:
    sweep = Sweep()
    _add_trapped(sweep, bench, wall(1.0, 1.0))
    return sweep.outcome()


@case(
    "mirror boxes", "transport",
    "As white boxes, but perfect mirrors: 10,000 reflections, 10,002 surfaces met.",
    EXACT,
)  # fmt: skip
def mirror_boxes(bench: Bench) -> Outcome:
    sweep = Sweep()
    _add_trapped(sweep, bench, mirror(1.0, 1.0))
    return sweep.outcome()


def _cavity(lamp_size: float) -> Scene:
    """A closed white room with white, mirroring and glass things in it; only the lamp absorbs."""
    ball = icosphere_mesh(2)
    return scenes.scene(
        [
            (scenes.box("room", 4), scenes.IDENTITY, wall()),
            (dataclasses.replace(ball, name="white"), stretched(0.5, 0.5, 0.5, (1.0, 1.0, -1.2)), wall()),
            (dataclasses.replace(ball, name="mirror"), stretched(0.6, 0.6, 0.6, (-1.0, 0.8, -0.5)), mirror()),
            (dataclasses.replace(ball, name="glass"), stretched(0.5, 0.5, 0.5, (0.1, 1.0, 0.4)), glass(1.5)),
            (scenes.plane("lamp", lamp_size), facing_down(1.5), lamp(0.75)),
        ],
        frame=MANY, view=scenes.camera(eye=(0.0, -1.8, 0.0), target=(0, 1, 0), half_width=0.7),
    )  # fmt: skip


@case(
    "cavity", "transport",
    """A closed white room with a white, a mirroring and a glass ball, and a lamp that absorbs: every path ends at the lamp, so every pixel
    shows the lamp's radiance of 0.75 (a cavity in equilibrium).""",
    "a path carries 1 to the bit until it meets the lamp, which it does with a probability of more than 1 % at a bounce: "
    "none is left after 10,000 (probability below e^-100)",
)  # fmt: skip
def cavity(bench: Bench) -> Outcome:
    sweep = Sweep()
    add_exact(sweep, bench.render(_cavity(1.0), SCATTERED, sample_count=4), 0.75, "cavity")
    return sweep.outcome()


@case(
    "cavity with light sampling", "transport",
    "The same room with a larger lamp, and lights sampled directly: what both strategies find sums to the lamp's radiance of 0.75.",
    f"{SIGMAS:g} standard errors over 256 pixels, which are independent, and 400 roundings of a path",
)  # fmt: skip
def cavity_with_light_sampling(bench: Bench) -> Outcome:
    sweep = Sweep()
    add_mean(sweep, bench.render(_cavity(3.0), SCATTERED, nee="ON", sample_count=128), 0.75, 400 * U)
    return sweep.outcome()


def _series(albedo, surfaces: float) -> np.ndarray:
    """Sum of albedo^k for k below `surfaces`, of the float32 albedo."""
    a = np.float64(np.float32(albedo))
    return (1 - a**surfaces) / (1 - a)


@case(
    "bounce limits", "transport",
    "Inside a closed box that emits 1 and reflects 0.5, 0.9 or 0.999, paths of 0 to 1000 bounces: (1 - a^(N + 2)) / (1 - a).",
    """what is carried at surface k was rounded 2 k times, and each sum once: 3 U of the sum at most for both, at every one of the n surfaces at
    which a^k is above U. The others add less than half a step of the sum, and are U of it together: 3 (n + 1) U""",
)  # fmt: skip
def bounce_limits(bench: Bench) -> Outcome:
    sweep = Sweep()
    for albedo, bounces in ((0.5, 0), (0.5, 1), (0.9, 7), (0.9, 100), (0.999, 1000)):
        scene = _inside(scenes.box(), scenes.IDENTITY, wall(albedo, 1.0))
        picture = bench.render(scene, SCATTERED, bounce_max=bounces, roulette_bounce=bounces + 1)
        expected = float(_series(albedo, bounces + 2))
        # later products are smaller: the sum ends where a^k is below U
        terms = min(bounces + 2, math.log(U) / math.log(albedo))
        add_relative(sweep, picture, expected, 3 * (terms + 1) * U, f"albedo {albedo}, {bounces} bounces")
    return sweep.outcome()


COLOUR = (0.95, 0.6, 0.2)


def _add_channels(sweep: Sweep, picture: np.ndarray, expected, note: str) -> None:
    """Means of the three channels."""
    for c in range(3):
        add_mean(sweep, picture[..., c : c + 1], expected[c], 200 * U, f"{note}, channel {c}")


@case(
    "roulette", "transport",
    """Inside a closed box that emits 1 and reflects (0.95, 0.6, 0.2): with roulette from bounce 0, 1, 3 or 20, and paths as long as it lets
    them be, radiance is 1 / (1 - a) in each channel.""",
    f"{SIGMAS:g} standard errors over pixels; 200 roundings; a path is longer than 10,000 bounces with a probability below 0.95^10000",
    quick=True,
)  # fmt: skip
def roulette(bench: Bench) -> Outcome:
    sweep = Sweep()
    expected = 1 / (1 - np.float64(np.float32(COLOUR)))
    scene = _inside(scenes.box(), scenes.IDENTITY, wall(COLOUR, 1.0), MANY)
    for first in (0, 1, 3, 20):
        _add_channels(sweep, bench.render(scene, SCATTERED, roulette_bounce=first, sample_count=128), expected, f"from bounce {first}")
    return sweep.outcome()


@case(
    "roulette of long paths", "transport",
    """Inside a closed box that emits 1 and reflects 0.995, one path a pixel: roulette alone ends paths, after 200 bounces on average. Paths carry
    1 until they end, so that a pixel's value is its path's length, which is geometric: a share a^k of them is longer than k.""",
    f"""{SIGMAS:g} standard errors: of the mean sqrt(a) / (1 - a) / sqrt(n), of a share p that is longer than k sqrt(p (1 - p) / n). The normal
    distribution is near enough, as more than 90 paths are on either side. Lengths are whole numbers, exact in float32""",
)  # fmt: skip
def roulette_of_long_paths(bench: Bench) -> Outcome:
    sweep, albedo, frame = Sweep(), float(np.float32(0.995)), Frame(96, 96)
    lengths = bench.render(_inside(scenes.box(), scenes.IDENTITY, wall(albedo, 1.0), frame), SCATTERED, bounce_max=100_000, tile_size=96)[..., 0]
    sweep.add(lengths.mean(), 1 / (1 - albedo), SIGMAS * math.sqrt(albedo) / (1 - albedo) / math.sqrt(lengths.size), "mean length")
    for k in (2, 20, 50, 138, 300, 600, 900):
        share = albedo**k
        sweep.add((lengths > k).mean(), share, SIGMAS * math.sqrt(share * (1 - share) / lengths.size), f"share longer than {k}")
    return sweep.outcome()


def _lit_room() -> Scene:
    """Coloured walls that absorb, a lamp, and nothing closed off."""
    ball = icosphere_mesh(2)
    return scenes.scene(
        [
            (scenes.box("room", 4), scenes.IDENTITY, wall((0.9, 0.7, 0.3))),
            (dataclasses.replace(ball, name="ball"), stretched(0.7, 0.7, 0.7, (0.8, 0.6, -1.2)), wall((0.2, 0.5, 0.9))),
            (dataclasses.replace(ball, name="glass"), stretched(0.5, 0.5, 0.5, (-0.8, 0.2, -0.4)), glass(1.5, (0.9, 0.95, 1.0))),
            (scenes.plane("lamp", 0.8), facing_down(1.9), lamp(6.0)),
        ],
        frame=MANY, view=scenes.camera(eye=(0.0, -1.8, 0.0), target=(0, 1, -0.4), half_width=0.7),
    )  # fmt: skip


@case(
    "roulette with light sampling", "transport",
    "A room with a lamp, coloured walls and a glass ball: the mean of the picture with roulette from bounce 0 or 2 is that without.",
    f"{SIGMAS:g} standard errors of the difference of two independent pictures, over pixels; 400 roundings",
)  # fmt: skip
def roulette_with_light_sampling(bench: Bench) -> Outcome:
    sweep = Sweep()
    settings = SCATTERED.replace(nee="ON", bounce_max=64, sample_count=128)
    plain = bench.render(_lit_room(), settings, roulette_bounce=65)
    for seed, first in ((1, 0), (2, 2)):
        other = bench.render(_lit_room(), settings, roulette_bounce=first, seed=seed)
        for c in range(3):
            # pixels differ in what they show: the difference of a pixel's two values does not
            mean, error = mean_and_error((other - plain)[..., c : c + 1])
            sweep.add(mean, 0.0, SIGMAS * error + 400 * U * plain[..., c].mean(), f"from bounce {first}, channel {c}")
    return sweep.outcome()


@case(
    "mirror corridor", "transport",
    """A ray zigzags through a corridor of two mirrors, in squares of 1 m, to a lamp at its end, by 1 to 1000 reflections: the lamp's radiance
    times the reflectance to that power.""",
    """each reflection multiplies by the reflectance and by a weight of 1, both rounded: 2 n U. The number of reflections is exact: one moves the
    ray by the offset, below 64 U m of squares of 1 m, and a reflection in an axis keeps the direction, so that after 1000 it is within
    1e-3 m of the lamp's middle, which is 0.5 m from the next""",
    quick=True,
)  # fmt: skip
def mirror_corridor(bench: Bench) -> Outcome:
    sweep = Sweep()
    for count, reflectance in ((1, 0.5), (10, 0.9), (100, 0.99), (1000, 0.999)):
        # at 45 degrees a ray from the middle is in the middle again after `count` reflections and `count` metres
        sides = [(_strip(f"side {side}", 0.5 * side, count + 2), scenes.IDENTITY, mirror(reflectance)) for side in (-1, 1)]
        scene = scenes.scene(
            [*sides, (scenes.plane("lamp", 1.0), facing_down(-float(count)), lamp(3.0))],
            frame=FEW, view=view_along((0, 0, 0), (1, 0, -1)),
        )  # fmt: skip
        picture = bench.render(scene, SCATTERED, roulette_bounce=10_001)
        expected = 3.0 * float(np.float32(reflectance)) ** count
        add_relative(sweep, picture, expected, 2 * count * U, f"{count} reflections")
    return sweep.outcome()


def _strip(name: str, x: float, length: int) -> Mesh:
    """Squares of 1 m in the plane `x`, from z = 1 down [m]: one mesh, since the offset of rays is in proportion to triangles."""
    square = np.array([[x, -0.5, 0], [x, 0.5, 0], [x, 0.5, -1], [x, -0.5, -1]])
    places = [np.column_stack([np.eye(3), (0, 0, 1 - i)]) for i in range(length)]
    return joined(name, Mesh(name, square.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)), places)


@case(
    "facing mirrors", "transport",
    "Between two facing mirrors that emit 1 and reflect 0.999, 10,000 reflections: the geometric series.",
    "as for bounce limits: sums and products of a geometric series, each rounded once",
)  # fmt: skip
def facing_mirrors(bench: Bench) -> Outcome:
    sweep, reflectance = Sweep(), 0.999
    objects = [
        (scenes.plane("left", 2.0), stretched(1, 1, 1, (0, 0, -1)), mirror(reflectance, 1.0)),
        (scenes.plane("right", 2.0), facing_down(1.0), mirror(reflectance, 1.0)),
    ]
    picture = bench.render(scenes.scene(objects, frame=FEW, view=view_along((0, 0, 0), (0, 0, -1))), SCATTERED, roulette_bounce=10_001)
    expected = float(_series(reflectance, 10_002))
    add_relative(sweep, picture, expected, 3 * (math.log(U) / math.log(reflectance) + 1) * U, "10,000 reflections")
    return sweep.outcome()


@case(
    "keyhole", "transport",
    """A floor 1 m below a black wall with a hole of 1 m to 0.1 mm, right above which is a lamp: the floor's radiance below the hole is the
    hole's form factor.""",
    f"""{SIGMAS:g} standard errors over pixels; the hole's edges are off by up to 4 U of the distance on each side, from the rounding of the
    ray's origin and direction: 16 U / a of the area. The ray starts above the floor by the offset, 26 U of its triangles' 8 m: twice that of the
    form factor, 416 U; and 40 roundings""",
    quick=True,
)  # fmt: skip
def keyhole(bench: Bench) -> Outcome:
    sweep = Sweep()
    for hole in (1.0, 0.1, 1e-2, 1e-3, 1e-4):
        scene = scenes.scene(
            [
                (scenes.plane("floor", 8.0), stretched(1, 1, 1, (0, 0, -1)), wall()),
                (wall_with_hole(8.0, hole), scenes.IDENTITY, wall(0.0)),
                (scenes.plane("lamp", 3 * hole), facing_down(hole / 4), lamp(1.0)),
            ],
            frame=MANY, view=scenes.camera(eye=(0.4, -0.3, -0.4), target=(0, 0, -1), half_width=1e-6),
        )  # fmt: skip
        picture = bench.render(scene, SCATTERED, nee="ON", bounce_max=1, sample_count=1024)
        add_mean(sweep, picture, square_form_factor(hole / 2, 1.0), 16 * U / hole + 456 * U, f"a hole of {hole:g} m")
    return sweep.outcome()


@case(
    "keyhole between white rooms", "transport",
    "Two closed white rooms joined by a hole, a lamp in the other one: every path finds it in the end, and brings its radiance of 1.",
    """as for the cavity: exact, since of white rooms a path carries 1 until it meets the lamp. The hole is 1 % of each room, the lamp more:
    fewer than e^-40 of the paths are on their way after 10,000 bounces""",
    quick=True,
)  # fmt: skip
def keyhole_between_rooms(bench: Bench) -> Outcome:
    sweep = Sweep()
    scene = scenes.scene(
        [
            (scenes.box("rooms"), stretched(1, 1, 2), wall()),
            (wall_with_hole(3.0, 0.5), scenes.IDENTITY, wall()),
            (scenes.plane("lamp", 1.6), facing_down(1.5), lamp(1.0)),
        ],
        frame=FEW, view=scenes.camera(eye=(0.0, -0.8, -1.0), target=(0, 1, -1.1), half_width=0.7),
    )  # fmt: skip
    add_exact(sweep, bench.render(scene, SCATTERED, sample_count=4), 1.0, "two rooms")
    return sweep.outcome()


@case(
    "a thousand veils", "transport",
    """1000 surfaces that let 0.999 of the light straight through: a lamp behind them seen by the camera, and the floor behind them under a
    point light above, is darker by 0.999^1000.""",
    "one product a veil, and a weight of 1, both rounded: 2000 U; and 10 roundings of shading the floor",
)  # fmt: skip
def veils(bench: Bench) -> Outcome:
    sweep, count, share = Sweep(), 1000, 0.999
    veil = Material("veil", (Closure(ClosureKind.TRANSPARENT, (share,) * 3),), (*KINDS, ClosureKind.TRANSPARENT))
    stack = joined("veils", scenes.plane("veil", 2.0), [scenes.translation(0, 0, 0.25 + 0.5 * i / count) for i in range(count)])
    passed = float(np.float32(share)) ** count
    tolerance = (2 * count + 10) * U
    above = Light("point", LightKind.POINT, scenes.translation(0, 0, 1), (math.pi,) * 3)
    settings = SCATTERED.replace(bounce_max=1, transparent_bounce_max=1024, roulette_bounce=2)

    seen = scenes.scene(
        [(stack, scenes.IDENTITY, veil), (scenes.plane("lamp", 2.0), scenes.IDENTITY, lamp(1.0))],
        frame=FEW, view=view_along((0, 0, 2), (0, 0, 0)),
    )  # fmt: skip
    add_relative(sweep, bench.render(seen, settings, nee="ON"), passed, tolerance, "seen through them")
    # the camera is below the veils, the light above
    lit = scenes.scene(
        [(stack, scenes.IDENTITY, veil), (scenes.plane("floor", 2.0), scenes.IDENTITY, wall())],
        frame=FEW, view=view_along((0.05, 0, 0.1), (0, 0, 0)), lights=[above],
    )  # fmt: skip
    add_relative(sweep, bench.render(lit, settings, nee="ON"), passed, tolerance, "lit through them")
    return sweep.outcome()
