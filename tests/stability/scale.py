"""Scale and place: the same scene at any size, anywhere, turned, and with small things beside large ones."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import scenes

from raybatch_addon.core.scene.description import CameraKind, Frame, Light, LightKind, Mesh, Scene

from .bench import Bench
from .case import Outcome, Skipped, Sweep, case
from .form_factors import sphere_form_factor, square_form_factor

U = 2.0**-24  # unit roundoff of float32
SMALL = Frame(24, 24)
# Rounded operations on the way of a path of 8 bounces, 40 a bounce, each by a relative error of U
SMOOTH = 8 * 40 * U
# Pictures may differ where a ray that runs by an edge passes on its other side. A place that is moved by 2 U of the scene's extent
# carries it over with the probability 2 U times the length of all outlines over the area that they are seen in, below 50 here. A picture
# of `SMALL` has 9,216 paths of some 12 rays: 0.66 such rays are expected, and more than 6 with a probability below 1e-5 (Poisson).
FLIPS = 6
FAR = (1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
GRID = 8.0  # spacing of float32 up to 2^27 = 1.3e8 [m]


def carried(scene: Scene, matrix: np.ndarray, offset=(0.0, 0.0, 0.0)) -> Scene:
    """`scene` with its camera and lights under a similarity: `matrix` a rotation times a scale, float64 [3, 3], then `offset` [m].

    Intensities of point lights grow with the scale's square, so that the picture stays."""
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
            camera, transform=placed(camera.transform, matrix / scale), window=window, clip_start=scale * camera.clip_start,
            clip_end=scale * camera.clip_end, lens_radius=scale * camera.lens_radius, focus_distance=scale * camera.focus_distance,
        ),
        instances=dataclasses.replace(instances, transform=placed(instances.transform, matrix)),
        lights=tuple(_carried_light(light, placed(light.transform, matrix / scale), scale) for light in scene.lights),
    )  # fmt: skip


def _carried_light(light: Light, transform: np.ndarray, scale: float) -> Light:
    brighter = scale**2 if light.kind in (LightKind.POINT, LightKind.SPOT) else 1.0
    return dataclasses.replace(
        light, transform=transform, radius=scale * light.radius, size=tuple(scale * edge for edge in light.size),
        emission=tuple(brighter * value for value in light.emission),
    )  # fmt: skip


def scaled(scene: Scene, scale: float) -> Scene:
    """`scene` so many times as large."""
    return carried(scene, scale * np.eye(3))


def moved(scene: Scene, *offset: float) -> Scene:
    """`scene` with its camera elsewhere."""
    return carried(scene, np.eye(3), offset)


def turned(scene: Scene, angle: float) -> Scene:
    """`scene` about an axis that is no axis of anything [rad]."""
    x, y, z = np.array([0.36, 0.48, 0.8])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return carried(scene, np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def room(point_light: bool = False) -> Scene:
    """A ball and a box on a floor below a lamp of triangles and an area light, in a grey world: diffuse, so that no bounce enlarges errors."""
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
        view=scenes.camera(eye=(0.3, -4.5, 1.1), target=(0, 0, -0.3), half_width=0.42), frame=SMALL, lights=lights, world=0.3,
    )  # fmt: skip


def _differing(picture: np.ndarray, reference: np.ndarray) -> int:
    """Pixels that differ by more than roundings explain."""
    return int((np.abs(picture - reference) > SMOOTH * np.maximum(picture, reference)).any(-1).sum())


def _invariance(bench: Bench, scene: Scene, others: dict[str, Scene]) -> Outcome:
    sweep, reference = Sweep(), bench.render(scene)
    for name, other in others.items():
        sweep.add(_differing(bench.render(other), reference), 0, FLIPS, f"{name}; pixels of {reference.shape[0] * reference.shape[1]}")
    return sweep.outcome()


_FLIPS_BOUND = """pixels that differ by more than 320 roundings of float32. Places are rounded to 2^-24 of their coordinates, so that 0.7 of the
    110,000 rays are expected to pass an edge on its other side; 6 are allowed (probability below 1e-5)"""


