"""Transport: light over thousands of bounces, with and without roulette."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from raybatch_addon.core.scene.description import Camera, CameraKind, Frame, Material, Scene
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.enclosures import (
    FEW,
    MANY,
    SCATTERED,
    add_exact,
    add_relative,
    facing_down,
    glass,
    icosphere_mesh,
    lamp,
    mirror,
    stretched,
    turned_askew,
    wall,
)
from tests.stability.uniform import SIGMAS, UNIT_ROUNDOFF, add_mean, mean_and_error
from tests.support import scenes

U = UNIT_ROUNDOFF
SPACING = 8.0  # distance between closed meshes in a row [m]
EXACT = (
    "a white path carries 1 to the bit, and sums of whole numbers below 2^24 are exact in float32: nothing may be "
    "lost or added"
)


def _inside(mesh, matrix, material: Material, frame=FEW, half_width: float = 0.8) -> Scene:
    """A closed mesh around the camera."""
    view = scenes.camera(eye=(0.1, -0.2, 0.05), target=(0.3, 0.8, 0.2), half_width=half_width)
    return scenes.scene([(mesh, matrix, material)], frame=frame, view=view)


def _closed_meshes(material: Material) -> Scene:
    """Three closed meshes.

    Each of three pixels begins its paths in the middle of one, in a direction along no axis.
    """
    ahead = np.array([0.3, 0.8, 0.2])
    view = scenes.look_at((0, 0, 0), ahead)
    meshes = (
        (scenes.box("box"), scenes.IDENTITY),
        (icosphere_mesh(1), scenes.IDENTITY),
        (scenes.box("askew"), turned_askew()),
    )
    objects = []
    for index, (mesh, matrix) in enumerate(meshes):
        matrix = matrix.copy()
        matrix[:, 3] += SPACING * (index - 1) * view[:, 0]
        objects.append((mesh, matrix, material))
    half = 1.5 * SPACING
    camera = Camera(CameraKind.ORTHOGRAPHIC, view, (-half, half, -SPACING / 2, SPACING / 2))
    return scenes.scene(objects, frame=Frame(3, 1), view=camera)


def _add_trapped(sweep: Sweep, bench: Bench, material: Material) -> None:
    picture = bench.render(_closed_meshes(material), SCATTERED, pixel_filter="GAUSSIAN", filter_width=0.05)
    for index, name in enumerate(("box", "icosphere", "sheared and mirrored box")):
        add_exact(sweep, picture[:, index], SCATTERED.bounce_max + 2, name)


@case(
    "white boxes",
    "transport",
    """Paths of 10,000 bounces inside a box, an icosphere and a sheared, mirrored box, all closed and white, that emit
    1: each surface met adds 1, 10,002 in all, with roulette from the first bounce. A ray that escapes is missing from
    then on.""",
    EXACT,
)
def white_boxes(bench: Bench) -> Outcome:
    sweep = Sweep()
    _add_trapped(sweep, bench, wall(1.0, 1.0))
    return sweep.outcome()


@case(
    "mirror boxes", "transport", "As white boxes, but perfect mirrors: 10,000 reflections, 10,002 surfaces met.", EXACT
)
def mirror_boxes(bench: Bench) -> Outcome:
    sweep = Sweep()
    _add_trapped(sweep, bench, mirror(1.0, 1.0))
    return sweep.outcome()


def _cavity(lamp_size: float) -> Scene:
    """A closed white room with white, mirroring and glass objects in it; only the lamp absorbs."""
    ball = icosphere_mesh(2)
    return scenes.scene(
        [
            (scenes.box("room", 4), scenes.IDENTITY, wall()),
            (dataclasses.replace(ball, name="white"), stretched(0.5, 0.5, 0.5, (1.0, 1.0, -1.2)), wall()),
            (dataclasses.replace(ball, name="mirror"), stretched(0.6, 0.6, 0.6, (-1.0, 0.8, -0.5)), mirror()),
            (dataclasses.replace(ball, name="glass"), stretched(0.5, 0.5, 0.5, (0.1, 1.0, 0.4)), glass(1.5)),
            (scenes.plane("lamp", lamp_size), facing_down(1.5), lamp(0.75)),
        ],
        frame=MANY,
        view=scenes.camera(eye=(0.0, -1.8, 0.0), target=(0, 1, 0), half_width=0.7),
    )


@case(
    "cavity",
    "transport",
    """A closed white room with a white, a mirroring and a glass ball, and a lamp that absorbs: every path ends at the
    lamp, so every pixel shows the lamp's radiance of 0.75 (a cavity in equilibrium).""",
    "a path carries 1 to the bit until it meets the lamp, which it does with a probability of more than 1 % at a "
    "bounce: none is left after 10,000 (probability below e^-100)",
    quick=True,
)
def cavity(bench: Bench) -> Outcome:
    sweep = Sweep()
    add_exact(sweep, bench.render(_cavity(1.0), SCATTERED, sample_count=4), 0.75, "cavity")
    return sweep.outcome()


