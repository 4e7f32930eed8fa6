"""Surfaces of volumes that lie on other surfaces, as those of smoke that stands on a floor: moved off them.

A ray goes on behind a surface beyond the error of its point (`spawn_origin`), so it does not meet another face that
coincides with that one. Of two such faces rounding decides which a ray meets: one that leaves the smoke by its own face
would miss the floor. Nobody sees the faces of a mesh whose material is a volume alone, so its flat faces are moved
inwards from the surface that they lie on, beyond the errors of both, before trees are built. Then rays meet both, in
the same order everywhere. Where that is more than `MOVED_MOST` of the volume, and between two volumes, faces stay where
they are: `shading/volumes/enclosures.py` finds those of volumes that coincide.
"""

from __future__ import annotations

import dataclasses
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
# Instances of volumes at most, and pairs of them and of surfaces; where there are more, all stay where they are
_BOUNDARIES_MOST, _PAIRS_MOST = 4096, 30_000_000
# Vertices of surfaces that are looked at in one scene, at most; larger meshes than are left are taken not to coincide
_VERTICES_MOST = 4_000_000
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

        Nothing is looked at that moves or deforms while the shutter is open. Arrays that are made are frozen.
        """
        if not any(map(is_boundary, scene.materials)) or len(scene.instances) < 2:
            self.clear()
            return scene
        places = _Places(scene)
        meshes, mesh_of, kept = list(scene.meshes), scene.instances.mesh.copy(), []
        for index, which in places.boundaries.items():
            if not places.lie_near(which):
                continue
            mesh = scene.meshes[index]
            faces = fact(mesh.positions, flat_faces, mesh.triangles)
            shift = places.shift(index, faces, which)
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
        self._left = _VERTICES_MOST
        alone, seen = _bounding(scene)
        still = ~apart(scene)
        self._solids = np.flatnonzero(seen & still)
        size = [len(scene.meshes[index].positions) for index in instances.mesh[self._solids].tolist()]
        self._solids = self._solids[np.argsort(size, kind="stable")]
        bounded = np.flatnonzero(alone & still)
        self.boundaries: dict[int, list[int]] = {}
        if len(bounded) <= _BOUNDARIES_MOST and len(bounded) * len(self._solids) <= _PAIRS_MOST:
            for i in bounded.tolist():
                self.boundaries.setdefault(int(instances.mesh[i]), []).append(i)

    def lie_near(self, which: list[int]) -> bool:
        """Whether the boxes of any of the instances `which` touch those of surfaces."""
        return any(len(self._near(i)) > 0 for i in which)

    def _near(self, i: int) -> np.ndarray:
        """The surfaces whose boxes touch that of instance `i`, those of the smallest meshes first."""
        solids = self._solids
        reach = (self._half[solids] + self._half[i]) * (1 + MOVED_MOST)
        return solids[(np.abs(self._middle[solids] - self._middle[i]) <= reach).all(1)]

    def shift(self, index: int, faces: FlatFaces, which: list[int]) -> np.ndarray:
        """How far each plane of `faces` is to be moved inwards, in object space, for the instances `which` of the mesh
        `index`: float64, shape [planes]; 0 where it lies on nothing.
        """
        shift = np.zeros(len(faces.normals))
        for i in which if len(shift) else ():
            linear = self._maps[i, :, :3]
            if np.linalg.det(linear) != 0:
                normals = units(faces.normals @ cofactors(linear).T)
                # a plane moved by 1 in object space moves so far in the world
                carried = np.abs(np.einsum("kj,kj->k", faces.normals @ linear.T, normals))
                shift = np.maximum(shift, self._beyond(i, index, faces, normals) / carried)
        # powers of two, or meshes would be others wherever the camera is
        return np.where(shift > 0, np.exp2(np.ceil(np.log2(np.where(shift > 0, shift, 1)))), 0)

    def _beyond(self, i: int, index: int, faces: FlatFaces, normals: np.ndarray) -> np.ndarray:
        """How far planes of instance `i`, whose normals in the world are these, are to be moved inwards in the world,
        until all surfaces on which they lie are met apart from them: float64, shape [planes].
        """
        beyond = np.zeros(len(normals))
        solids = self._near(i)
        if not len(solids):
            return beyond
        points = faces.points @ self._maps[i, :, :3].T + self._maps[i, :, 3]
        most = MOVED_MOST * 2 * np.abs(normals) @ self._half[i]
        away = self._middle[solids] @ normals.T - np.einsum("kj,kj->k", normals, points)
        meets = np.abs(away) <= self._half[solids] @ np.abs(normals).T + most
        corners = None
        for solid, asked in zip(solids[meets.any(1)].tolist(), meets[meets.any(1)]):
            size = len(self._mesh(solid).positions)
            if size > self._left:
                break  # others are larger
            self._left -= size
            if corners is None:
                mesh = self._scene.meshes[index]
                corners = self._world(i)[mesh.triangles]
            for k in np.flatnonzero(asked).tolist():
                found = self._needed(i, solid, corners[faces.plane == k], faces.longest[k], normals[k], points[k])
                if 2 * found <= most[k]:  # before it is rounded up
                    beyond[k] = max(beyond[k], found)
        return beyond

    def _needed(
        self, i: int, solid: int, ours: np.ndarray, longest: float, normal: np.ndarray, point: np.ndarray
    ) -> float:
        """How far faces `ours` of instance `i`, corners in the world [n, 3, 3], with edges up to `longest` in object
        space, are to be moved against `normal` to be met apart from those of `solid`; 0 where they do not coincide.
        """
        mesh, matrix = self._mesh(solid), self._maps[solid]
        # heights above the plane, from object space
        across, base = matrix[:, :3].T @ normal, float(normal @ (matrix[:, 3] - point))
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
        of rays there, are off along `normal` of the world.
        """
        matrix = np.abs(self._maps[instance])
        terms = matrix[:, :3] @ self._largest[instance] + matrix[:, 3]
        across = np.abs(normal)
        of_mesh = float(across @ matrix[:, :3].sum(1))
        return of_mesh * (_EDGE * longest + _PLACE * self._largest[instance].max()) + _CARRIED * float(across @ terms)

    def _seen_of(self, instance: int, triangles: np.ndarray) -> np.ndarray:
        """Which `triangles` of an instance are surfaces, and not of volumes alone: bool, shape [n]."""
        slots, first = self._mesh(instance).triangle_slot, int(self._scene.instances.slot_first[instance])
        of_slot = np.zeros(len(triangles), np.int32) if slots is None else slots[triangles]
        materials = self._scene.slot_materials[first + of_slot]
        used = np.unique(materials).tolist()
        return ~np.isin(materials, [each for each in used if is_boundary(self._scene.materials[each])])

    def _mesh(self, instance: int) -> Mesh:
        return self._scene.meshes[int(self._scene.instances.mesh[instance])]

    def _world(self, instance: int) -> np.ndarray:
        """Vertices of an instance in the world, float64, shape [vertex_count, 3]."""
        return self._mesh(instance).positions @ self._maps[instance, :, :3].T + self._maps[instance, :, 3]


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
