"""Instances by the million: arrays that are made once, and filled part by part."""

from __future__ import annotations

import numpy as np

from raybatch_addon.core.scene.description import Instances, Visibility

# Instances that are worked on at once: what is made for them alone stays small
PART = 1 << 18


class Placements:
    """Room for instances, filled from the first on."""

    def __init__(self, count: int):
        self.transform = np.empty((count, 3, 4), np.float32)
        self.mesh = np.empty(count, np.int32)  # also what names the object and the first slot: one of each for a mesh
        self.count = 0

    def add(self, mesh: int | np.ndarray, transform: np.ndarray) -> None:
        """Append instances of `mesh`, float [n, 3, 4]; those beyond the room are left out."""
        part = slice(self.count, min(self.count + len(transform), len(self.mesh)))
        room = part.stop - part.start
        self.transform[part] = transform[:room]
        self.mesh[part] = mesh[:room] if isinstance(mesh, np.ndarray) else mesh
        self.count = part.stop

    @property
    def left(self) -> int:
        """Instances that there is still room for."""
        return len(self.mesh) - self.count

    def instances(self, slot_first: np.ndarray) -> Instances:
        """All of them; `slot_first` of each mesh, int32."""
        mesh = self.mesh[: self.count]
        return Instances(
            mesh,
            self.transform[: self.count],
            slot_first[mesh],
            np.full(self.count, int(Visibility.ALL), np.int32),
            mesh,
        )


def composed(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Maps of `inner`, float [k, 3, 4], each within each of `outer`, float [n, 3, 4]: float32, shape [n * k, 3, 4]."""
    made = np.empty((len(outer), len(inner), 3, 4), np.float32)
    np.einsum("nij,kjl->nkil", outer[:, :, :3], inner, out=made, casting="same_kind", optimize=False)
    made[..., 3] += outer[:, None, :, 3]
    return made.reshape(-1, 3, 4)


def standing(points: np.ndarray, angles: np.ndarray, scales: np.ndarray, up: np.ndarray | None = None) -> np.ndarray:
    """Maps that scale, turn about the upright axis by `angles` [rad], and move to `points` [n, 3]; `up`, unit [n, 3]:
    the direction that Z is turned to (default: Z). Float32, shape [n, 3, 4].
    """
    made = np.zeros((len(points), 3, 4), np.float32)
    turned_x = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], 1)
    if up is None:
        up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(points), 3))
    y = np.cross(up, turned_x)
    y /= np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-12)
    made[:, :, 0] = np.cross(y, up) * scales[:, None]
    made[:, :, 1] = y * scales[:, None]
    made[:, :, 2] = up * scales[:, None]
    made[:, :, 3] = points
    return made