@case(
    "cavity with light sampling",
    "transport",
    "The same room with a larger lamp, and lights sampled directly: what both strategies find sums to the lamp's "
    "radiance of 0.75.",
    f"{SIGMAS:g} standard errors over 256 pixels, which are independent, and 400 roundings of a path",
)
def cavity_with_light_sampling(bench: Bench) -> Outcome:
    sweep = Sweep()
    add_mean(sweep, bench.render(_cavity(3.0), SCATTERED, nee="ON", sample_count=128), 0.75, 400 * U)
    return sweep.outcome()


def series(albedo, surfaces: float) -> np.ndarray:
    """Sum of albedo^k for k below `surfaces`, of the float32 albedo."""
    a = np.float64(np.float32(albedo))
    return (1 - a**surfaces) / (1 - a)


@case(
    "bounce limits",
    "transport",
    "Inside a closed box that emits 1 and reflects 0.5, 0.9 or 0.999, paths of 0 to 1000 bounces: (1 - a^(N + 2)) / (1 "
    "- a).",
    """the throughput at surface k was rounded 2 k times, and each sum once: 3 U of the sum at most for both, at every
    one of the n surfaces at which a^k is above U. The others add less than half a step of the sum, and are U of it
    together: 3 (n + 1) U""",
)
def bounce_limits(bench: Bench) -> Outcome:
    sweep = Sweep()
    for albedo, bounces in ((0.5, 0), (0.5, 1), (0.9, 7), (0.9, 100), (0.999, 1000)):
        scene = _inside(scenes.box(), scenes.IDENTITY, wall(albedo, 1.0))
        picture = bench.render(scene, SCATTERED, bounce_max=bounces, roulette_bounce=bounces + 1)
        expected = float(series(albedo, bounces + 2))
        # later products are smaller: the sum ends where a^k is below U
        terms = min(bounces + 2, math.log(U) / math.log(albedo))
        add_relative(sweep, picture, expected, 3 * (terms + 1) * U, f"albedo {albedo}, {bounces} bounces")
    return sweep.outcome()


COLOR = (0.95, 0.6, 0.2)


def _add_channels(sweep: Sweep, picture: np.ndarray, expected, note: str) -> None:
    """Compare the means of the three channels."""
    for c in range(3):
        add_mean(sweep, picture[..., c : c + 1], expected[c], 200 * U, f"{note}, channel {c}")


@case(
    "roulette",
    "transport",
    """Inside a closed box that emits 1 and reflects (0.95, 0.6, 0.2): with roulette from bounce 0, 1, 3 or 20, below
    several throughputs, and paths as long as it lets them be, radiance is 1 / (1 - a) in each channel.""",
    f"{SIGMAS:g} standard errors over pixels; 200 roundings; a path is longer than 10,000 bounces with a probability "
    "below 0.95^10000",
    quick=True,
)
def roulette(bench: Bench) -> Outcome:
    sweep = Sweep()
    expected = 1 / (1 - np.float64(np.float32(COLOR)))
    scene = _inside(scenes.box(), scenes.IDENTITY, wall(COLOR, 1.0), MANY)
    for first, below in ((0, 0.5), (1, 1.0), (3, 0.02), (20, 0.5)):
        _add_channels(
            sweep,
            bench.render(scene, SCATTERED, roulette_bounce=first, roulette_throughput=below, sample_count=128),
            expected,
            f"from bounce {first}, below {below}",
        )
    return sweep.outcome()


