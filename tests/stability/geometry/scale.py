"""Scale and position: the same scene at any size, anywhere, and turned."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from raybatch_addon.core.scene.description import CameraKind, Frame, Light, LightKind, Mesh, Scene
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.lights.form_factors import square_form_factor
from tests.support import scenes

U = 2.0**-24  # unit roundoff of float32
SMALL = Frame(24, 24)
# Rounded operations of a path of 8 bounces, 40 a bounce, each with a relative error of U
SMOOTH = 8 * 40 * U
# Pictures may differ where a ray that runs by an edge passes on its other side. A point that is moved by 2 U of the
# scene's extent carries the ray over with the probability 2 U times the length of all outlines over the area that they
# are seen in, below 50 here. A picture of `SMALL` has 9,216 paths of some 12 rays: 0.66 such rays are expected, and
# more than 6 with a probability below 1e-5 (Poisson).
FLIPS = 6
FAR = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
GRID = 8.0  # spacing of float32 up to 2^27 = 1.3e8 [m]


def carried(scene: Scene, matrix: np.ndarray, offset=(0.0, 0.0, 0.0)) -> Scene:
    """`scene` with its camera and lights under a similarity.

    `matrix` is a rotation times a scale, float64 [3, 3]; then `offset` [m] is added. Intensities of point lights grow
    with the scale's square, so that the picture stays.
    """
    scale, offset = float(np.cbrt(np.linalg.det(matrix))), np.asarray(offset, np.float64)

    def placed(transform: np.ndarray, linear: np.ndarray) -> np.ndarray:
        transform = np.asarray(transform, np.float64)
        moved = np.einsum("ij,...j->...i", matrix, transform[..., 3]) + offset
        return np.concatenate([linear @ transform[..., :3], moved[..., None]], -1).astype(np.float32)

    camera, instances = scene.camera, scene.instances
    window = camera.window if camera.kind == CameraKind.PERSPECTIVE else tuple(scale * edge for edge in camera.window)
    return dataclasses.replace(
        scene,
        camera=dataclasses.replace(
            camera,
            transform=placed(camera.transform, matrix / scale),
            window=window,
            clip_start=scale * camera.clip_start,
            clip_end=scale * camera.clip_end,
            lens_radius=scale * camera.lens_radius,
            focus_distance=scale * camera.focus_distance,
        ),
        instances=dataclasses.replace(instances, transform=placed(instances.transform, matrix)),
        lights=tuple(_carried_light(light, placed(light.transform, matrix / scale), scale) for light in scene.lights),
    )


def _carried_light(light: Light, transform: np.ndarray, scale: float) -> Light:
    brighter = scale**2 if light.kind in (LightKind.POINT, LightKind.SPOT) else 1.0
    return dataclasses.replace(
        light,
        transform=transform,
        radius=scale * light.radius,
        size=tuple(scale * edge for edge in light.size),
        emission=tuple(brighter * value for value in light.emission),
    )


def scaled(scene: Scene, scale: float) -> Scene:
    """`scene` scaled by a factor."""
    return carried(scene, scale * np.eye(3))


def moved(scene: Scene, *offset: float) -> Scene:
    """`scene` moved together with its camera [m]."""
    return carried(scene, np.eye(3), offset)


def turned(scene: Scene, angle: float) -> Scene:
    """`scene` rotated by `angle` [rad] about an axis that is no axis of any object."""
    x, y, z = np.array([0.36, 0.48, 0.8])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return carried(scene, np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def room(point_light: bool = False) -> Scene:
    """A ball and a box on a floor below a lamp of triangles and an area light, in a grey world.

    All is diffuse, so that no bounce enlarges errors.
    """
    lights = [scenes.area_light(4.0, 0.8, scenes.translation(-1, -0.5, 2.5))]
    if point_light:
        lights = [Light("point", LightKind.POINT, scenes.translation(0.7, -1.1, 1.9), (3.0, 2.0, 1.0))]
    return scenes.scene(
        [
            (scenes.plane("floor", 6), scenes.translation(0, 0, -1), scenes.diffuse((0.7, 0.6, 0.5))),
            (scenes.sphere("ball", 20, 10), scenes.translation(-0.8, 0.2, -0.1, 0.9), scenes.diffuse(0.8)),
            (scenes.box("box", 0.9), scenes.translation(0.9, -0.4, -0.5), scenes.diffuse((0.3, 0.5, 0.8))),
            (scenes.plane("lamp", 0.7), scenes.translation(0.8, 0.9, 1.7), scenes.emitter(5.0)),
        ],
        view=scenes.camera(eye=(0.3, -4.5, 1.1), target=(0, 0, -0.3), half_width=0.42),
        frame=SMALL,
        lights=lights,
        world=0.3,
    )


def _differing(picture: np.ndarray, reference: np.ndarray) -> int:
    """Number of pixels that differ by more than roundings explain."""
    return int((np.abs(picture - reference) > SMOOTH * np.maximum(picture, reference)).any(-1).sum())


def _invariance(bench: Bench, scene: Scene, others: dict[str, Scene]) -> Outcome:
    sweep, reference = Sweep(), bench.render(scene)
    for name, other in others.items():
        sweep.add(
            _differing(bench.render(other), reference),
            0,
            FLIPS,
            f"{name}; pixels of {reference.shape[0] * reference.shape[1]}",
        )
    return sweep.outcome()


_FLIPS_BOUND = """pixels that differ by more than 320 roundings of float32. Points are rounded to 2^-24 of their
coordinates, so that 0.7 of the 110,000 rays are expected to pass an edge on its other side; 6 are allowed
(probability below 1e-5)"""


@case(
    "size by powers of two",
    "scale",
    "A room at 2^-30 to 2^30 of its size (1e-9 to 1e9): every bit of the picture stays.",
    "multiplying by a power of two is exact, and every formula is homogeneous in lengths: no pixel may differ",
    quick=True,
)
def powers_of_two(bench: Bench) -> Outcome:
    sweep, reference = Sweep(), bench.render(room())
    for exponent in (-30, -21, -10, 10, 21, 30):
        differs = (bench.render(scaled(room(), 2.0**exponent)) != reference).any(-1).sum()
        sweep.add(differs, 0, 0, f"2^{exponent}; pixels")
    return sweep.outcome()


@case("size by powers of ten", "scale", "A room at 1e-9 to 1e9 of its size: the picture stays.", _FLIPS_BOUND)
def powers_of_ten(bench: Bench) -> Outcome:
    return _invariance(bench, room(), {f"1e{k}": scaled(room(), 10.0**k) for k in (-9, -7, -5, -3, -1, 1, 3, 5, 7, 9)})


@case(
    "units and point lights",
    "scale",
    "A room with a point light in inches, feet, miles, millimetres and light seconds, the light's power in proportion "
    "to the square: the picture stays.",
    _FLIPS_BOUND,
)
def units(bench: Bench) -> Outcome:
    lengths = {"inches": 0.0254, "feet": 0.3048, "miles": 1609.344, "millimetres": 1e-3, "light seconds": 299_792_458.0}
    return _invariance(bench, room(True), {name: scaled(room(True), 1 / length) for name, length in lengths.items()})


@case(
    "turned",
    "scale",
    "A room and its camera turned about a general axis: the picture's mean stays. (Random directions about a normal "
    "change.)",
    "5 standard errors (Student) of either mean, of 6 seeds",
)
def turned_room(bench: Bench) -> Outcome:
    sweep, (expected, expected_error) = Sweep(), mean_of_seeds(bench, room())
    for angle in (1e-4, 0.5, 2.0, 3.1):
        mean, error = mean_of_seeds(bench, turned(room(), angle))
        sweep.add(mean, expected, math.hypot(error, expected_error), f"{angle} rad")
    return sweep.outcome()


def _floor_below_lamp(size: float, height: float, far: float = 0.0, floor: float = 4.0) -> Scene:
    """A white floor below a square lamp, `size` wide and at a `height` [m] above it.

    It is seen closely, from `height`/2 aside of the centre, and all is moved `far` away.
    """
    view = scenes.camera(eye=(0, -height / 2, height / 2), target=(0, 0, 0), half_width=2**-10)
    light = scenes.area_light(3.0, size, scenes.translation(0, 0, height))
    scene = scenes.scene(
        [(scenes.plane(size=floor * height), scenes.IDENTITY, scenes.diffuse(1.0))],
        view=view,
        frame=Frame(8, 8),
        lights=[light],
    )
    return moved(scene, far, -far, far) if far else scene


def mean_of_seeds(bench: Bench, scene: Scene, seeds: int = 6, **change) -> tuple[float, float]:
    """Mean of the picture, and four standard errors of it, from independent seeds.

    The factor of the error is that of Student's distribution.
    """
    means = bench.render_seeds(scene, seeds, **({"sample_count": 128} | change)).mean((1, 2, 3))
    # two-sided 2e-4 with five degrees of freedom
    return float(means.mean()), 9.7 * float(means.std(ddof=1)) / math.sqrt(seeds)


@case(
    "lamp over a floor at any size",
    "scale",
    "Radiance of a white floor below the middle of a square lamp, all of it at 1e-16 to 1e16 of its size, against the "
    "closed form (form factor of a square).",
    "5 standard errors (Student) of 6 seeds, and the roundings of one bounce: 40 of 2^-24",
)
def lamp_at_any_size(bench: Bench) -> Outcome:
    sweep, expected = Sweep(), 3.0 * square_form_factor(0.7, 1.0)
    for k in (-16, -12, -9, -3, 0, 3, 9, 12, 16):
        mean, error = mean_of_seeds(bench, scaled(_floor_below_lamp(1.4, 1.0), 10.0**k), bounce_max=0)
        sweep.add(mean, expected, error + 40 * U * expected, f"1e{k}")
    return sweep.outcome()


@case(
    "far hits keep their bits",
    "scale",
    """Rays in a room 1 km wide with all corners and origins on multiples of 8 m, moved 1e3 to 1e8 m away: the triangle
    test sees corners relative to the ray's origin, which are the same exact numbers, so that no distance and no
    triangle changes. Measured: rays for which one does.""",
    "differences of float32 that can be represented are exact: none may change",
    quick=True,
)
def far_hits(bench: Bench) -> Outcome:
    generator = np.random.default_rng(5)
    positions = np.round(generator.uniform(-60, 60, (600, 3))) * GRID
    triangles = np.arange(600, dtype=np.int32).reshape(-1, 3)
    origins = np.round(generator.uniform(-50, 50, (20_000, 3))) * GRID
    directions = generator.normal(size=origins.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def hits(offset: float):
        mesh = Mesh("triangles", (positions + offset).astype(np.float32), triangles)
        return bench.trace(
            scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse(0.5))], world=1.0), origins + offset, directions
        )

    here, sweep = hits(0.0), Sweep()
    for far in FAR:
        there = hits(GRID * round(far / GRID))
        sweep.add(
            ((there.t != here.t) | (there.primitive != here.primitive)).sum(),
            0,
            0,
            f"{far:g} m; rays, of {here.hit.sum()} that hit",
        )
    return sweep.outcome()


@case(
    "lamp over a floor far away",
    "scale",
    """Radiance of a white floor below the middle of a square lamp 512 m above it, with the camera 1e3 to 1e8 m from the
    origin in each axis, against the closed form.""",
    """5 standard errors (Student); and positions: a point is known to 2^-24 of its coordinates D in each axis, the
    lamp as well; it is moved off the surface by no more than that bound and an ulp, 6 D 2^-24 in all, of the height
    h, to the square of which irradiance is reciprocal: 3 x 6 D 2^-24 / h""",
)
def far_lamp(bench: Bench) -> Outcome:
    sweep, height = Sweep(), 512.0
    expected = 3.0 * square_form_factor(256.0, height)
    for far in FAR:
        far = GRID * round(far / GRID)
        mean, error = mean_of_seeds(bench, _floor_below_lamp(512.0, height, far), bounce_max=0)
        sweep.add(mean, expected, error + 3 * 6 * far * U / height * expected, f"{far:g} m")
    return sweep.outcome()


def _ball_in_white(radius: float, far: float) -> Scene:
    ball = (scenes.sphere("ball", 24, 12), scenes.translation(0, 0, 0, radius), scenes.diffuse(1.0))
    floor = (scenes.plane("floor", 8 * radius), scenes.translation(0, 0, -1.5 * radius), scenes.diffuse(1.0))
    view = scenes.camera(eye=(0, -4 * radius, radius), half_width=0.5)
    return moved(scenes.scene([ball, floor], view=view, frame=Frame(16, 16), world=1.0), far, far, -far)


@case(
    "white furnace far away",
    "scale",
    """A white ball of 64 m above a white floor in a white world, 1e3 to 1e8 m from the origin: every pixel is 1
    wherever roundings put corners (8 m apart at 1e8 m), unless rays are trapped in a surface. Measured: the pixel
    farthest off.""",
    """a bounce multiplies throughput by albedo 1 with 4 roundings: 4 x 64 x 2^-24. A path of the open scene is
    longer than 64 bounces with a probability below 1e-12""",
    quick=True,
)
def far_furnace(bench: Bench) -> Outcome:
    sweep = Sweep()
    for far in FAR:
        picture = bench.render(_ball_in_white(64.0, far), nee="OFF", bounce_max=64, roulette_bounce=64)
        sweep.add(picture.flat[np.abs(picture - 1).argmax()], 1, 4 * 64 * U, f"{far:g} m")
    return sweep.outcome()


@case(
    "convex bodies do not meet themselves",
    "scale",
    """A grey ball of flat facets (albedo 1/2) in a white world, from 1e-6 m to 1e6 m large, at the origin and up to 1e5
    of its radii away: as no ray that leaves it comes back, every pixel in it is 1/2. A ray that hit the facet that it
    left, or the next one, would make it 1/4.""",
    """the product of two numbers, rounded: 4 x 2^-24. The ray's origin is moved outside the box of its point's possible
    positions""",
    quick=True,
)
def convex_bodies(bench: Bench) -> Outcome:
    sweep = Sweep()
    for radius in (1e-6, 1.0, 1e6):
        for away in (0.0, 1e2, 1e4, 1e5):
            ball = (scenes.sphere("ball", 36, 18), scenes.translation(0, 0, 0, radius), scenes.diffuse(0.5))
            view = scenes.camera(eye=(0, -4 * radius, radius), half_width=0.1)
            scene = moved(
                scenes.scene([ball], view=view, frame=Frame(32, 32), world=1.0),
                radius * away,
                -radius * away,
                radius * away,
            )
            picture = bench.render(scene, nee="OFF", pixel_filter="BOX")
            sweep.add(picture.flat[np.abs(picture - 0.5).argmax()], 0.5, 4 * U, f"{radius:g} m, {away:g} radii away")
    return sweep.outcome()
