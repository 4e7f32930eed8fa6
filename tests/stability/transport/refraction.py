"""Transport through glass: piles of plates, objects within objects, light pipes and caustics."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from raybatch_addon.core.scene.description import Frame, Scene
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.enclosures import (
    MANY,
    SCATTERED,
    add_exact,
    facing_down,
    glass,
    icosphere_mesh,
    joined,
    lamp,
    stretched,
    view_along,
    wall,
)
from tests.stability.transport.fresnel import adding, ball_caustic, reflectance, slab_albedo
from tests.stability.uniform import SIGMAS, UNIT_ROUNDOFF, add_mean, mean_and_error
from tests.support import scenes

U = UNIT_ROUNDOFF
WHITE = """a path carries 1 to the bit until it leaves, so that nothing may be lost or added. Facets turn directions at
every bounce: a path that
    is not out after 10,000 would need to be reflected at facets all that time"""
WIDE = 100.0  # size of objects that count as without end [m]


def _below(*objects, behind: float = 0.0, half_width: float = 1e-6) -> Scene:
    """A lamp of radiance 1 below `objects`, seen from above along one line; above is a world of radiance `behind`."""
    floor = (scenes.plane("lamp", 4 * WIDE), stretched(1, 1, 1, (0, 0, -10)), lamp(1.0))
    return scenes.scene([*objects, floor], frame=MANY, view=view_along((0, 0, 10), (0, 0, 0), half_width), world=behind)


@case(
    "piles of plates",
    "transport",
    """Straight through 1, 4 or 32 parallel plates of IOR 0.5, 1.001, 1.5, 2.4 or (but for 32) 10: of m plates with
    reflectance R at each side (1 - R) / (1 + (2 m - 1) R) gets through (Stokes 1862). The rest comes back: with
    light on both sides every value is 1.""",
    f"""a path brings 1 or 0, with that probability p: {SIGMAS:g} standard errors sqrt(p (1 - p) / n); 8 roundings of R
    at each side. With light on both sides exact: a path carries 1""",
)
def piles_of_plates(bench: Bench) -> Outcome:
    sweep, samples = Sweep(), 64
    for count in (1, 4, 32):
        transforms = [stretched(WIDE, WIDE, 0.02, (0, 0, 0.1 * i)) for i in range(count)]
        pile = joined("pile", scenes.box(), transforms)
        for ior in (0.5, 1.001, 1.5, 2.4, 10.0)[: 5 if count < 32 else 4]:
            objects = (pile, scenes.IDENTITY, glass(ior))
            picture = bench.render(_below(objects), SCATTERED, sample_count=samples)[..., 0]
            r = float(reflectance(1.0, float(np.float32(ior))))
            passed = (1 - r) / (1 + (2 * count - 1) * r)
            error = SIGMAS * math.sqrt(passed * (1 - passed) / (picture.size * samples)) + 16 * count * U * r
            sweep.add(picture.mean(), passed, error, f"{count} plates of IOR {ior:g}")
        add_exact(
            sweep, bench.render(_below(objects, behind=1.0), SCATTERED), 1.0, f"{count} plates, light on both sides"
        )
    return sweep.outcome()


NESTED = ((1.33, 0.9, 1.0), (1.5, 1.0, 0.95), (0.8, 0.95, 0.9), (2.4, 1.0, 1.0), (1.0, 0.9, 1.0), (0.4, 1.0, 0.97))


@case(
    "nested slabs",
    "transport",
    """Straight through six boxes, each inside the one before, of relative IOR 0.4 to 2.4 (1 among them), some coloured:
    twelve interfaces that reflect w R and let w f (1 - R) through, added in float64 (van de Hulst's adding method).""",
    f"{SIGMAS:g} standard errors over pixels, which are independent; 40 roundings an interface",
    quick=True,
)
def nested_slabs(bench: Bench) -> Outcome:
    sweep, boxes, sides = Sweep(), [], []
    for number, (ior, weight, refraction) in enumerate(NESTED):
        half = 1.0 - 0.15 * number
        boxes.append(
            (scenes.box(f"box {number}"), stretched(WIDE * half, WIDE * half, half), glass(ior, weight, refraction))
        )
        r = float(reflectance(1.0, float(np.float32(ior))))
        sides.append((weight * r, weight * refraction * (1 - r)))
    reflected, passed = adding([*sides, *sides[::-1]])
    add_mean(sweep, bench.render(_below(*boxes), SCATTERED, sample_count=512), passed, 12 * 40 * U, "passed")
    # the lamp is taken to be black from above: reflected light is the world's
    both = bench.render(_below(*boxes, behind=1.0), SCATTERED, sample_count=512)
    add_mean(sweep, both, passed + reflected, 12 * 40 * U, "passed and reflected")
    return sweep.outcome()


