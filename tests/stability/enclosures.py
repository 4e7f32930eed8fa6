"""Materials and meshes of cases in which light goes far.

All materials have the same kinds of closures, so that few kernels are compiled.
"""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Mesh
from raybatch_addon.core.settings.settings import RenderSettings
from tests.stability.case import Sweep
from tests.stability.geometry.meshes import icosphere
from tests.support import scenes

# kernels are compiled for these kinds, whichever of them a scene has
KINDS = (ClosureKind.DIFFUSE, ClosureKind.GLOSSY, ClosureKind.GLASS, ClosureKind.EMISSION)
# Light is found by scattering alone: a path of a white scene then carries 1, to the bit
# One tile: its paths are under way together, so that a picture takes as many turns as its longest path has bounces
SCATTERED = RenderSettings(
    sample_count=1, sample_sequence="INDEPENDENT", nee="OFF", bounce_max=10_000, roulette_bounce=0, tile_size=16
)
FEW = Frame(4, 4)
MANY = Frame(16, 16)
NEEDLE = 1e-6  # half width of the window of a camera whose rays are all but one ray


def add_exact(sweep: Sweep, picture: np.ndarray, expected: float, note: str) -> None:
    """Compare every value with `expected`, to the bit; the value farthest off goes to the sweep."""
    sweep.add(
        _farthest(picture, expected),
        expected,
        0.0,
        f"{note}: {int((picture != expected).sum())} of {picture.size} values differ",
    )


def add_relative(sweep: Sweep, picture: np.ndarray, expected: float, tolerance: float, note: str) -> None:
    """Compare every value with `expected`, within the relative `tolerance`; the one farthest off goes to the sweep."""
    sweep.add(_farthest(picture, expected), expected, tolerance * expected, note)


def _farthest(picture: np.ndarray, expected: float) -> float:
    return float(picture.ravel()[np.abs(picture - expected).argmax()])


def made(*closures: tuple, emission: float = 0.0) -> Material:
    """Material of (kind, weight, more) tuples; `weight` is a number or a colour."""
    parts = [
        Closure(kind, tuple(np.broadcast_to(np.float64(weight), 3).tolist()), **(more[0] if more else {}))
        for kind, weight, *more in closures
    ]
    if emission:
        parts.append(Closure(ClosureKind.EMISSION, (emission,) * 3))
    return Material("made", tuple(parts), KINDS)


def wall(albedo=1.0, emission: float = 0.0) -> Material:
    """Lambertian material, which may emit."""
    return made((ClosureKind.DIFFUSE, albedo), emission=emission)


def mirror(reflectance=1.0, emission: float = 0.0) -> Material:
    """Perfect mirror, which may emit."""
    return made((ClosureKind.GLOSSY, reflectance), emission=emission)


def glass(ior: float, weight=1.0, refraction: float = 1.0) -> Material:
    """Smooth glass."""
    return made((ClosureKind.GLASS, weight, {"ior": ior, "refraction": (refraction,) * 3}))


def lamp(radiance: float = 1.0) -> Material:
    """Material that emits, and reflects nothing."""
    return made(emission=radiance)


def stretched(x: float, y: float, z: float, at=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Object to world, float32 [3, 4]: scaled along the axes, then moved."""
    return np.column_stack([np.diag([x, y, z]), at]).astype(np.float32)


def facing_down(height: float) -> np.ndarray:
    """Object to world of a plane at z = `height` with its front below."""
    return stretched(1, -1, -1, (0, 0, height))


def joined(name: str, mesh: Mesh, transforms) -> Mesh:
    """One mesh that joins copies of `mesh` under each of the transforms [3, 4]."""
    positions = [
        mesh.positions.astype(np.float64) @ np.asarray(m, np.float64)[:, :3].T + np.asarray(m, np.float64)[:, 3]
        for m in transforms
    ]
    triangles = [mesh.triangles + len(mesh.positions) * i for i in range(len(positions))]
    return Mesh(name, np.concatenate(positions).astype(np.float32), np.concatenate(triangles).astype(np.int32))


def wall_with_hole(size: float, hole: float, name: str = "wall with a hole") -> Mesh:
    """A square of `size` in the plane z = 0 with a square hole in its middle [m]."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    ring = [[i, (i + 1) % 4, 4 + (i + 1) % 4] for i in range(4)] + [[i, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    return Mesh(name, np.concatenate([size * corners, hole * corners]).astype(np.float32), np.array(ring, np.int32))


def icosphere_mesh(levels: int) -> Mesh:
    """Sphere of radius 1 of 20 * 4^levels triangles that face outwards; the corners lie on the sphere."""
    positions, triangles = icosphere(levels)
    return Mesh("icosphere", positions.astype(np.float32), triangles)


def turned_askew(scale: float = 1.0) -> np.ndarray:
    """A rotation about no coordinate axis, a shear and a mirroring, float32 [3, 4]: a closed mesh stays closed."""
    c, s = math.cos(0.7), math.sin(0.7)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    shear = np.array([[1.0, 0.4, 0.0], [0.0, 1.0, -0.3], [0.0, 0.0, -1.0]])
    return np.column_stack([scale * rotation @ shear, [0.01, -0.02, 0.03]]).astype(np.float32)


def view_along(eye, target, half_width: float = NEEDLE, up=(0.0, 1.0, 0.0)):
    """A camera that looks along one line."""
    return scenes.camera(eye=eye, target=target, half_width=half_width, up=up)
