"""Meshes of strands of earlier exports, found again by the points that they were cut from.

Blender evaluates hair anew for every render. Where its points are the same, so are the segments: the arrays of the
earlier export are taken, which are frozen, so that the core does not check and build them again. Attributes, and the
material slots of curves that use several, are read anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.device.bulk import digest_of
from ...core.scene.description import Mesh
from ..meshes.kept_meshes import kept_mesh, kept_uvs
from .strands import CutStrands


def mesh_of(cut: CutStrands, name: str, user: str, uvs: np.ndarray | None = None) -> Mesh:
    """The mesh of all segments of `cut`, called `name`, of the object `user`; `uvs`: UV coordinates of each strand,
    float32, shape [strand_count, 2].
    """
    strands = cut.strands
    digest = digest_of((strands.points, strands.radii, strands.first), repr((name, cut.shape)))
    mesh = kept_mesh(digest, (user, name, len(strands.points), len(strands.first)), lambda: cut.mesh(name))
    if uvs is None:
        return mesh
    return replace(mesh, corner_uvs=kept_uvs(digest, digest_of((uvs,)), lambda: cut.corner_uvs(uvs)))
