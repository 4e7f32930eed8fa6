"""Ground of hills over a square, as a mesh, and what grows on it may know of it: height and slope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from made_scenes.noise import fractal_noise
from made_scenes.placing import PART
from raybatch_addon.core.device.bulk import in_slices
from raybatch_addon.core.scene.description import Mesh


@dataclass(frozen=True)
class Terrain:
    """Heights at the points of a square grid around the origin."""

    size: float  # edge of the square [m]
    heights: np.ndarray  # [m], float32, shape [edge, edge]; rows are of constant y

    @staticmethod
    def of(size: float, edge: int, seed: int, island: bool, height: float) -> Terrain:
        """`edge` x `edge` points; an island has a shore, below which the ground falls under height 0."""
        heights, steps = np.empty((edge, edge), np.float32), np.linspace(-1, 1, edge)

        def fill(rows: slice) -> None:  # some at a time: noise takes many arrays
            y, x = np.meshgrid(steps[rows], steps, indexing="ij")
            hills = fractal_noise(3 * x, 3 * y, seed, 9)
            if not island:
                heights[rows] = height * hills
                return
            shore = 1 - np.hypot(x, y) / (0.78 + 0.16 * fractal_noise(2 * x, 2 * y, seed + 50, 5))
            ridge = 1 - np.abs(fractal_noise(2.2 * x, 2.2 * y, seed + 90, 8))
            inland = np.clip(1.6 * shore, 0, 1)
            heights[rows] = height * (0.35 * np.tanh(2 * shore) + inland**2 * (0.75 * ridge**3 + 0.35 * hills))

        in_slices(edge, fill, max(1, PART // edge))
        return Terrain(size, heights)

    @property
    def edge(self) -> int:
        """Points along each axis."""
        return len(self.heights)

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights at `points` [n, 2], on the mesh's own triangles, and upward unit normals there [n, 3]."""
        places = (points / self.size + 0.5) * (self.edge - 1)
        cell = np.clip(places.astype(np.int64), 0, self.edge - 2)
        u, v = (places - cell).T
        i, j = cell.T
        low, right, top, far = (self.heights[j + b, i + a].astype(np.float64) for b in (0, 1) for a in (0, 1))
        # the quad's diagonal goes from its first to its last corner
        below = u >= v
        along = np.where(below, right - low, far - top)
        up = np.where(below, far - right, top - low)
        heights = low + u * along + v * up
        step = self.size / (self.edge - 1)
        normals = np.stack([-along / step, -up / step, np.ones_like(along)], 1)
        return heights, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def mesh(self, name: str) -> Mesh:
        """Two triangles for each cell."""
        edge, steps = self.edge, np.linspace(-self.size / 2, self.size / 2, self.edge, dtype=np.float32)
        positions = np.empty((edge, edge, 3), np.float32)
        positions[..., 0], positions[..., 1], positions[..., 2] = steps, steps[:, None], self.heights
        triangles = np.empty((edge - 1, edge - 1, 2, 3), np.int32)
        first = np.arange(edge - 1, dtype=np.int32) + edge * np.arange(edge - 1, dtype=np.int32)[:, None]
        for corner, offset in enumerate((0, 1, edge + 1)):
            triangles[:, :, 0, corner] = first + offset
        for corner, offset in enumerate((0, edge + 1, edge)):
            triangles[:, :, 1, corner] = first + offset
        return Mesh(name, positions.reshape(-1, 3), triangles.reshape(-1, 3))