@case(
    "nested dielectrics in white",
    "transport",
    """Ten glass balls within each other, of IOR 0.5 to 3 relative to their surroundings, in a world of 1: nothing is
    absorbed, so every pixel is 1, however often light is totally reflected.""",
    WHITE,
)
def nested_dielectrics(bench: Bench) -> Outcome:
    sweep, ball = Sweep(), icosphere_mesh(2)
    iors = (1.5, 0.9, 2.0, 0.5, 1.0, 1.2, 3.0, 0.7, 1.001, 1.33)
    objects = [
        (dataclasses.replace(ball, name=f"ball {i}"), stretched(*(1.0 - 0.08 * i,) * 3), glass(ior))
        for i, ior in enumerate(iors)
    ]
    scene = scenes.scene(objects, frame=MANY, view=scenes.camera(eye=(0, -4, 0), half_width=0.3), world=1.0)
    add_exact(sweep, bench.render(scene, SCATTERED, sample_count=8), 1.0, "ten balls")
    return sweep.outcome()


@case(
    "light pipe",
    "transport",
    """Into the end of a glass rod 1 m thick and 1000 m long, askew: 500 total reflections lose nothing, and reflections
    at the two ends leave (1 - R) / (1 + R), R at the angle of incidence. With light at both ends every value is 1.""",
    f"""{SIGMAS:g} standard errors sqrt(p (1 - p) / n); a reflection costs the direction 2 U and R, whose slope is below
    1 there, as much: 1000 U. Exact with light around""",
)
def light_pipe(bench: Bench) -> Outcome:
    sweep, samples, ior, length = Sweep(), 32, 1.5, 1000.0
    # inside, a ray moves 0.5 m aside for every metre, so that it reaches the other end at its middle
    sine = ior * 0.5 / math.hypot(0.5, 1.0)
    cosine = math.sqrt(1 - sine * sine)
    rod = (scenes.box("rod"), stretched(0.5, 0.5, length / 2, (0, 0, -length / 2)), glass(ior))
    end = (scenes.plane("lamp", 50.0), stretched(1, 1, 1, (0, 0, -length - 1)), lamp(1.0))
    view = view_along((-sine, 0, cosine), (0, 0, 0))
    picture = bench.render(scenes.scene([rod, end], frame=MANY, view=view), SCATTERED, sample_count=samples)[..., 0]
    r = float(reflectance(cosine, ior))
    passed = (1 - r) / (1 + r)
    sweep.add(
        picture.mean(),
        passed,
        SIGMAS * math.sqrt(passed * (1 - passed) / (picture.size * samples)) + 1000 * U,
        "from end to end",
    )
    add_exact(
        sweep,
        bench.render(scenes.scene([rod], frame=MANY, view=view, world=1.0), SCATTERED, sample_count=4),
        1.0,
        "light at both ends",
    )
    return sweep.outcome()


