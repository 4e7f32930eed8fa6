"""Transport between mirrors, through keyholes and through veils."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from raybatch_addon.core.scene.description import Closure, ClosureKind, Light, LightKind, Material, Mesh, Visibility
from raybatch_addon.core.scene.linking import catcher_bits
from raybatch_addon.core.scene.passes import CATCHER_PASS
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.enclosures import (
    FEW,
    KINDS,
    MANY,
    SCATTERED,
    add_exact,
    add_relative,
    facing_down,
    joined,
    lamp,
    mirror,
    stretched,
    view_along,
    wall,
    wall_with_hole,
)
from tests.stability.lights.form_factors import square_form_factor
from tests.stability.transport.transport import U, series
from tests.stability.uniform import SIGMAS, add_mean
from tests.support import scenes


@case(
    "mirror corridor",
    "transport",
    """A ray zigzags through a corridor of two mirrors, in squares of 1 m, to a lamp at its end, by 1 to 1000
    reflections: the lamp's radiance times the reflectance to that power.""",
    """each reflection multiplies by the reflectance and by a weight of 1, both rounded: 2 n U. The number of
    reflections is exact: one moves the ray by the offset, below 64 U m of squares of 1 m, and a reflection in an axis
    keeps the direction, so that after 1000 it is within 1e-3 m of the lamp's middle, which is 0.5 m from the next""",
    quick=True,
)
def mirror_corridor(bench: Bench) -> Outcome:
    sweep = Sweep()
    for count, reflectance in ((1, 0.5), (10, 0.9), (100, 0.99), (1000, 0.999)):
        # at 45 degrees a ray from the middle is in the middle again after `count` reflections and `count` metres
        sides = [
            (_strip(f"side {side}", 0.5 * side, count + 2), scenes.IDENTITY, mirror(reflectance)) for side in (-1, 1)
        ]
        scene = scenes.scene(
            [*sides, (scenes.plane("lamp", 1.0), facing_down(-float(count)), lamp(3.0))],
            frame=FEW,
            view=view_along((0, 0, 0), (1, 0, -1)),
        )
        picture = bench.render(scene, SCATTERED, roulette_bounce=10_001)
        expected = 3.0 * float(np.float32(reflectance)) ** count
        add_relative(sweep, picture, expected, 2 * count * U, f"{count} reflections")
    return sweep.outcome()


def _strip(name: str, x: float, length: int) -> Mesh:
    """Squares of 1 m in the plane `x`, from z = 1 down [m].

    They are one mesh, since the offset of rays is in proportion to triangles.
    """
    square = np.array([[x, -0.5, 0], [x, 0.5, 0], [x, 0.5, -1], [x, -0.5, -1]])
    transforms = [np.column_stack([np.eye(3), (0, 0, 1 - i)]) for i in range(length)]
    return joined(name, Mesh(name, square.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)), transforms)


@case(
    "facing mirrors",
    "transport",
    "Between two facing mirrors that emit 1 and reflect 0.999, 10,000 reflections: the geometric series.",
    "as for bounce limits: sums and products of a geometric series, each rounded once",
)
def facing_mirrors(bench: Bench) -> Outcome:
    sweep, reflectance = Sweep(), 0.999
    objects = [
        (scenes.plane("left", 2.0), stretched(1, 1, 1, (0, 0, -1)), mirror(reflectance, 1.0)),
        (scenes.plane("right", 2.0), facing_down(1.0), mirror(reflectance, 1.0)),
    ]
    picture = bench.render(
        scenes.scene(objects, frame=FEW, view=view_along((0, 0, 0), (0, 0, -1))), SCATTERED, roulette_bounce=10_001
    )
    expected = float(series(reflectance, 10_002))
    add_relative(sweep, picture, expected, 3 * (math.log(U) / math.log(reflectance) + 1) * U, "10,000 reflections")
    return sweep.outcome()


@case(
    "keyhole",
    "transport",
    """A floor 1 m below a black wall with a hole of 1 m to 0.1 mm, right above which is a lamp: the floor's radiance
    below the hole is the hole's form factor.""",
    f"""{SIGMAS:g} standard errors over pixels; the hole's edges are off by up to 4 U of the distance on each side, from
    the rounding of the ray's origin and direction: 16 U / a of the area. The ray starts above the floor by the offset,
    26 U of its triangles' 8 m: twice that of the form factor, 416 U; and 40 roundings""",
    quick=True,
)
def keyhole(bench: Bench) -> Outcome:
    sweep = Sweep()
    for hole in (1.0, 0.1, 1e-2, 1e-3, 1e-4):
        scene = scenes.scene(
            [
                (scenes.plane("floor", 8.0), stretched(1, 1, 1, (0, 0, -1)), wall()),
                (wall_with_hole(8.0, hole), scenes.IDENTITY, wall(0.0)),
                (scenes.plane("lamp", 3 * hole), facing_down(hole / 4), lamp(1.0)),
            ],
            frame=MANY,
            view=scenes.camera(eye=(0.4, -0.3, -0.4), target=(0, 0, -1), half_width=1e-6),
        )
        picture = bench.render(scene, SCATTERED, nee="ON", bounce_max=1, sample_count=1024)
        add_mean(sweep, picture, square_form_factor(hole / 2, 1.0), 16 * U / hole + 456 * U, f"a hole of {hole:g} m")
    return sweep.outcome()


