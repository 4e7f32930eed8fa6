"""Meshes in world space, kept from one frame to the next: an edit that moves or hides one leaves the others where they
are.
"""

from __future__ import annotations

import numpy as np

from ...scene.description import Mesh
from ...scene.flatten import MeshChunk, baked_mesh
from ...scene.frozen import Same

_BYTES_MOST = 1 << 26  # that are kept of a frame: with more to bring to their places, tracing takes longer than that


class KeptBakes:
    """What `baked_mesh` made for the last frame, and for this one."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[Same, MeshChunk]] = {}
        self._now: dict[int, tuple[Same, MeshChunk]] = {}
        self._bytes = 0

    def clear(self) -> None:
        """Forget all."""
        self._last, self._now, self._bytes = {}, {}, 0

    def begin(self) -> None:
        """A frame begins: what the last one did not use is forgotten."""
        self._last, self._now, self._bytes = self._now, {}, 0

    def get(self, mesh: Mesh, transform: np.ndarray) -> MeshChunk:
        """`baked_mesh(mesh, transform)`, which nobody changes."""
        arrays = mesh.positions, mesh.triangles, mesh.corner_normals, mesh.triangle_slot, mesh.radii
        where = np.asarray(transform).tobytes(), mesh.ribbons
        known = self._last.get(id(mesh.positions))
        if known is None or not known[0].holds(arrays, where):
            known = Same(arrays, where), baked_mesh(mesh, transform)
        size = _bytes_of(known[1])
        if self._bytes + size <= _BYTES_MOST and known[0].holds(arrays, where):  # not what may be changed
            self._now[id(mesh.positions)] = known
            self._bytes += size
        return known[1]


def _bytes_of(chunk: MeshChunk) -> int:
    arrays = chunk.positions, chunk.triangles, chunk.corner_normals, chunk.triangle_slot
    return sum(each.nbytes for each in arrays if each is not None)
