"""Light in and on instances that are mirrored, stretched and sheared: glass, normals and lamps."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Mesh
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.exact import U
from tests.stability.geometry.meshes import GREY, SHEAR, icosphere, rotation
from tests.stability.geometry.transforms import FAMILY, affine, placed_by
from tests.support import scenes


@case(
    "a mirrored ball of glass",
    FAMILY,
    "A ball of glass (IOR 1.5) before a lit square and a dark one, as it is and mirrored: its triangles lie where "
    "they lay, so the picture stays. Were inside and outside exchanged, it would be a lens of IOR 1 / 1.5.",
    "The mean difference of pixels over the mean. Samples have the same random numbers, so only those differ that "
    "roundings carry over an edge: of 40,000 paths with some 3 events each, 1e-3 at most, in ten events. 1e-2.",
)
def mirrored_glass(bench: Bench) -> Outcome:
    positions, triangles = icosphere(3)
    mesh = Mesh("ball", positions.astype(np.float32), triangles)
    glass = scenes.material(Closure(ClosureKind.GLASS, (1.0, 1.0, 1.0), ior=1.5))
    lamp = scenes.plane("lamp", 6.0)
    upright = affine(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T, (3.0, 4.0, 0.0))
    pictures = []
    for matrix in (np.eye(3), np.diag([-1.0, 1, 1])):
        objects = [
            (mesh, affine(matrix), glass),
            (mesh, affine(matrix, (0, -50, 0)), glass),
            (lamp, upright, scenes.emitter(1.0)),
        ]
        scene = scenes.scene(
            objects, view=scenes.camera(eye=(0, -4, 0), half_width=0.35), frame=Frame(32, 32), world=0.05
        )
        pictures.append(bench.render(scene, sample_count=40))
    change = np.abs(pictures[0] - pictures[1]).mean() / pictures[0].mean()
    return Outcome(float(change), 0.0, 1e-2, f"mean {pictures[0].mean():.4f} and {pictures[1].mean():.4f}")


SQUARE = Mesh(
    "square",
    np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32),
    np.array([[0, 1, 2], [0, 2, 3]], np.int32),
)


def _floors() -> dict[str, np.ndarray]:
    """Matrices of a square that stays around the origin."""
    shear = np.array([[1.0, SHEAR, 0], [0, 1, 0], [0, 0, 1]])
    return {
        "stretched": np.diag([100.0, 0.5, 3.0]),
        "flattened to 1e-6 across": np.diag([1.0, 1, 1e-6]),
        "mirrored": np.diag([1.0, -1, 1]),
        "mirrored across": np.diag([1.0, 1, -1]),
        "turned, mirrored": rotation(19) @ np.diag([-1.0, 1, 1]),
        "sheared along itself by 1,000": shear,
        "sheared out of its plane by 1,000": shear[[2, 1, 0]][:, [2, 1, 0]],
        "turned, sheared by 30": rotation(20) @ [[1, 30, 0], [0, 1, 0], [0, 0, 1]],
    }


def _tangents(linear: np.ndarray) -> tuple[np.ndarray, float]:
    """The square's unit normal in the world, and 1 / sine of the angle between its sides there."""
    linear = linear.astype(np.float32).astype(np.float64)
    normal = np.cross(linear[:, 0], linear[:, 1])
    size = np.linalg.norm(normal)
    return normal / size, float(np.linalg.norm(linear[:, 0]) * np.linalg.norm(linear[:, 1]) / size)


@case(
    "normals of instances",
    FAMILY,
    "A square stretched, flattened, mirrored and sheared by up to 1,000: the pass Normal, which faces the viewer, is "
    "the cross product of its sides in the world, in float64.",
    "The normal is carried by cofactors, here a b' - b a' of the sides a, b: 6 u |a| |b| / |a x b| in all, and 8 u "
    "for lengths. Measured in units of that.",
)
def normals(bench: Bench) -> Outcome:
    sweep = Sweep()
    for name, linear in _floors().items():
        expected, flat = _tangents(linear)
        picture = _seen(bench, linear, (), passes=("Combined", "Normal")).passes["Normal"].astype(np.float64)
        tolerance = 8 * U + 6 * U * flat
        sweep.add(np.abs(picture - expected).max() / tolerance, 0.0, 1.0, name)
    return sweep.outcome()


def _seen(bench: Bench, linear: np.ndarray, lights: tuple, passes: tuple[str, ...] = ("Combined",)):
    """The film of the square, seen from straight above; the square fills the picture."""
    normal, _ = _tangents(linear)
    aside = linear[:, 0] / np.linalg.norm(linear[:, 0])
    # so near that the smallest of the sides' shadows on each other fills the window
    size = np.linalg.norm(np.cross(linear[:, 0], linear[:, 1])) / max(
        np.linalg.norm(linear[:, 0]), np.linalg.norm(linear[:, 1])
    )
    view = scenes.camera(eye=tuple(normal), target=(0, 0, 0), half_width=0.2 * min(1.0, size), up=tuple(aside))
    away = affine(linear, 50 * normal * -1 + 0 * aside)
    scene = placed_by(SQUARE, [affine(linear), away], view=view, frame=Frame(16, 16, passes=passes), lights=lights)
    return bench.film(scene, sample_count=4, bounce_max=0)


@case(
    "instances in the sun",
    FAMILY,
    "The same squares with the sun straight above and 70 degrees off: albedo / pi times irradiance times the cosine "
    "with the exact normal. No pixel is in its own shadow.",
    "32 u for light and closure, and the error of the normal (as for the pass Normal) times tan 70 degrees, "
    "relatively.",
)
def lit(bench: Bench) -> Outcome:
    sweep = Sweep()
    for name, linear in _floors().items():
        normal, flat = _tangents(linear)
        aside = linear[:, 0] / np.linalg.norm(linear[:, 0])
        tolerance = 32 * U + (8 * U + 6 * U * flat) * math.tan(math.radians(70))
        for angle in (0.0, 70.0):
            towards = math.cos(math.radians(angle)) * normal + math.sin(math.radians(angle)) * aside
            matrix = scenes.look_at(towards, (0, 0, 0), np.cross(normal, aside))
            cosine = float(matrix[:, 2].astype(np.float64) @ normal)
            picture = (
                _seen(bench, linear, (scenes.sun(1.0, 0.0, matrix),)).passes["Combined"][..., :3].astype(np.float64)
            )
            sweep.add(
                np.abs(picture / (GREY / math.pi * cosine) - 1).max(),
                0.0,
                tolerance,
                f"{name}, sun at {angle:g} degrees",
            )
    return sweep.outcome()