@case(
    "size by powers of two", "scale",
    "A room at 2^-30 to 2^30 of its size (1e-9 to 1e9): every bit of the picture stays.",
    "multiplying by a power of two is exact, and every formula is homogeneous in lengths: no pixel may differ",
    quick=True,
)  # fmt: skip
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
    "units and point lights", "scale",
    "A room with a point light in inches, feet, miles, millimetres and light seconds, the light's power in proportion to the square: the picture stays.",
    _FLIPS_BOUND,
)  # fmt: skip
def units(bench: Bench) -> Outcome:
    lengths = {"inches": 0.0254, "feet": 0.3048, "miles": 1609.344, "millimetres": 1e-3, "light seconds": 299_792_458.0}
    return _invariance(bench, room(True), {name: scaled(room(True), 1 / length) for name, length in lengths.items()})


@case(
    "turned", "scale",
    "A room with its camera turned about an axis in no plane of it: the picture's mean stays. (Directions about a normal are other ones.)",
    "5 standard errors (Student) of either mean, of 6 seeds",
)  # fmt: skip
def turned_room(bench: Bench) -> Outcome:
    sweep, (expected, expected_error) = Sweep(), _mean(bench, room())
    for angle in (1e-4, 0.5, 2.0, 3.1):
        mean, error = _mean(bench, turned(room(), angle))
        sweep.add(mean, expected, math.hypot(error, expected_error), f"{angle} rad")
    return sweep.outcome()


def _floor_below_lamp(size: float, height: float, far: float = 0.0, floor: float = 4.0) -> Scene:
    """A white floor below a square lamp, `size` wide, so high above it [m], seen closely from `height`/2 beside the centre, moved `far` away."""
    view = scenes.camera(eye=(0, -height / 2, height / 2), target=(0, 0, 0), half_width=2**-10)
    light = scenes.area_light(3.0, size, scenes.translation(0, 0, height))
    scene = scenes.scene(
        [(scenes.plane(size=floor * height), scenes.IDENTITY, scenes.diffuse(1.0))], view=view, frame=Frame(8, 8), lights=[light]
    )
    return moved(scene, far, -far, far) if far else scene


def _mean(bench: Bench, scene: Scene, seeds: int = 6, **change) -> tuple[float, float]:
    """Mean of the picture, and four standard errors of it, from independent seeds; the factor is that of Student's distribution."""
    means = bench.render_seeds(scene, seeds, **({"sample_count": 128} | change)).mean((1, 2, 3))
    return float(means.mean()), 9.7 * float(means.std(ddof=1)) / math.sqrt(seeds)  # two-sided 2e-4 with five degrees of freedom


@case(
    "lamp over a floor at any size", "scale",
    "Radiance of a white floor below the middle of a square lamp, all of it at 1e-16 to 1e16 of its size, against the closed form (form factor of a square).",
    "5 standard errors (Student) of 6 seeds, and the roundings of one bounce: 40 of 2^-24",
)  # fmt: skip
def lamp_at_any_size(bench: Bench) -> Outcome:
    sweep, expected = Sweep(), 3.0 * square_form_factor(0.7, 1.0)
    for k in (-16, -12, -9, -3, 0, 3, 9, 12, 16):
        mean, error = _mean(bench, scaled(_floor_below_lamp(1.4, 1.0), 10.0**k), bounce_max=0)
        sweep.add(mean, expected, error + 40 * U * expected, f"1e{k}")
    return sweep.outcome()


@case(
    "far hits keep their bits", "scale",
    """Rays in a room 1 km wide with all corners and origins on multiples of 8 m, moved 1e3 to 1e8 m away: the triangle test sees corners
    relative to the ray's origin, which are the same exact numbers, so that no distance and no triangle changes; rays that do.""",
    "differences of float32 that can be represented are exact: none may change",
    quick=True,
)  # fmt: skip
def far_hits(bench: Bench) -> Outcome:
    generator = np.random.default_rng(5)
    positions = np.round(generator.uniform(-60, 60, (600, 3))) * GRID
    triangles = np.arange(600, dtype=np.int32).reshape(-1, 3)
    origins = np.round(generator.uniform(-50, 50, (20_000, 3))) * GRID
    directions = generator.normal(size=origins.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def hits(offset: float):
        mesh = Mesh("triangles", (positions + offset).astype(np.float32), triangles)
        return bench.trace(scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse(0.5))], world=1.0), origins + offset, directions)

    here, sweep = hits(0.0), Sweep()
    for far in FAR:
        there = hits(GRID * round(far / GRID))
        sweep.add(((there.t != here.t) | (there.primitive != here.primitive)).sum(), 0, 0, f"{far:g} m; rays, of {here.hit.sum()} that hit")
    return sweep.outcome()


