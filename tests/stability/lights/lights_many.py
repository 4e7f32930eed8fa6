"""Many lights, lights without area, lights inside glass, and lights that are refused."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import Closure, ClosureKind, Light, LightKind, Material, Mesh, Scene
from raybatch_addon.core.scene.validate import checked_scene
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.lights.form_factors import square_form_factor
from tests.stability.uniform import (
    KINDS,
    PIXELS,
    ROUNDING,
    SIGMAS,
    STATISTICS,
    UNIT_ROUNDOFF,
    UNSEEN,
    add_mean,
    diffuse,
    emitter,
    floor_of,
    mean_and_error,
    point_light,
)
from tests.support import scenes

_MANY = 100_000
_OVERLAPPING_BOUNCES = 3


@case(
    "one light",
    "lights",
    "A point light beside the floor: intensity cos / d^2.",
    "One light is chosen with probability 1, and every sample is the same: 64 roundings from the light to the film.",
    quick=True,
)
def one_light(bench: Bench) -> Outcome:
    """One scene."""
    sweep = Sweep()
    add_mean(
        sweep, bench.render(floor_of(point_light((0.6, 0, 0.8), 5.0)), sample_count=4), 5.0 * 0.8 / math.pi, ROUNDING
    )
    return sweep.outcome()


def _random_points(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions in a layer above the floor (float32), and intensities over four decades; seeded."""
    rng = np.random.default_rng(5)
    positions = np.column_stack([rng.uniform(-3, 3, (count, 2)), rng.uniform(0.5, 2.5, count)]).astype(np.float32)
    return positions, 10.0 ** rng.uniform(-4, 0, count)


@case(
    "100,000 point lights",
    "lights",
    "Point lights at random positions with intensities over four decades: the sum of intensity cos / d^2 in float64.",
    f"{STATISTICS}, and 64 roundings: of a sample; at each node of the tree probabilities are in units of 2^-24, of "
    "which each that shines has at least one, exactly as light sampling takes them.",
)
def many_points(bench: Bench) -> Outcome:
    """One scene."""
    positions, intensity = _random_points(_MANY)
    lights = [point_light(p, i) for p, i in zip(positions.tolist(), intensity.tolist())]
    square = (positions.astype(np.float64) ** 2).sum(1)
    expected = float((intensity * positions[:, 2] / square**1.5).sum()) / math.pi
    sweep = Sweep()
    add_mean(sweep, bench.render(floor_of(*lights), sample_count=1024), expected, ROUNDING)
    return sweep.outcome()


@case(
    "20,000 lights that rays meet",
    "lights",
    "Sphere lights at random positions, met by scattered rays through a tree, neither hidden nor hiding: the sum of "
    "intensity cos / d^2.",
    f"{STATISTICS}, and 64 roundings.",
)
def many_spheres(bench: Bench) -> Outcome:
    """Sweep over light sampling, on and off."""
    positions, intensity = _random_points(20_000)
    lights = [point_light(p, i, radius=0.2, soft_falloff=False) for p, i in zip(positions.tolist(), intensity.tolist())]
    square = (positions.astype(np.float64) ** 2).sum(1)
    expected = float((intensity * positions[:, 2] / square**1.5).sum()) / math.pi
    sweep = Sweep()
    for nee in ("ON", "OFF"):
        add_mean(sweep, bench.render(floor_of(*lights), sample_count=32, nee=nee), expected, ROUNDING, f"nee {nee}")
    return sweep.outcome()


@case(
    "100,352 emissive triangles",
    "lights",
    "A square lamp cut into 224 x 224 cells of two triangles: configuration factor B-3.",
    f"{STATISTICS}, and 64 roundings.",
)
def many_triangles(bench: Bench) -> Outcome:
    """One scene."""
    n = 224
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, n + 1), np.linspace(-0.7, 0.7, n + 1))
    positions = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float32)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate(
        [np.column_stack([a, a + 1, a + n + 2]), np.column_stack([a, a + n + 2, a + n + 1])]
    ).astype(np.int32)
    lamp = (Mesh("lamp", positions, triangles), scenes.translation(0, 0, 0.9), emitter(3.0), UNSEEN)
    sweep = Sweep()
    add_mean(
        sweep, bench.render(floor_of(objects=[lamp]), sample_count=1024), 3.0 * square_form_factor(0.7, 0.9), ROUNDING
    )
    return sweep.outcome()


