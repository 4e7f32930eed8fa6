"""Meshes of strands of earlier exports, found again by the points that they were cut from.

Blender evaluates hair anew for every render. Where its points are the same, so are the segments: the arrays of the
earlier export are taken, which are frozen, and the core keeps what it made of them.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from ...core.scene.description import Mesh
from ..meshes.kept_meshes import kept_mesh, kept_uvs
from .strands import CutStrands


def mesh_of(cut: CutStrands, name: str, uvs: np.ndarray | None = None) -> Mesh:
    """The mesh of all segments of `cut`; `uvs`: UV coordinates of each strand, float32, shape [strand_count, 2]."""
    strands = cut.strands
    digest = _digest(repr((name, cut.shape)), strands.points, strands.radii, strands.first)
    mesh = kept_mesh(digest, (name, len(strands.points), len(strands.first)), lambda: cut.mesh(name))
    if uvs is None:
        return mesh
    return replace(mesh, corner_uvs=kept_uvs(digest, _digest("", uvs), lambda: cut.corner_uvs(uvs)))


def _digest(values: str, *arrays: np.ndarray) -> bytes:
    digest = hashlib.sha1(values.encode(), usedforsecurity=False)
    for array in arrays:
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array))
    return digest.digest()