@case(
    "lamp over a floor far away", "scale",
    """Radiance of a white floor below the middle of a square lamp 512 m above it, with the camera 1e3 to 1e8 m from the origin in each axis,
    against the closed form.""",
    """5 standard errors (Student); and places: a point is known to 2^-24 of its coordinates D in each axis, the lamp as well; it is moved
    off the surface by no more than that bound and an ulp, 6 D 2^-24 in all, of the height h, to the square of which irradiance is
    reciprocal: 3 x 6 D 2^-24 / h""",
)  # fmt: skip
def far_lamp(bench: Bench) -> Outcome:
    sweep, height = Sweep(), 512.0
    expected = 3.0 * square_form_factor(256.0, height)
    for far in FAR:
        far = GRID * round(far / GRID)
        mean, error = _mean(bench, _floor_below_lamp(512.0, height, far), bounce_max=0)
        sweep.add(mean, expected, error + 3 * 6 * far * U / height * expected, f"{far:g} m")
    return sweep.outcome()


def _ball_in_white(radius: float, far: float) -> Scene:
    ball = (scenes.sphere("ball", 24, 12), scenes.translation(0, 0, 0, radius), scenes.diffuse(1.0))
    floor = (scenes.plane("floor", 8 * radius), scenes.translation(0, 0, -1.5 * radius), scenes.diffuse(1.0))
    view = scenes.camera(eye=(0, -4 * radius, radius), half_width=0.5)
    return moved(scenes.scene([ball, floor], view=view, frame=Frame(16, 16), world=1.0), far, far, -far)


@case(
    "white furnace far away", "scale",
    """A white ball of 64 m above a white floor in a white world, 1e3 to 1e8 m from the origin: every pixel is 1 wherever roundings put
    corners (8 m apart at 1e8 m), unless rays are trapped in a surface. The pixel farthest off.""",
    """a bounce multiplies throughput by albedo 1 with 4 roundings: 4 x 64 x 2^-24. A path of the open scene is not done after 64 bounces
    with a probability below 1e-12""",
    quick=True,
)  # fmt: skip
def far_furnace(bench: Bench) -> Outcome:
    sweep = Sweep()
    for far in FAR:
        picture = bench.render(_ball_in_white(64.0, far), nee="OFF", bounce_max=64, roulette_bounce=64)
        sweep.add(picture.flat[np.abs(picture - 1).argmax()], 1, 4 * 64 * U, f"{far:g} m")
    return sweep.outcome()


@case(
    "convex bodies do not meet themselves", "scale",
    """A grey ball of flat facets (albedo 1/2) in a white world, from 1e-6 m to 1e6 m large, at the origin and up to 1e5 of its radii away: as no ray
    that leaves it comes back, every pixel in it is 1/2. A ray that met the facet that it left, or the next one, would make it 1/4.""",
    """the product of two numbers, rounded: 4 x 2^-24. The ray's origin is moved outside the box of places where its point may be""",
    quick=True,
)  # fmt: skip
def convex_bodies(bench: Bench) -> Outcome:
    sweep = Sweep()
    for radius in (1e-6, 1.0, 1e6):
        for away in (0.0, 1e2, 1e4, 1e5):
            ball = (scenes.sphere("ball", 36, 18), scenes.translation(0, 0, 0, radius), scenes.diffuse(0.5))
            view = scenes.camera(eye=(0, -4 * radius, radius), half_width=0.1)
            scene = moved(scenes.scene([ball], view=view, frame=Frame(32, 32), world=1.0), radius * away, -radius * away, radius * away)
            picture = bench.render(scene, nee="OFF", pixel_filter="BOX")
            sweep.add(picture.flat[np.abs(picture - 0.5).argmax()], 0.5, 4 * U, f"{radius:g} m, {away:g} radii away")
    return sweep.outcome()