@case(
    "a thousand coincident lights",
    "lights",
    "A thousand area lights at one position: a thousand times the irradiance of one, by aimed and by scattered rays.",
    f"{STATISTICS}; 64 roundings; eight roundings of 2 pi of the rectangle's solid angle of 1.4 sr: 3e-6.",
)
def coincident(bench: Bench) -> Outcome:
    """Sweep over light sampling, on and off."""
    light = Light(
        "area", LightKind.RECTANGLE, scenes.translation(0, 0, 0.9), (3e-3,) * 3, size=(1.4, 1.4), visibility=UNSEEN
    )
    sweep = Sweep()
    for nee in ("ON", "OFF"):
        picture = bench.render(floor_of(*[light] * 1000), sample_count=64, nee=nee)
        add_mean(sweep, picture, 3.0 * square_form_factor(0.7, 0.9), ROUNDING + 3e-6, f"nee {nee}")
    return sweep.outcome()


@case(
    "overlapping lamps",
    "lights",
    "Three rectangles that overlap in one plane, a sphere, a sun and a world, over a floor with a ball on it: the "
    "picture of all of them is the sum of the pictures of each alone, by aimed and by scattered rays. Expected is the "
    "sum.",
    "Six standard errors of the mean of picture less sum, measured over the pixels, which are independent, and of each "
    "picture 64 roundings for each of its three bounces.",
    quick=True,
)
def overlapping(bench: Bench) -> Outcome:
    """Sweep over light sampling, on and off."""
    lamps = [
        Light("area", LightKind.RECTANGLE, scenes.translation(x, y, 0.9), (power,) * 3, size=size, visibility=UNSEEN)
        for x, y, power, size in ((0, 0, 1.0, (1.4, 1.4)), (0.3, 0.2, 2.0, (1.2, 0.8)), (-0.2, 0.1, 4.0, (0.5, 1.6)))
    ]
    lamps.append(point_light((0.5, -0.6, 0.9), 0.2, radius=0.4, soft_falloff=False))
    tilted = scenes.look_at((0.3, 0.4, 1.0), (0, 0, 0))
    lamps.append(Light("sun", LightKind.SUN, tilted, (0.7,) * 3, angle=1.0))
    ball = (scenes.sphere(segments=32, rings=16, radius=0.25), scenes.translation(0.4, 0, 0.25), diffuse(0.8))

    def scene(some: list[Light], world: float) -> Scene:
        return floor_of(*some, objects=[ball], world=world)

    sweep = Sweep()
    for nee, samples in (("ON", 512), ("OFF", 1024)):
        change = dict(nee=nee, sample_count=samples, sample_sequence="SOBOL", bounce_max=_OVERLAPPING_BOUNCES)
        parts = [scene([lamp], 0.0) for lamp in lamps] + [scene([], 0.4)]
        total = sum(bench.render(part, seed=1 + number, **change) for number, part in enumerate(parts))
        apart, error = mean_and_error(bench.render(scene(lamps, 0.4), seed=0, **change) - total)
        expected = float(total.mean())
        rounding = 2 * _OVERLAPPING_BOUNCES * ROUNDING * expected
        sweep.add(expected + apart, expected, SIGMAS * error + rounding, f"nee {nee}")
    return sweep.outcome()


@case(
    "lights of zero area",
    "lights",
    "Rectangles and disks without width, length or either, emissive triangles without area, and a cone scaled to "
    "nothing, beside one point light: that light alone.",
    f"{STATISTICS} (a light without power is chosen once in 2^32 times, so there is next to none), and 64 roundings.",
)
def zero_area(bench: Bench) -> Outcome:
    """One scene."""
    down = scenes.translation(0, 0, 1)
    none = [
        Light("none", kind, down, (1e6,) * 3, size=size, spread=spread)
        for kind in (LightKind.RECTANGLE, LightKind.ELLIPSE)
        for size in ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0))
        for spread in (0.0, 1.0, math.pi)
    ]
    none.append(
        Light("none", LightKind.SPOT, down, (1e6,) * 3, angle=0.0, radius=0.2, spot_scale=(0.0, 0.0), visibility=UNSEEN)
    )
    corners = np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1], [0.5, 0.5, 1]], np.float32)
    flat = Mesh("flat", corners, np.array([[0, 1, 2], [3, 3, 3], [0, 0, 1]], np.int32))
    scene = floor_of(point_light((0.6, 0, 0.8), 5.0), *none, objects=[(flat, scenes.IDENTITY, emitter(1e6))])
    sweep = Sweep()
    add_mean(sweep, bench.render(scene, sample_count=16), 5.0 * 0.8 / math.pi, ROUNDING)
    return sweep.outcome()


