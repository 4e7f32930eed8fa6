"""Surfaces of volumes that lie on other surfaces, as those of smoke that stands on a floor: moved off them.

A ray goes on behind a surface beyond the error of its point (`spawn_origin`), so it does not meet another face that
coincides with that one. Of two such faces rounding decides which a ray meets: one that leaves the smoke by its own face
would miss the floor. Nobody sees the faces of a mesh whose material is a volume alone, so its flat faces are moved
inwards from the surface that they lie on, beyond the errors of both, before trees are built. Then rays that come from
where the camera is, or nearer, meet both in the same order everywhere. Faces stay where they are where that is more
than `MOVED_MOST` of the volume, or would bring them onto another surface, and where they lie on those of other volumes
alone, which `shading/volumes/enclosures.py` finds. Edges sharper than some 15 degrees are moved less.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from ..bvh.margin import TRIANGLE_TEST
from ..device.bulk import kinds_of
from ..float32 import UNIT_ROUNDOFF
from ..scene.description import ClosureKind, Material, Mesh, Scene
from ..scene.frozen import Same, fact, freeze
from ..scene.motion import apart
from .flat_faces import FlatFaces, flat_faces, offsets_at
from .vertices import cofactors, units, used_meshes

# How far a face is moved at most, of the extent of its mesh across it
MOVED_MOST = 0.01
# Triangles of a mesh whose faces may be moved, and instances of volumes and pairs of them and of surfaces, at most;
# where there are more, all stay where they are
TRIANGLES_MOST, BOUNDARIES_MOST, _PAIRS_MOST = 16_384, 1024, 10_000_000
# What may be looked at in one scene: vertices, and as many more for each surface that a plane is compared with.
# Faces that would need more stay where they are
WORK_MOST, _WORK_EACH = 6_000_000, 2000
# Roundings of a point in its plane and of its test, in proportion to the longest edge; of its coordinates; and of
# carrying it to the world (`shading/surface.py`)
_EDGE, _PLACE, _CARRIED = TRIANGLE_TEST + 8 * UNIT_ROUNDOFF, 2 * UNIT_ROUNDOFF, 18 * UNIT_ROUNDOFF


def is_boundary(material: Material) -> bool:
    """Whether a surface is seen by nothing but its volume: it lets all light pass."""
    passes = [c for c in material.closures if c.kind == ClosureKind.TRANSPARENT and c.weight == (1.0, 1.0, 1.0)]
    return material.volume is not None and material.program is None and len(passes) == len(material.closures) == 1


@dataclass
class _Kept:
    """Positions of a mesh whose faces were moved, and what they were made of."""

    positions: np.ndarray
    same: Same


class MovedBoundaries:
    """Positions of the last scene's meshes whose faces were moved, for the next one: kept where they would be alike."""

    def __init__(self) -> None:
        self._kept: list[_Kept] = []

    def clear(self) -> None:
        """Forget them."""
        self._kept = []

    def moved(self, scene: Scene) -> Scene:
        """`scene` with flat faces of volumes moved off the surfaces that they lie on; itself where there are none.

        Nothing is looked at that moves or deforms while the shutter is open. Arrays that are made are frozen. All that
        is kept is positions.
        """
        if not any(map(is_boundary, scene.materials)) or len(scene.instances) < 2:
            self.clear()
            return scene
        places = _Places(scene)
        meshes, mesh_of, kept = list(scene.meshes), scene.instances.mesh.copy(), []
        for index, which in places.boundaries.items():
            mesh = scene.meshes[index]
            if not places.lie_near(which):
                continue
            faces = fact(mesh.positions, flat_faces, mesh.triangles)
            shift = places.shift(mesh, faces, which)
            if shift.any():
                positions = self._positions(mesh, faces, shift, kept)
                base = mesh.positions if mesh.base_positions is None else mesh.base_positions
                mesh_of[which] = len(meshes)
                meshes.append(dataclasses.replace(mesh, positions=positions, base_positions=base))
        self._kept = kept
        if not kept:
            return scene
        used, mesh_of = used_meshes(meshes, mesh_of)
        return dataclasses.replace(
            scene, meshes=tuple(used), instances=dataclasses.replace(scene.instances, mesh=mesh_of)
        )

    def _positions(self, mesh: Mesh, faces: FlatFaces, shift: np.ndarray, kept: list[_Kept]) -> np.ndarray:
        """Where the vertices are once each plane was moved inwards by `shift`: as in the last scene, if it had them."""
        arrays, values = [mesh.positions, mesh.triangles], shift.tobytes()
        found = next((each for each in self._kept if each.same.holds(arrays, values)), None)
        if found is None:
            offset = offsets_at(mesh.positions, mesh.triangles, faces, -shift)
            found = _Kept(freeze((mesh.positions + offset).astype(np.float32)), Same(arrays, values))
        kept.append(found)
        return found.positions