def graded_plane(half: float, least: float) -> Mesh:
    """A square in z = 0 whose cells grow from the middle, where they are `least` wide, to the rim at `half` [m]."""
    steps = least * 2.0 ** np.arange(math.ceil(math.log2(half / least)))
    axis = np.concatenate([-steps[::-1], [0.0], steps, [half]])
    axis = np.concatenate([[-half], axis]) if axis[0] > -half else axis
    axis = np.unique(axis)
    n = len(axis)
    positions = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((n, n))], -1).reshape(-1, 3)
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([corner, corner + n, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + 1], 1)])
    return Mesh("graded plane", positions.astype(np.float32), triangles.astype(np.int32))


def _shaded_floor(floor: Mesh, radius: float) -> Scene:
    """A white floor below a black ball, two radii above it, in a white world, seen closely two radii beside the point below the ball."""
    ball = scenes.sphere("ball", 96, 48, smooth=False)
    aim = np.array([2 * radius, 0, 0])
    view = scenes.camera(eye=(2 * radius, -1.5 * radius, 1.5 * radius), target=aim, half_width=2**-10)
    black = scenes.material(name="black")
    return scenes.scene(
        [(floor, scenes.IDENTITY, scenes.diffuse(1.0)), (ball, scenes.translation(0, 0, 2 * radius, radius), black)], view=view, frame=Frame(8, 8), world=1.0
    )


# A ball of 96 x 48 flat quads is inside the sphere: its silhouette is smaller by the mean of both directions, in radius
FACETS = (math.pi / 96) ** 2 / 2 + (math.pi / 96) ** 2 / 2


def _shade(bench: Bench, floor: Mesh, radius: float, lift: float, note: str) -> Outcome:
    blocked = sphere_form_factor(radius, 2 * radius, 2 * radius)
    mean, error = _mean(bench, _shaded_floor(floor, radius), sample_count=1024, bounce_max=1)
    return Outcome(mean, 1 - blocked, error + blocked * (2 * FACETS + 3 * lift / radius), note)


@case(
    "a 1 mm ball over a plane of 1e7 m", "scale",
    """A black ball of 1 mm over a white plane of 1e7 m whose cells grow from 0.1 mm in the middle: the radiance of the plane beside the ball in
    a white world, against 1 minus the ball's form factor.""",
    """5 standard errors (Student); the ball's facets (2 pi^2 / 96^2 of the form factor); the point is moved off the plane by 25 x 2^-24 of its
    triangle, which is no larger than the ball""",
)  # fmt: skip
def small_over_large(bench: Bench) -> Outcome:
    return _shade(bench, graded_plane(5e6, 1e-4), 0.5e-3, 32 * U * 1e-3, "")


@case(
    "a teapot in a stadium", "scale",
    """A black ball of 20 cm over the floor of a stadium of 200 m that is one square: the radiance of the floor beside the ball in a white
    world, against 1 minus the ball's form factor.""",
    """5 standard errors (Student); the ball's facets (2 pi^2 / 96^2 of the form factor); the point is moved off the floor by the error of
    a test of its triangle, 25 x 2^-24 times 200 m, and a rounding, of a ball of 0.1 m radius: 3 times that ratio of the form factor""",
)  # fmt: skip
def teapot_in_a_stadium(bench: Bench) -> Outcome:
    return _shade(bench, scenes.plane("stadium", 200.0), 0.1, 26 * U * 200, "")