@case(
    "negative and infinite powers",
    "lights",
    "The core does not render lights and worlds of negative or infinite power, and names each; one point light "
    "remains.",
    "Warnings are counted: none may be missing. The remaining light is chosen with probability 1: 64 roundings.",
)
def refused(bench: Bench) -> Outcome:
    """One scene; the note names a warning that is missing."""
    bad = [
        Light(f"bad {i}", LightKind.POINT, scenes.translation(0, 0, 1), power)
        for i, power in enumerate([(-1.0, 1.0, 1.0), (math.inf, 1.0, 1.0), (math.nan, 1.0, 1.0), (-1e-30, 0.0, 0.0)])
    ]
    scene = floor_of(point_light((0.6, 0, 0.8), 5.0), *bad, world=-1.0)
    named = sum(any(f"“bad {i}”" in text for text in checked_scene(scene).warnings) for i in range(4))
    sweep = Sweep()
    sweep.add(named, 4, 0, "lights that are named")
    add_mean(sweep, bench.render(scene, sample_count=4), 5.0 * 0.8 / math.pi, ROUNDING)
    return sweep.outcome()


@case(
    "a light inside glass",
    "lights",
    "A sphere light at the centre of a smooth glass ball of index 1 to 2.4, in black space, seen from outside: a ray "
    "that enters with transmittance T passes it on every chord, reflected inside with R = 1 - T by the symmetry of "
    "the ball, so that it gathers T (1 + R + R^2 + ...) = 1 times the light's radiance.",
    f"{STATISTICS}; the ball's 192 x 96 facets have the interpolated normals of a sphere, but R differs between the "
    "ends of a chord by their tilt of 1/61, squared near normal incidence: 1e-3. Paths are cut at 64 bounces, which "
    "R^64 makes nothing of.",
)
def light_inside_glass(bench: Bench) -> Outcome:
    """Sweep over indices."""
    sweep = Sweep()
    ball = scenes.sphere("ball", 192, 96, smooth=True)
    for ior in (1.0, 1.0 + 1e-7, 1.33, 2.4):
        glass = Material("glass", (Closure(ClosureKind.GLASS, (1.0,) * 3, 0.0, ior),), (ClosureKind.GLASS,))
        light = Light("light", LightKind.POINT, scenes.IDENTITY, (math.pi * 0.25,) * 3, radius=0.5, soft_falloff=False)
        scene = scenes.scene(
            [(ball, scenes.IDENTITY, glass)], view=scenes.camera(half_width=0.02), frame=PIXELS, lights=[light]
        )
        add_mean(
            sweep,
            bench.render(scene, sample_count=256, bounce_max=64, roulette_bounce=65),
            1.0,
            1e-3,
            f"index {ior:.7g}",
        )
    return sweep.outcome()


@case(
    "a floor lit from inside glass",
    "lights",
    "A sphere light inside a ball of glass of index 1, which bends and reflects nothing: the floor outside is lit as "
    "without the ball, by scattered rays alone, since glass stops aimed ones. Intensity / d^2.",
    f"{STATISTICS}, and 64 roundings.",
)
def light_through_glass(bench: Bench) -> Outcome:
    """One scene."""
    kinds = (*KINDS, ClosureKind.GLASS)
    clear = Material("clear", (Closure(ClosureKind.GLASS, (1.0,) * 3, 0.0, 1.0),), kinds)
    ball = (scenes.sphere(segments=32, rings=16), scenes.translation(0, 0, 2), clear, UNSEEN)
    light = point_light((0, 0, 2), 4.0, radius=0.9, soft_falloff=False)
    sweep = Sweep()
    picture = bench.render(floor_of(light, objects=[ball], half_width=1e-4), sample_count=2048)
    # aimed rays would have had their share of what both strategies find; behind glass the delta lobe counts light that
    # it meets in full
    add_mean(sweep, picture, 1.0 / math.pi, ROUNDING)
    return sweep.outcome()


@case(
    "lights a hair above and below the floor's plane",
    "lights",
    "Point lights at 1e-3 to 1e-7 of their distance above the floor's plane: intensity sin / d^2; below it: black.",
    "The direction's height above the plane has an absolute rounding of its own length's: relative to the sine, 4 "
    "roundings over it.",
)
def grazing_lights(bench: Bench) -> Outcome:
    """Sweep over heights."""
    sweep = Sweep()
    for height in (1e-3, 1e-5, 1e-7):
        for sign in (1, -1):
            picture = bench.render(
                floor_of(point_light((1.0, 0, sign * height), 1.0), size=1e-2, half_width=1e-9), sample_count=4
            )
            expected = height / math.pi if sign > 0 else 0.0
            sweep.add(
                picture.mean(),
                expected,
                (4 * UNIT_ROUNDOFF + 1e-9) / math.pi + ROUNDING * expected,
                f"height {sign * height:g}",
            )
    return sweep.outcome()
