"""Digests of a frame's geometry, by which a tree of the frame before is known to be right, or to follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...bvh.build.mesh_tree import mesh_parts
from ...device.bulk import digest_of
from ...native.structs import to_numpy
from ...scene.description import Scene
from ...scene.flatten import FlatGeometry
from ...scene.geometry import Geometry

# Share of a mesh's corners that are other vertices than in the frame before from which on it is another mesh: of quads
# that bend, few are cut along their other diagonal (measured: 1 of 2,300)
REMADE_SHARE = 0.05


@dataclass(frozen=True)
class Fingerprint:
    """Digests of a frame: what is equal was equal."""

    # counts of triangles, what instances place, visibility, settings: a tree can follow only where it is the same
    topology: bytes
    triangles: tuple[bytes, ...]  # of each mesh tree: their vertices, which change where quads that bend are cut anew
    positions: tuple[bytes, ...]  # of each mesh tree; empty where they are others since
    transforms: bytes  # of instances that are not baked; likewise
    surface: bytes  # normals and materials, which trees do not know

    @staticmethod
    def of(flat: FlatGeometry, scene: Scene, kind: tuple) -> Fingerprint:
        """The fingerprint of a frame; `kind` are the choices that its tree depends on."""
        merged = [array for group in flat.merged for array in (group.instance, group.instance_triangle_first)]
        topology = [
            flat.mesh_triangle_first,
            flat.mesh_vertex_first,
            flat.instance_mesh,
            flat.shared,
            *merged,
            scene.instances.visibility,
            np.frombuffer(repr(kind).encode(), np.uint8),
        ]
        moving = [flat.motion.row, flat.motion.keys] if flat.motion else []
        # a tree does not follow vertices that move in a frame
        steps = flat.motion.steps.values() if flat.motion else ()
        topology += [array for each in steps for array in each if array is not None]
        topology += [flat.triangles] if flat.curves or flat.motion else []  # as its segments and steps are
        parts = mesh_parts(flat)
        positions = [flat.positions[part.vertex_first : part.vertex_first + part.vertex_count] for part in parts]
        surface = [flat.corner_normals, flat.triangle_slot, scene.instances.slot_first, scene.slot_materials]
        return Fingerprint(
            digest_of(topology),
            tuple(digest_of([flat.triangles[part.span]]) for part in parts),
            tuple(digest_of([each]) for each in positions),
            digest_of([flat.instance_transform, *moving]),
            digest_of(surface),
        )

    def remade_since(self, before: Fingerprint, geometry: Geometry, flat: FlatGeometry) -> list[int]:
        """Mesh trees of this frame, `flat`, that are over other meshes than in the frame `before`, which `geometry`
        still holds and whose topology is the same: what such a tree cost tells nothing of what it should cost now.
        """
        remade = []
        for i, part in enumerate(mesh_parts(flat)):
            if self.triangles[i] != before.triangles[i]:
                now, was = flat.triangles[part.span], to_numpy(geometry.triangles[part.span])
                if np.count_nonzero(now != was) > REMADE_SHARE * now.size:
                    remade.append(i)
        return remade
