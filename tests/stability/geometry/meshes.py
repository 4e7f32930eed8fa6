"""Meshes that are hard to hit: slivers, closed meshes with points inside, and shears of them."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raybatch_addon.core.scene.description import Material, Mesh, Scene
from tests.stability.case import Skipped
from tests.support import scenes

SHEAR = 1000.0
"""Shear of x by y: singular values 1000, 1 and 1/1000, condition 1e6."""
GREY = 0.8  # albedo of the lit meshes


def mesh_of(corners: np.ndarray, name: str = "triangles") -> Mesh:
    """Separate triangles; corners float, shape [n, 3, 3]."""
    return Mesh(
        name, np.asarray(corners, np.float32).reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    )


def corners_of(mesh: Mesh) -> np.ndarray:
    """Corners of the mesh's triangles, float64, shape [n, 3, 3]."""
    return mesh.positions[mesh.triangles].astype(np.float64)


def placed(*meshes: Mesh, material: Material | None = None, **more) -> Scene:
    """A scene of meshes, each placed once: all of them share one tree in world space."""
    return scenes.scene([(mesh, scenes.IDENTITY, material or scenes.diffuse(GREY)) for mesh in meshes], **more)


def rotation(seed: int) -> np.ndarray:
    """A rotation, float64, shape [3, 3]."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors, uniform on the sphere, float64, shape [count, 3]."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def unit(vectors: np.ndarray) -> np.ndarray:
    """`vectors`, [n, 3], at length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def strip(length: float = 100.0, width: float = 1e-6, rows: int = 4000) -> Mesh:
    """A rectangle in the plane z = 0, around the origin, of 2 `rows` triangles.

    Each triangle is as long as the rectangle and `width` wide [m].
    """
    y = ((np.arange(rows + 1) - rows // 2) * width).astype(np.float32)
    positions = np.zeros((rows + 1, 2, 3), np.float32)
    positions[:, 0, 0], positions[:, 1, 0], positions[:, :, 1] = -length / 2, length / 2, y[:, None]
    low = 2 * np.arange(rows)
    triangles = np.concatenate([np.stack([low, low + 1, low + 3], 1), np.stack([low, low + 3, low + 2], 1)])
    return Mesh("strip of slivers", positions.reshape(-1, 3), triangles.astype(np.int32))


def grid(cells: int, step: float, name: str = "grid") -> Mesh:
    """A square of `cells` x `cells` squares in the plane z = 0, from the origin on, facing +z."""
    i, j = np.meshgrid(np.arange(cells + 1), np.arange(cells + 1), indexing="ij")
    positions = np.stack([i * step, j * step, 0.0 * i], -1).reshape(-1, 3)
    a = (i[:-1, :-1] * (cells + 1) + j[:-1, :-1]).ravel()
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(name, positions.astype(np.float32), triangles.astype(np.int32))


def icosphere(levels: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere of radius 1 of 20 * 4**levels triangles that face outwards; vertices in float64."""
    phi = (1 + 5**0.5) / 2
    vertices = [
        (-1, phi, 0),
        (1, phi, 0),
        (-1, -phi, 0),
        (1, -phi, 0),
        (0, -1, phi),
        (0, 1, phi),
        (0, -1, -phi),
        (0, 1, -phi),
        (phi, 0, -1),
        (phi, 0, 1),
        (-phi, 0, -1),
        (-phi, 0, 1),
    ]
    faces = [
        (0, 11, 5),
        (0, 5, 1),
        (0, 1, 7),
        (0, 7, 10),
        (0, 10, 11),
        (1, 5, 9),
        (5, 11, 4),
        (11, 10, 2),
        (10, 7, 6),
        (7, 1, 8),
        (3, 9, 4),
        (3, 4, 2),
        (3, 2, 6),
        (3, 6, 8),
        (3, 8, 9),
        (4, 9, 5),
        (2, 4, 11),
        (6, 2, 10),
        (8, 6, 7),
        (9, 8, 1),
    ]
    positions, triangles = unit(np.array(vertices, np.float64)), np.array(faces)
    for _ in range(levels):
        edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        unique, place = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = place.reshape(3, -1) + len(positions)
        positions = np.concatenate([positions, unit(positions[unique].mean(1))])
        a, b, c = triangles.T
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return positions, triangles.astype(np.int32)


def knot_core(s: np.ndarray) -> np.ndarray:
    """The (2, 3) torus knot on a torus of radii 2 and 1, float64, shape [n, 3]."""
    around = 2 + np.cos(3 * s)
    return np.stack([around * np.cos(2 * s), around * np.sin(2 * s), -np.sin(3 * s)], 1)


KNOT_TUBE = 0.3  # radius of the tube


def torus_knot(segments: int = 800, sides: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube around `knot_core`; vertices in float64."""
    s, h = np.arange(segments) * (2 * np.pi / segments), 1e-4
    core = knot_core(s)
    tangent, bend = knot_core(s + h) - knot_core(s - h), knot_core(s + h) - 2 * core + knot_core(s - h)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside = np.cross(tangent, bend)  # the curvature is nowhere 0
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angle = (np.arange(sides) * (2 * np.pi / sides))[None, :, None]
    ring = core[:, None] + KNOT_TUBE * (
        np.cos(angle) * aside[:, None] + np.sin(angle) * np.cross(tangent, aside)[:, None]
    )
    i, j = np.meshgrid(np.arange(segments), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = (i + 1) % segments * sides + j, (i + 1) % segments * sides + (j + 1) % sides
    triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return ring.reshape(-1, 3), triangles.astype(np.int32)


@dataclass(frozen=True)
class Closed:
    """A closed mesh and balls inside it."""

    name: str
    positions: np.ndarray  # float64, shape [n, 3]
    triangles: np.ndarray  # int32, shape [m, 3]
    centres: np.ndarray  # centres of the balls, float64, shape [k, 3]
    radii: np.ndarray  # float64, shape [k]
    clearance: float  # least distance of any ball from the surface

    def sheared(self, shear: float) -> Mesh:
        """The mesh with x + `shear` y in place of x."""
        positions = self.positions.copy()
        positions[:, 0] += shear * positions[:, 1]
        return Mesh(self.name, positions.astype(np.float32), self.triangles)


@functools.cache
def closed_mesh(name: str) -> Closed:
    """`icosphere`, `torus knot` or `bunny` (from the folder RAYBATCH_SCENES; raises `Skipped` without it)."""
    if name == "icosphere":
        positions, triangles = icosphere()
        return Closed(name, positions, triangles, np.zeros((1, 3)), np.full(1, 0.8), 0.19)
    if name == "torus knot":
        positions, triangles = torus_knot()
        # points at rings: between them the core bends by 0.0002 at most, and 24 sides leave 0.991 of the radius
        places = knot_core(np.arange(80) * (2 * np.pi / 80))
        return Closed(name, positions, triangles, places, np.full(80, 0.5 * KNOT_TUBE), 0.45 * KNOT_TUBE)
    path = Path(os.environ.get("RAYBATCH_SCENES", "")) / "bunny144k.npz"
    if not os.environ.get("RAYBATCH_SCENES") or not path.is_file():
        raise Skipped("needs bunny144k.npz in the folder that RAYBATCH_SCENES names")
    with np.load(path) as archive:
        positions, triangles = archive["v"].astype(np.float64), archive["f"].astype(np.int32)
    return _with_inner_balls(name, positions, triangles)


def _with_inner_balls(
    name: str, positions: np.ndarray, triangles: np.ndarray, wanted: int = 16, clearance: float = 0.03
) -> Closed:
    """The closed mesh with balls around points whose winding number is not 0.

    Van Oosterom and Strackee 1983. The points are far from all vertices.
    """
    rng = np.random.default_rng(0)
    low, high = positions.min(0), positions.max(0)
    edge = np.linalg.norm(positions[triangles] - positions[np.roll(triangles, 1, axis=1)], axis=-1).max()
    centres, radii = [], []
    for _ in range(400):
        place = rng.uniform(low, high)
        # no point of a triangle is farther from its nearest corner than its longest side
        room = np.linalg.norm(positions - place, axis=1).min() - edge
        if room < 2 * clearance:
            continue
        a, b, c = np.moveaxis(positions[triangles] - place, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        if abs(np.arctan2((a * np.cross(b, c)).sum(1), below).sum() / (2 * np.pi)) > 0.5:
            centres.append(place)
            radii.append(room - clearance)
        if len(centres) == wanted:
            break
    return Closed(name, positions, triangles, np.array(centres), np.array(radii), clearance)