@case(
    "roulette of long paths",
    "transport",
    """Inside a closed box that emits 1 and reflects 0.995, one path a pixel: roulette below a throughput of 1 alone
    ends paths, after 200 bounces on average. Paths carry 1 until they end, so that a pixel's value is its path's
    length, which is geometric: a share a^k of them is longer than k.""",
    f"""{SIGMAS:g} standard errors: of the mean sqrt(a) / (1 - a) / sqrt(n), of a share p that is longer than k sqrt(p
    (1 - p) / n). The normal distribution is near enough, as more than 90 paths are on either side. Lengths are whole
    numbers, exact in float32""",
)
def roulette_of_long_paths(bench: Bench) -> Outcome:
    sweep, albedo, frame = Sweep(), float(np.float32(0.995)), Frame(96, 96)
    lengths = bench.render(
        _inside(scenes.box(), scenes.IDENTITY, wall(albedo, 1.0), frame),
        SCATTERED,
        bounce_max=100_000,
        roulette_throughput=1.0,
        tile_size=96,
    )[..., 0]
    sweep.add(
        lengths.mean(),
        1 / (1 - albedo),
        SIGMAS * math.sqrt(albedo) / (1 - albedo) / math.sqrt(lengths.size),
        "mean length",
    )
    for k in (2, 20, 50, 138, 300, 600, 900):
        share = albedo**k
        sweep.add(
            (lengths > k).mean(),
            share,
            SIGMAS * math.sqrt(share * (1 - share) / lengths.size),
            f"share longer than {k}",
        )
    return sweep.outcome()


def _lit_room() -> Scene:
    """Coloured walls that absorb, a lamp, and no closed object."""
    ball = icosphere_mesh(2)
    return scenes.scene(
        [
            (scenes.box("room", 4), scenes.IDENTITY, wall((0.9, 0.7, 0.3))),
            (dataclasses.replace(ball, name="ball"), stretched(0.7, 0.7, 0.7, (0.8, 0.6, -1.2)), wall((0.2, 0.5, 0.9))),
            (
                dataclasses.replace(ball, name="glass"),
                stretched(0.5, 0.5, 0.5, (-0.8, 0.2, -0.4)),
                glass(1.5, (0.9, 0.95, 1.0)),
            ),
            (scenes.plane("lamp", 0.8), facing_down(1.9), lamp(6.0)),
        ],
        frame=MANY,
        view=scenes.camera(eye=(0.0, -1.8, 0.0), target=(0, 1, -0.4), half_width=0.7),
    )


@case(
    "roulette with light sampling",
    "transport",
    "A room with a lamp, coloured walls and a glass ball: the mean of the picture with roulette from bounce 0 or 2 is "
    "that without.",
    f"{SIGMAS:g} standard errors of the difference of two independent pictures, over pixels; 400 roundings",
)
def roulette_with_light_sampling(bench: Bench) -> Outcome:
    sweep = Sweep()
    settings = SCATTERED.replace(nee="ON", bounce_max=64, sample_count=128)
    plain = bench.render(_lit_room(), settings, roulette_bounce=65)
    for seed, first in ((1, 0), (2, 2)):
        other = bench.render(_lit_room(), settings, roulette_bounce=first, seed=seed)
        for c in range(3):
            # pixels show different things: the difference of a pixel's two values does not
            mean, error = mean_and_error((other - plain)[..., c : c + 1])
            sweep.add(mean, 0.0, SIGMAS * error + 400 * U * plain[..., c].mean(), f"from bounce {first}, channel {c}")
    return sweep.outcome()