@case(
    "keyhole between white rooms",
    "transport",
    "Two closed white rooms joined by a hole, a lamp in the other one: every path finds it in the end, and brings its "
    "radiance of 1.",
    """as for the cavity: exact, since of white rooms a path carries 1 until it meets the lamp. The hole is 1 % of each
    room, the lamp more: fewer than e^-40 of the paths are on their way after 10,000 bounces""",
    quick=True,
)
def keyhole_between_rooms(bench: Bench) -> Outcome:
    sweep = Sweep()
    scene = scenes.scene(
        [
            (scenes.box("rooms"), stretched(1, 1, 2), wall()),
            (wall_with_hole(3.0, 0.5), scenes.IDENTITY, wall()),
            (scenes.plane("lamp", 1.6), facing_down(1.5), lamp(1.0)),
        ],
        frame=FEW,
        view=scenes.camera(eye=(0.0, -0.8, -1.0), target=(0, 1, -1.1), half_width=0.7),
    )
    add_exact(sweep, bench.render(scene, SCATTERED, sample_count=4), 1.0, "two rooms")
    return sweep.outcome()


@case(
    "a thousand veils",
    "transport",
    """1000 surfaces that let 0.999 of the light straight through: a lamp behind them seen by the camera, and the floor
    behind them under a point light above, is darker by 0.999^1000.""",
    "one product a veil, and a weight of 1, both rounded: 2000 U; and 10 roundings of shading the floor",
)
def veils(bench: Bench) -> Outcome:
    sweep, count, share = Sweep(), 1000, 0.999
    veil = Material("veil", (Closure(ClosureKind.TRANSPARENT, (share,) * 3),), (*KINDS, ClosureKind.TRANSPARENT))
    stack = joined(
        "veils", scenes.plane("veil", 2.0), [scenes.translation(0, 0, 0.25 + 0.5 * i / count) for i in range(count)]
    )
    passed = float(np.float32(share)) ** count
    tolerance = (2 * count + 10) * U
    above = Light("point", LightKind.POINT, scenes.translation(0, 0, 1), (math.pi,) * 3)
    settings = SCATTERED.replace(bounce_max=1, transparent_bounce_max=1024, roulette_bounce=2)

    seen = scenes.scene(
        [(stack, scenes.IDENTITY, veil), (scenes.plane("lamp", 2.0), scenes.IDENTITY, lamp(1.0))],
        frame=FEW,
        view=view_along((0, 0, 2), (0, 0, 0)),
    )
    add_relative(sweep, bench.render(seen, settings, nee="ON"), passed, tolerance, "seen through them")
    # the camera is below the veils, the light above
    lit = scenes.scene(
        [(stack, scenes.IDENTITY, veil), (scenes.plane("floor", 2.0), scenes.IDENTITY, wall())],
        frame=FEW,
        view=view_along((0.05, 0, 0.1), (0, 0, 0)),
        lights=[above],
    )
    add_relative(sweep, bench.render(lit, settings, nee="ON"), passed, tolerance, "lit through them")
    return sweep.outcome()


@case(
    "veils over a catcher",
    "transport",
    """A shadow catcher below veils that it alone sees, and a sun, in scenes of 1 mm to 10 km with suns of 1e-12 to
    1e12: its pass is what the veils let through, their transmittance to the power of their number.""",
    """both lives of a path compute the same light; a veil multiplies that of the first by its transmittance, rounded:
    U for each. The exact sums of both, their means and the quotient are rounded once each: 5 U more""",
    quick=True,
)
def veils_over_a_catcher(bench: Bench) -> Outcome:
    sweep, transmittance = Sweep(), np.float32(0.7)
    veil = Material("veil", (Closure(ClosureKind.TRANSPARENT, (0.7,) * 3),), (ClosureKind.TRANSPARENT,))
    unseen, everything = int(Visibility.ALL & ~Visibility.CAMERA), int(Visibility.ALL)
    for scale, strength, count in ((1.0, 1.0, 1), (1.0, 1.0, 16), (1e-3, 1e-12, 3), (1e4, 1e12, 3)):
        sheets = [
            (scenes.plane(f"veil {i}", 4 * scale), scenes.translation(0, 0, (1 + i) * scale), veil, unseen)
            for i in range(count)
        ]
        floor = (
            scenes.plane("floor", 4 * scale),
            scenes.IDENTITY,
            scenes.diffuse(),
            everything | catcher_bits(everything),
        )
        scene = scenes.scene(
            [floor, *sheets],
            frame=replace(FEW, passes=("Combined", CATCHER_PASS)),
            view=view_along((0, 0, 0.5 * scale), (0, 0, 0), half_width=0.5),
            lights=[scenes.sun(strength)],
        )
        picture = bench.film(scene, bounce_max=0, transparent_bounce_max=32).passes[CATCHER_PASS].astype(np.float64)
        expected = float(transmittance) ** count
        add_relative(sweep, picture, expected, (count + 5) * U, f"{count} veils, {scale:g} m, a sun of {strength:g}")
    return sweep.outcome()