class _Places:
    """Where the surfaces of a scene are in the world."""

    def __init__(self, scene: Scene):
        """Finds which meshes bound volumes alone, `boundaries`: the instances of each mesh."""
        self._scene, instances = scene, scene.instances
        self._maps = np.asarray(instances.transform, np.float64)
        boxes = np.array([fact(mesh.positions, _box_of) for mesh in scene.meshes])[instances.mesh]
        linear, offset = self._maps[:, :, :3], self._maps[:, :, 3]
        self._middle = np.einsum("nij,nj->ni", linear, boxes.mean(1)) + offset
        self._half = np.einsum("nij,nj->ni", np.abs(linear), (boxes[:, 1] - boxes[:, 0]) / 2)
        self._largest = np.abs(boxes).max(1)  # coordinates, in object space
        self._eye = np.asarray(scene.camera.transform, np.float64)[:, 3]
        self._left = WORK_MOST
        self._near_to: dict[int, np.ndarray] = {}  # by instance: what `_near` returns, for each of its planes
        alone, seen = _bounding(scene)
        still = ~apart(scene)
        self._solids = np.flatnonzero(seen & still)
        size = [len(scene.meshes[index].positions) for index in instances.mesh[self._solids].tolist()]
        self._solids = self._solids[np.argsort(size, kind="stable")]
        small = np.array([len(mesh.triangles) <= TRIANGLES_MOST for mesh in scene.meshes])[instances.mesh]
        bounded = np.flatnonzero(alone & still)
        self.boundaries: dict[int, list[int]] = {}
        if len(bounded) <= BOUNDARIES_MOST and len(bounded) * len(self._solids) <= _PAIRS_MOST:
            for i in bounded[small[bounded]].tolist():
                self.boundaries.setdefault(int(instances.mesh[i]), []).append(i)

    def lie_near(self, which: list[int]) -> bool:
        """Whether the boxes of any of the instances `which` touch those of surfaces."""
        return any(len(self._near(i)) > 0 for i in which)

    def _near(self, i: int) -> np.ndarray:
        """The surfaces whose boxes touch that of instance `i`, those of the smallest meshes first."""
        if i not in self._near_to:
            solids = self._solids
            reach = (self._half[solids] + self._half[i]) * (1 + MOVED_MOST)
            self._near_to[i] = solids[(np.abs(self._middle[solids] - self._middle[i]) <= reach).all(1)]
        return self._near_to[i]

    def shift(self, mesh: Mesh, faces: FlatFaces, which: list[int]) -> np.ndarray:
        """How far each plane of `faces` is to be moved inwards, in object space, for the instances `which` of `mesh`:
        float64, shape [planes]; 0 where it lies on nothing, or on something wherever it may be moved.
        """
        shift = np.zeros(len(faces.normals))
        which = [i for i in which if np.linalg.det(self._maps[i, :, :3]) != 0]
        for k, normal in enumerate(faces.normals):
            corners = mesh.positions[mesh.triangles[faces.plane == k]].astype(np.float64)
            needed = max((self._needed(i, k, faces, corners, 0.0) for i in which), default=0.0)
            if not 0 < needed < math.inf:
                continue
            most = MOVED_MOST * float(np.ptp(mesh.positions[mesh.triangles].reshape(-1, 3) @ normal))
            # powers of two, or meshes would be others wherever the camera is
            tried = 2.0 ** math.ceil(math.log2(needed))
            while tried <= most and any(self._needed(i, k, faces, corners, tried) for i in which):
                tried *= 2
            shift[k] = tried if tried <= most else 0.0
        return shift

    def _needed(self, i: int, k: int, faces: FlatFaces, corners: np.ndarray, shift: float) -> float:
        """How far plane `k` of instance `i`, moved inwards by `shift`, is to be moved from where it was until surfaces
        on which it lies are met apart from it, all in object space; 0 where it lies on none, infinite where that was
        not found out. `corners`: of its triangles, [n, 3, 3].
        """
        linear = self._maps[i, :, :3]
        normal = units(faces.normals[k] @ cofactors(linear).T)
        carried = abs(float((linear @ faces.normals[k]) @ normal))  # so far a plane goes that is moved by 1
        moved = corners - shift * faces.normals[k]
        ours = moved @ linear.T + self._maps[i, :, 3]
        solids = self._near(i)
        away = (self._middle[solids] - ours[0, 0]) @ normal
        half = (self._half[solids] + MOVED_MOST * self._half[i]) @ np.abs(normal)
        found = 0.0
        for solid in solids[np.abs(away) <= half].tolist():
            self._left -= len(self._mesh(solid).positions) + _WORK_EACH
            if self._left < 0:
                return math.inf
            found = max(found, self._apart(i, solid, ours, float(faces.longest[k]), normal))
        return found / carried + (shift if found else 0.0)

    def _apart(self, i: int, solid: int, ours: np.ndarray, longest: float, normal: np.ndarray) -> float:
        """How far faces `ours` of instance `i`, corners in the world [n, 3, 3], with edges up to `longest` in object
        space, are to be moved against `normal` to be met apart from those of `solid`; 0 where they do not coincide.
        """
        mesh, matrix = self._mesh(solid), self._maps[solid]
        # heights above the plane, from object space
        across, base = matrix[:, :3].T @ normal, float(normal @ (matrix[:, 3] - ours[0, 0]))
        # the order of hits as seen from the camera
        far = np.linalg.norm(self._middle[i] - self._eye) + np.linalg.norm(self._half[i])
        own = self._reach(i, normal, longest) + 2 * TRIANGLE_TEST * far
        most = own + self._reach(solid, normal, 2 * float(np.linalg.norm(self._largest[solid])))
        rough = np.abs(mesh.positions @ across.astype(np.float32) + np.float32(base))
        flat = rough <= most + 8 * UNIT_ROUNDOFF * (np.abs(across) @ self._largest[solid] + abs(base))
        if np.count_nonzero(flat) < 3:
            return 0.0
        chosen = np.flatnonzero(flat[mesh.triangles].all(1))
        theirs = mesh.positions[mesh.triangles[chosen]].astype(np.float64)
        edges = np.abs(theirs - np.roll(theirs, 1, axis=1)).max((1, 2))
        reach = own + self._reach(solid, normal, edges)
        heights, world = theirs @ across + base, theirs @ matrix[:, :3].T + matrix[:, 3]
        low, high = ours.min((0, 1)), ours.max((0, 1))
        lies = (np.abs(heights).max(1) <= reach) & self._seen_of(solid, chosen)
        lies &= ((world.min(1) <= high + reach[:, None]) & (world.max(1) >= low - reach[:, None])).all(1)
        return float((2 * reach - heights.min(1))[lies].max()) if lies.any() else 0.0

    def _reach(self, instance: int, normal: np.ndarray, longest):
        """A bound of how far points of an instance, on triangles with edges up to `longest` in object space, and tests
        of rays there, are off along `normal` of the world, whether its tree is of object space or of the world.
        """
        matrix, across = np.abs(self._maps[instance]), np.abs(normal)
        rows = matrix[:, :3].sum(1)
        terms = matrix[:, :3] @ self._largest[instance] + matrix[:, 3]
        of_edges = float(across.sum() * rows.max())  # in the world each coordinate is off by the longest edge there
        return of_edges * (_EDGE * longest + _PLACE * self._largest[instance].max()) + _CARRIED * float(across @ terms)

    def _seen_of(self, instance: int, triangles: np.ndarray) -> np.ndarray:
        """Which `triangles` of an instance are surfaces, and not of volumes alone: bool, shape [n]."""
        slots, first = self._mesh(instance).triangle_slot, int(self._scene.instances.slot_first[instance])
        of_slot = np.zeros(len(triangles), np.int32) if slots is None else slots[triangles]
        materials = self._scene.slot_materials[first + of_slot]
        used = np.unique(materials).tolist()
        return ~np.isin(materials, [each for each in used if is_boundary(self._scene.materials[each])])

    def _mesh(self, instance: int) -> Mesh:
        return self._scene.meshes[int(self._scene.instances.mesh[instance])]


def _bounding(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Whether all triangles of each instance bound volumes and nothing else, and whether some do not: bool, shape [n]
    each; both are False of what has no triangles.
    """
    boundary = np.array([is_boundary(material) for material in scene.materials])[scene.slot_materials]
    instances = scene.instances
    first, kind = kinds_of(instances.mesh.astype(np.int64) << 32 | instances.slot_first)
    alone, seen = np.zeros(len(first), bool), np.zeros(len(first), bool)
    for k, i in enumerate(first.tolist()):
        mesh, slots = scene.meshes[instances.mesh[i]], np.zeros(1, np.int32)
        if len(mesh.triangles) and mesh.radii is None:
            if mesh.triangle_slot is not None:
                slots = fact(mesh.triangle_slot, np.unique)
            found = boundary[int(instances.slot_first[i]) + slots]
            alone[k], seen[k] = found.all(), not found.all()
    return alone[kind], seen[kind]


def _box_of(positions: np.ndarray) -> np.ndarray:
    """The least and greatest corner, float64, shape [2, 3]; 0 where there are no vertices."""
    if not len(positions):
        return np.zeros((2, 3))
    return np.array([positions.min(0), positions.max(0)], np.float64)
