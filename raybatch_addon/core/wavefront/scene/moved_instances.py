"""A frame in which instances alone moved: their vertices and maps are brought up to date, and no other geometry is
looked at.

A mesh that is placed once lies in world space, so that to move it is to move its vertices; one that is placed more
often has a map for each instance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...bvh.build.scene_tree import BuiltTree, refit_moved
from ...device.bulk import digest_of
from ...kept_arrays import overwrite_changed, overwrite_rows
from ...scene.description import Instances, Mesh, Scene
from ...scene.flatten import IDENTITY, FlatGeometry, baked_mesh
from ...scene.frozen import Same, is_frozen
from ...scene.geometry import Geometry


@dataclass(frozen=True)
class Placed:
    """Where the geometry of a frame lies in its arrays, and what it follows from but for where instances are."""

    flat: FlatGeometry  # without the arrays that grow with vertices and triangles
    transform: np.ndarray  # of the instances of the scene, shape [n, 3, 4]
    same: Same

    @staticmethod
    def of(flat: FlatGeometry, scene: Scene, arrays: list[np.ndarray | None], values: tuple) -> Placed | None:
        """The frame `flat` of `scene`, which follows from frozen `arrays` of meshes and from `values`; None where
        instances move in the time of the frame, or segments of curves are in it: these are always looked at.
        """
        if flat.motion is not None or flat.curves:
            return None
        large = ("positions", "triangles", "corner_normals", "triangle_slot")
        small = replace(flat, **{name: getattr(flat, name)[:0].copy() for name in large})
        same = Same(arrays, (_still(scene.instances), values))
        return Placed(small, _lasting(scene.instances.transform), same)

    @property
    def is_baked(self) -> np.ndarray:
        """Whether each instance lies in world space, bool, shape [n]."""
        found = np.zeros(len(self.transform), bool)
        for group in self.flat.merged:
            found[group.instance] = True
        return found

    def moving(self, transform: np.ndarray) -> np.ndarray:
        """Which of the instances that lie in world space `transform`, shape [n, 3, 4], has elsewhere."""
        return np.flatnonzero((transform != self.transform).any((1, 2)) & self.is_baked)

    def serves(self, scene: Scene, arrays: list[np.ndarray | None], values: tuple) -> bool:
        """Whether `scene`, which follows from `arrays` and `values`, differs by no more than where its instances are.
        One that is mirrored has other triangles.
        """
        instances = scene.instances
        if instances.motion is not None or not self.same.holds(arrays, (_still(instances), values)):
            return False
        now = np.array(instances.transform)
        moving = self.moving(now)
        return bool((_mirrors(now[moving]) == _mirrors(self.transform[moving])).all())


def _lasting(transform: np.ndarray) -> np.ndarray:
    """`transform`, which nobody changes later: a copy where somebody might."""
    return transform if is_frozen(transform) else np.array(transform)


def _still(instances: Instances) -> bytes:
    """A digest of all that instances are, but for where."""
    return digest_of([instances.mesh, instances.visibility, instances.slot_first])


def follow_moved(
    placed: Placed, scene: Scene, built: BuiltTree, geometry: Geometry, device: wp.Device
) -> tuple[Placed | None, list[int]]:
    """Make `geometry` and `built` those of `scene`, for which `placed.serves`; where its things are now, and which mesh
    trees were refitted. No place where one of them became so bad that it should be built anew: then `built` is of no
    frame.
    """
    instances, flat = scene.instances, placed.flat
    now, is_baked = _lasting(instances.transform), placed.is_baked
    moving = placed.moving(now)
    for i in moving.tolist():
        _move(geometry, flat, i, scene.meshes[instances.mesh[i]], now[i])
    transform = np.array(now, np.float32).reshape(-1, 3, 4)
    transform[is_baked] = IDENTITY
    changed = np.flatnonzero((transform != flat.instance_transform).any((1, 2)))
    overwrite_changed(geometry.instance_transform, changed, transform)
    flat = replace(flat, instance_transform=transform)
    trees = {
        i: _triangles(flat, found)
        for i, each in enumerate(flat.merged)
        if len(found := moving[np.isin(moving, each.instance)])
    }
    followed = refit_moved(built, flat, geometry, instances.visibility, trees, device)
    return replace(placed, flat=flat, transform=now) if followed else None, list(trees)


def _triangles(flat: FlatGeometry, instances: np.ndarray) -> list[tuple[int, int]]:
    """First and count of the triangles of each of `instances`."""
    meshes = flat.instance_mesh[instances]
    first, end = flat.mesh_triangle_first[meshes], flat.mesh_triangle_first[meshes + 1]
    return list(zip(first.tolist(), (end - first).tolist(), strict=True))


def _mirrors(maps: np.ndarray) -> np.ndarray:
    return np.linalg.det(np.asarray(maps, np.float64)[:, :, :3]) < 0


def _move(geometry: Geometry, flat: FlatGeometry, instance: int, mesh: Mesh, transform: np.ndarray) -> None:
    """Bring the vertices and normals of a baked instance to their places."""
    place = flat.instance_mesh[instance]
    part = baked_mesh(mesh, transform)
    overwrite_rows(geometry.positions, int(flat.mesh_vertex_first[place]), np.asarray(part.positions, np.float32))
    if part.corner_normals is not None:
        first = 3 * int(flat.mesh_triangle_first[place])
        overwrite_rows(geometry.corner_normals, first, np.asarray(part.corner_normals, np.float32).reshape(-1, 3))