@case(
    "a thing on a square of 1e7 m", "scale",
    """A white ball of 1 mm, 2 mm above a white plane of 1e7 m that is one square, in a white world, from straight above: every pixel is 1, and the
    ball covers its share of the frame (its depth is told apart from the plane's).""",
    """share of the frame: pi r^2 / w^2 as the ball is seen by an orthographic camera, less its facets; 5 standard errors of a binomial share.
    No pixel's radiance may differ from 1 by more than 4 roundings a bounce""",
)  # fmt: skip
def thing_on_a_square(bench: Bench) -> Outcome:
    radius, half = 0.5e-3, 1e-3
    ball = (scenes.sphere("ball", 96, 48), scenes.translation(0, 0, 2e-3, radius), scenes.diffuse(1.0))
    view = scenes.camera(eye=(0, 0, 5e-3), target=(0, 0, 0), half_width=half, up=(0, 1, 0))
    view = dataclasses.replace(view, kind=CameraKind.ORTHOGRAPHIC)
    scene = scenes.scene([(scenes.plane("plane", 1e7), scenes.IDENTITY, scenes.diffuse(1.0)), ball], view=view, world=1.0, frame=Frame(48, 48))
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=("Combined", "Depth")))
    film = bench.film(scene, nee="OFF", bounce_max=32, roulette_bounce=32, pixel_filter="BOX")
    off = np.abs(film.passes["Combined"][..., :3].astype(np.float64) - 1).max()
    depth, pixels = film.passes["Depth"][..., 0].astype(np.float64), 48 * 48
    covered, expected = (depth < 4e-3).mean(), math.pi * radius**2 / (2 * half) ** 2
    if off > 4 * 32 * U:
        return Outcome(1 + off, 1, 4 * 32 * U, "radiance")
    if not np.allclose(depth[depth >= 4e-3], 5e-3, rtol=16 * U, atol=0):
        return Outcome(float(np.abs(depth[depth >= 4e-3] - 5e-3).max()), 0, 16 * U * 5e-3, "depth of the plane")
    return Outcome(covered, expected, 5 * math.sqrt(expected * (1 - expected) / pixels) + 2 * FACETS * expected, "share of the frame")


@case(
    "through a telescope", "scale",
    """Glowing squares 1e2 to 1e8 m away that fill a quarter of a narrow frame, 16,384 times smaller than their distance: the mean of the picture
    is a quarter.""",
    """5 standard errors (Student) of points inside a square by stratified samples; a direction of float32 is known to 2^-24, and so is an edge:
    4 x 2^-24 x 16,384 of the share""",
)  # fmt: skip
def telescope(bench: Bench) -> Outcome:
    sweep = Sweep()
    for far in (1e2, 1e4, 1e6, 1e8):
        square = (scenes.plane("square", far / 16384), scenes.IDENTITY, scenes.emitter(1.0))
        view = scenes.camera(eye=(0, 0, far), target=(0, 0, 0), half_width=1 / 16384, up=(0, 1, 0))
        scene = scenes.scene([square], view=view, frame=Frame(16, 16))
        mean, error = _mean(bench, scene, pixel_filter="BOX", bounce_max=0)
        sweep.add(mean, 0.25, error + 0.25 * 16 * U * 16384, f"{far:g} m")
    return sweep.outcome()


def _scene_file(name: str) -> Path:
    """A file of the folder RAYBATCH_SCENES; raises `Skipped` without it."""
    folder = os.environ.get("RAYBATCH_SCENES")
    if not folder or not (Path(folder) / name).is_file():
        raise Skipped(f"set RAYBATCH_SCENES to a folder that holds {name}")
    return Path(folder) / name


@case(
    "hotel room", "scale",
    """The room of hotel_room.npz as it is, with coordinates near 10,000, from a place inside it and in a white world, against the same room
    moved to the origin by whole steps of float32, which is exact: share of rays from the place whose distance differs by more than the bound.""",
    "corners relative to the ray's origin are exact in both: distances are those of the same numbers, and none may differ",
)  # fmt: skip
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
        bench.trace(scenes.scene([(mesh, scenes.IDENTITY, scenes.diffuse(0.5))], world=1.0), np.broadcast_to(origin, directions.shape), directions)
        for mesh, origin in ((here, centre), (there, centre - centre))
    ]
    differs = (found[0].t != found[1].t) | (found[0].primitive != found[1].primitive)
    return Outcome(float(differs.sum()), 0, 0, f"rays, of {found[0].hit.sum():,} that hit")