@case(
    "caustic in white",
    "transport",
    """A white floor under a glass ball in a world of 1: light that the ball takes from one point of the floor it gives
    to another, and every pixel is 1, in the focus too.""",
    WHITE,
)
def caustic_in_white(bench: Bench) -> Outcome:
    sweep = Sweep()
    scene = scenes.scene(
        [
            (icosphere_mesh(2), stretched(1, 1, 1, (0, 0, 1.2)), glass(1.5)),
            (scenes.plane("floor", 6.0), scenes.IDENTITY, wall()),
        ],
        frame=MANY,
        view=scenes.camera(eye=(0, -4, 1.5), target=(0, 0, 0.6), half_width=0.5),
        world=1.0,
    )
    add_exact(sweep, bench.render(scene, SCATTERED, sample_count=8), 1.0, "floor and ball")
    return sweep.outcome()


@functools.cache
def _ball_reference() -> tuple[float, float, float]:
    return ball_caustic(icosphere_mesh(1), (0.0, 0.0, 1.5), 1.5, lamp_half=1.5, lamp_height=4.0)


@case(
    "caustic under a ball",
    "transport",
    """The floor below a faceted glass ball, above which is a lamp: light reaches it through the ball alone. Against a
    float64 quadrature over the directions of the floor's hemisphere that follows both rays of every refraction; lights
    sampled directly, or not.""",
    f"""{SIGMAS:g} standard errors of both, the quadrature's from 32 grids; 1e-5 for light that the floor, 1 cm wide,
    gets from itself; the light of the quadrature's rays that were not followed to their end, below 1e-5 each""",
)
def caustic_under_a_ball(bench: Bench) -> Outcome:
    sweep, (expected, spread, left_out) = Sweep(), _ball_reference()
    scene = scenes.scene(
        [
            (icosphere_mesh(1), stretched(1, 1, 1, (0, 0, 1.5)), glass(1.5)),
            (scenes.plane("floor", 0.01), scenes.IDENTITY, wall()),
            (scenes.plane("lamp", 3.0), facing_down(4.0), lamp(1.0)),
        ],
        frame=Frame(24, 24),
        view=scenes.camera(eye=(0.8, 0.0, 0.3), half_width=1e-6),
    )
    for nee in ("OFF", "ON"):
        mean, error = mean_and_error(bench.render(scene, SCATTERED, nee=nee, sample_count=256))
        sweep.add(
            mean, expected, SIGMAS * math.hypot(error, spread) + 1e-5 * expected + left_out, f"light sampling {nee}"
        )
    return sweep.outcome()


@case(
    "light under a slab",
    "transport",
    """A grey floor 10 cm below a glass slab without end, in a world of 1: E = T / (1 - a (1 - T)), T the slab's diffuse
    transmission, from Fresnel's equations by Gauss's quadrature; of a white floor every value is 1.""",
    f"{SIGMAS:g} standard errors over pixels; 400 roundings; rays that leave by the slab's sides, 100 m away: "
    "(1e-3)^2. Of a white floor exact",
)
def light_under_a_slab(bench: Bench) -> Outcome:
    sweep = Sweep()
    for ior in (1.0, 1.1, 1.5, 2.4):
        for albedo in (0.5, 1.0):
            scene = scenes.scene(
                [
                    (scenes.plane("floor", 2 * WIDE), scenes.IDENTITY, wall(albedo)),
                    (scenes.box("slab"), stretched(WIDE, WIDE, 0.05, (0, 0, 0.15)), glass(ior)),
                ],
                frame=MANY,
                view=scenes.camera(eye=(0.03, -0.04, 0.05), half_width=1e-6),
                world=1.0,
            )
            picture = bench.render(scene, SCATTERED, sample_count=64 if albedo < 1 else 4)
            if albedo == 1:
                add_exact(sweep, picture, 1.0, f"white floor, IOR {ior:g}")
            else:
                passed = 1 - slab_albedo(float(np.float32(ior)))
                add_mean(sweep, picture, albedo * passed / (1 - albedo * (1 - passed)), 400 * U + 1e-6, f"IOR {ior:g}")
    return sweep.outcome()
