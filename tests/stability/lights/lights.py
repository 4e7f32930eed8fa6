"""Lights of extreme sizes, distances, powers and angles."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from raybatch_addon.core.scene.description import Light, LightKind, Mesh
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.geometry.meshes import rotation
from tests.stability.lights.form_factors import square_form_factor
from tests.stability.uniform import (
    PIXELS,
    ROUNDING,
    STATISTICS,
    UNIT_ROUNDOFF,
    UNSEEN,
    add_mean,
    diffuse,
    emitter,
    floor_of,
    point_light,
)
from tests.support import scenes

# --- near a surface


def _turned(mesh: Mesh, turn: np.ndarray, height: float = 0.0) -> Mesh:
    """`mesh` raised by `height`, then turned about the origin."""
    return dataclasses.replace(
        mesh, positions=((mesh.positions + np.array([0, 0, height])) @ turn.T).astype(np.float32)
    )


@case(
    "area light 1e-6 of its size above a surface",
    "lights",
    "A square and a disk light of side 1 at heights of 1e-6 to 1 above a small white tile: the configuration factors "
    "B-3 of Howell's catalogue and r^2 / (r^2 + h^2).",
    f"{STATISTICS}; 64 roundings; and the excess of a rectangle's corner angles over 2 pi, which its density divides "
    "by, is a sum with eight roundings of 2 pi: relative to its 0.8 sr and more, 4e-6.",
)
def area_light_near_surface(bench: Bench) -> Outcome:
    """Sweep over heights and shapes."""
    sweep = Sweep()
    for height in (1e-6, 1e-4, 1e-2, 1.0):
        for kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
            light = Light(
                "area", kind, scenes.translation(0, 0, height), (3.0,) * 3, size=(1.0, 1.0), visibility=UNSEEN
            )
            is_square = kind == LightKind.RECTANGLE
            expected = 3.0 * square_form_factor(0.5, height) if is_square else 3.0 * 0.25 / (0.25 + height**2)
            picture = bench.render(floor_of(light, size=1e-2), sample_count=1024)
            add_mean(sweep, picture, expected, ROUNDING + 4e-6, f"{kind.name.lower()} at {height:g}")
    return sweep.outcome()


@case(
    "mesh light 1e-6 of its size above a surface",
    "lights",
    "An emissive square of side 1 at heights of 1e-6 to 1 above a small white tile: configuration factor B-3. Found "
    "by aimed and by scattered rays together. Level, and turned as a whole, so that no coordinate of a surface is the "
    "same for all of it.",
    f"{STATISTICS}, and 64 roundings; turned corners are rounded by 2 u 0.5 m, which moves the lamp, but hardly its "
    "factor: by less than 1e-8.",
)
def mesh_light_near_surface(bench: Bench) -> Outcome:
    """Sweep over heights."""
    sweep = Sweep()
    for height in (1e-6, 1e-4, 1e-2, 1.0):
        expected = 3.0 * square_form_factor(0.5, height)
        lamp = (scenes.plane("lamp", 1.0), scenes.translation(0, 0, height), emitter(3.0), UNSEEN)
        picture = bench.render(floor_of(objects=[lamp], size=1e-2), sample_count=1024)
        add_mean(sweep, picture, expected, ROUNDING, f"height {height:g}")
        turn = rotation(12)
        objects = [(_turned(scenes.plane("lamp", 1.0), turn, height), scenes.IDENTITY, emitter(3.0), UNSEEN)]
        objects += [(_turned(scenes.plane("tile", 1e-2), turn), scenes.IDENTITY, diffuse())]
        view = scenes.camera(eye=tuple(turn @ (0.0, -1e-3, 1.0)), half_width=1e-5)
        picture = bench.render(scenes.scene(objects, view=view, frame=PIXELS), sample_count=1024)
        add_mean(sweep, picture, expected, ROUNDING, f"height {height:g}, turned")
    return sweep.outcome()


@case(
    "round light 1e-6 of its size above a surface",
    "lights",
    "A sphere light of radius 1 whose lowest point is 1e-6 to 1 above a small white tile (its irradiance is intensity "
    "/ distance to the centre squared, Lambert), and a disk that faces the tile at 1e-6 to 1 of its radius (intensity "
    "/ (r^2 + h^2)).",
    f"{STATISTICS}, and 1e-4: the cone of a sphere that fills half the sky has 1 - cos = 1 - sqrt(1 - (r/d)^2), where "
    "1 - (r/d)^2 = 2e-6 has the error of a rounding of 1, whose root is 3e-2 of 1e-3.",
    quick=True,
)
def round_light_near_surface(bench: Bench) -> Outcome:
    """Sweep over heights and shapes."""
    sweep = Sweep()
    for height in (1e-6, 1e-3, 1.0):
        sphere = point_light((0, 0, 1 + height), 2.0, radius=1.0, soft_falloff=False)
        disk = point_light((0, 0, height), 2.0, radius=1.0)
        for name, light, square in (("sphere", sphere, (1 + height) ** 2), ("disk", disk, 1 + height**2)):
            # the disk turns to the shaded point: it is seen far smaller than its height
            scene = floor_of(light, size=1e-2, eye=(0.0, -1e-7, 1e-4), half_width=1e-5)
            add_mean(sweep, bench.render(scene, sample_count=64), 2.0 / square / math.pi, 1e-4, f"{name} at {height:g}")
    return sweep.outcome()


@case(
    "point light 1e-6 to 1e9 away",
    "lights",
    "A point light of intensity distance^2 straight above the floor: its irradiance is 1 at every distance.",
    "The square of the distance, a quotient and products, each rounded once: fewer than 64 roundings. Nothing is "
    "chosen at random.",
    quick=True,
)
def inverse_square(bench: Bench) -> Outcome:
    """Sweep over distances."""
    sweep = Sweep()
    for distance in (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9):
        picture = bench.render(
            floor_of(point_light((0, 0, distance), distance**2), size=1e-2, half_width=1e-10), sample_count=4
        )
        add_mean(sweep, picture, 1 / math.pi, ROUNDING, f"distance {distance:g}")
    return sweep.outcome()


@case(
    "inside a sphere light",
    "lights",
    "A white tile and its camera inside a sphere light of radius 2 to 1e6: light of radiance intensity / (pi r^2) "
    "from everywhere, so that the tile looks as bright as the light.",
    f"{STATISTICS}, and 64 roundings.",
)
def inside_a_light(bench: Bench) -> Outcome:
    """Sweep over radii."""
    sweep = Sweep()
    for radius in (2.0, 1e3, 1e6):
        light = point_light((0.1, 0.2, -0.3), math.pi * radius**2, radius=radius, soft_falloff=False)
        picture = bench.render(floor_of(light, size=1e-2), sample_count=1024)
        add_mean(sweep, picture, 1.0, ROUNDING, f"radius {radius:g}")
    return sweep.outcome()


# --- powers


def _lights_of_each_kind(power: float) -> list[tuple[Light, float]]:
    """Lights above the floor, and the irradiance of each."""
    down = scenes.translation(0, 0, 2)
    return [
        (point_light((0, 0, 2), power), power / 4),
        (point_light((0, 0, 2), power, radius=0.5, soft_falloff=False), power / 4),
        (Light("spot", LightKind.SPOT, down, (power,) * 3, angle=1.0), power / 4),
        (scenes.sun(power), power),
        (
            Light("area", LightKind.RECTANGLE, down, (power,) * 3, visibility=UNSEEN),
            math.pi * power * square_form_factor(0.5, 2.0),
        ),
        (Light("disk", LightKind.ELLIPSE, down, (power,) * 3, visibility=UNSEEN), power * math.pi * 0.25 / 4.25),
    ]


@case(
    "lights of 1e-30 and 1e30",
    "lights",
    "A light of each kind with 1e-30, 1 and 1e30 times its power: the irradiance at power 1, times that factor.",
    f"{STATISTICS}; 64 roundings; eight roundings of 2 pi of the rectangle's solid angle of 0.23 sr: 2e-5. Sums are "
    "exact over the range of float32.",
)
def powers_of_lights(bench: Bench) -> Outcome:
    """Sweep over powers and kinds."""
    sweep = Sweep()
    for power in (1e-30, 1.0, 1e30):
        for light, irradiance in _lights_of_each_kind(power):
            picture = bench.render(floor_of(light), sample_count=256)
            # in units of the power, so that a sweep's worst value is comparable
            add_mean(
                sweep, picture / power, irradiance / power / math.pi, ROUNDING + 2e-5, f"{light.name} of {power:g}"
            )
    return sweep.outcome()


@case(
    "emissive meshes and worlds of 1e-30 and 1e30",
    "lights",
    "A white floor under a world, and under an emissive square: radiance and configuration factor, times 1e-30 to "
    "1e30.",
    f"{STATISTICS}, and 64 roundings.",
)
def powers_of_meshes(bench: Bench) -> Outcome:
    """Sweep over powers."""
    sweep = Sweep()
    for power in (1e-30, 1e30):
        add_mean(sweep, bench.render(floor_of(world=power), sample_count=4) / power, 1.0, ROUNDING, f"world {power:g}")
        lamp = (scenes.plane("lamp", 1.0), scenes.translation(0, 0, 0.8), emitter(power), UNSEEN)
        picture = bench.render(floor_of(objects=[lamp]), sample_count=1024)
        add_mean(sweep, picture / power, square_form_factor(0.5, 0.8), ROUNDING, f"mesh {power:g}")
    return sweep.outcome()


@case(
    "a faint light beside one of 1e30",
    "lights",
    "A sphere light of power 1 above a floor, and one of 1e30 below, where it lights nothing: the faint one is chosen "
    "once in four billion times, and found by scattered rays. The irradiance is that of the faint one alone.",
    f"{STATISTICS}; 64 roundings; scattered rays leave the floor at 25 u of its 4 m, which is nearer to the light, 3 m "
    "above.",
)
def faint_beside_bright(bench: Bench) -> Outcome:
    """One scene."""
    faint = point_light((0, 0, 3), 9.0, radius=2.5, soft_falloff=False)
    bright = point_light((0, 0, -50), 1e30, radius=1.0, soft_falloff=False)
    sweep = Sweep()
    add_mean(
        sweep,
        bench.render(floor_of(faint, bright, half_width=1e-6), sample_count=2048),
        1 / math.pi,
        ROUNDING + 50 * UNIT_ROUNDOFF * 4 / 3,
    )
    return sweep.outcome()


# --- angles


def _tilted(elevation: float) -> np.ndarray:
    """A sun at this angle from the zenith [rad]."""
    return scenes.look_at((math.sin(elevation), 1e-9, math.cos(elevation)), (0, 0, 0), up=(0, 1, 0))


@case(
    "sun of angle 0",
    "lights",
    "A sun without size at 0 to 89.99 degrees from the zenith: strength times cosine.",
    "A cosine is a sum of three products of two unit vectors of float32, whose coordinates are off by a rounding: 8 "
    "roundings of the strength, absolute, as the cosine itself goes to 0.",
    quick=True,
)
def sun_of_no_angle(bench: Bench) -> Outcome:
    """Sweep over elevations."""
    sweep = Sweep()
    for degrees in (0.0, 60.0, 89.0, 89.99):
        picture = bench.render(floor_of(scenes.sun(2.0, 0.0, _tilted(math.radians(degrees)))), sample_count=4)
        expected = 2.0 * math.cos(math.radians(degrees)) / math.pi
        sweep.add(picture.mean(), expected, 8 * UNIT_ROUNDOFF * 2.0, f"{degrees:g} degrees")
    return sweep.outcome()


@case(
    "sun of 180 degrees",
    "lights",
    "A sun that fills half the sky has radiance strength / pi (its projected solid angle is pi); a floor tilted by t "
    "against it sees the half sky in part: strength (1 + cos t) / 2.",
    f"{STATISTICS}, and 64 roundings.",
)
def sun_of_half_the_sky(bench: Bench) -> Outcome:
    """Sweep over tilts."""
    sweep = Sweep()
    for degrees in (0.0, 45.0, 90.0, 135.0, 179.0):
        light = dataclasses.replace(scenes.sun(2.0, math.pi, _tilted(math.radians(degrees))), visibility=UNSEEN)
        picture = bench.render(floor_of(light), sample_count=1024)
        add_mean(sweep, picture, (1 + math.cos(math.radians(degrees))) / math.pi, ROUNDING, f"{degrees:g} degrees")
    return sweep.outcome()


@case(
    "sun of 1e-8 to 180 degrees",
    "lights",
    "Straight above, every sun gives its strength: its radiance is strength over its projected solid angle.",
    f"{STATISTICS}, and 64 roundings. (At the rim of narrow cones rays that meet the sun by chance are decided by "
    "roundings of their direction: aimed ones, which carry almost all of its light there, are not.)",
)
def sun_of_any_angle(bench: Bench) -> Outcome:
    """Sweep over angles."""
    sweep = Sweep()
    for angle in (1e-10, 1e-7, 3e-7, 1e-5, 1e-3, 0.1, 1.0, 3.0, math.pi):
        light = dataclasses.replace(scenes.sun(2.0, angle, _tilted(0.0)), visibility=UNSEEN)
        add_mean(sweep, bench.render(floor_of(light), sample_count=64), 2.0 / math.pi, ROUNDING, f"{angle:g} rad")
    return sweep.outcome()


@case(
    "spot of 0 degrees",
    "lights",
    "A cone without width lights nothing: black, with a hard and a soft edge, without and with a size.",
    "No direction has a cosine above that of a cone of angle 0, which is 1, so that the spot's factor is 0 to the bit: "
    "exact.",
    quick=True,
)
def spot_of_no_angle(bench: Bench) -> Outcome:
    """Sweep over blends and radii."""
    sweep = Sweep()
    for blend in (0.0, 1.0):
        for radius in (0.0, 0.1):
            light = Light(
                "spot",
                LightKind.SPOT,
                scenes.translation(0, 0, 1),
                (5.0,) * 3,
                angle=0.0,
                blend=blend,
                radius=radius,
                visibility=UNSEEN,
            )
            picture = bench.render(floor_of(light, half_width=0.1), sample_count=16)
            sweep.add(np.abs(picture).max(), 0.0, 0.0, f"blend {blend:g}, radius {radius:g}")
    return sweep.outcome()


@case(
    "spot of 180 degrees",
    "lights",
    "A cone that is half of space: a point light below it (intensity cos / d^2), nothing above it; and with a soft "
    "edge the smooth step of the cosine.",
    "The smooth step and the cosine are products, quotients and roots of cosines, the third power of which is taken: "
    "4 times the 64 roundings of a sample. Surfaces behind the light are black to the bit.",
    quick=True,
)
def spot_of_half_of_space(bench: Bench) -> Outcome:
    """Sweep over positions and blends."""
    sweep = Sweep()
    for x in (0.0, 1.0, 30.0):
        for blend in (0.0, 1.0):
            light = Light("spot", LightKind.SPOT, scenes.translation(x, 0, 1), (5.0,) * 3, angle=math.pi, blend=blend)
            distance = math.hypot(x, 1)
            step = min(1 / distance / blend, 1.0) if blend else 1.0
            expected = 5.0 * step * step * (3 - 2 * step) / distance**3 / math.pi
            add_mean(
                sweep,
                bench.render(floor_of(light, size=100), sample_count=4),
                expected,
                4 * ROUNDING,
                f"{x:g} beside, blend {blend:g}",
            )
    upwards = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1]], np.float32)
    light = Light("spot", LightKind.SPOT, upwards, (5.0,) * 3, angle=math.pi)
    sweep.add(bench.render(floor_of(light), sample_count=4).max(), 0.0, 0.0, "turned away")
    return sweep.outcome()


@case(
    "area light of spread 0 to 180 degrees",
    "lights",
    "A square light far wider than its height gives pi times its emission however narrow its spread; one of spread 0 "
    "is a beam.",
    f"{STATISTICS}; the light's edge, seen from its middle, is at 89.9 degrees, and leaves out (1e-3)^2; 64 "
    "roundings, and 4e-6 of the solid angle.",
)
def spreads(bench: Bench) -> Outcome:
    """Sweep over spreads."""
    sweep = Sweep()
    for spread in (0.0, 1e-8, 1e-6, 1e-3, 0.1, 1.0, 3.0, math.pi):
        light = Light(
            "area",
            LightKind.RECTANGLE,
            scenes.translation(0, 0, 1e-3),
            (2.0,) * 3,
            size=(2.0, 2.0),
            spread=spread,
            visibility=UNSEEN,
        )
        picture = bench.render(floor_of(light, size=1e-2), sample_count=2048)
        add_mean(sweep, picture, 2.0, ROUNDING + 5e-6, f"spread {spread:g}")
    return sweep.outcome()
