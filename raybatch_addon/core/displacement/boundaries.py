"""Surfaces of volumes that lie on other surfaces, as those of smoke that stands on a floor: moved off them.

A ray goes on behind a surface beyond the error of its point (`spawn_origin`), so it does not meet another face that
coincides with that one. Of two such faces rounding decides which a ray meets: one that leaves the smoke by its own face
would miss the floor. Nobody sees the faces of a volume that has no surface shader, so these are moved by a little more
than that error, into the floor, before trees are built. Then every ray meets both faces, in the same order everywhere.
Faces of two volumes that coincide stay where they are: `shading/volumes/enclosures.py` finds both.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..device.bulk import kinds_of
from ..float32 import UNIT_ROUNDOFF
from ..scene.description import ClosureKind, Material, Mesh, Scene
from ..scene.frozen import Same, fact
from ..scene.motion import apart
from .vertices import MovedVertices, cofactors, moved_mesh, triangle_crosses, units, used_meshes

# Faces coincide within this many roundings of their coordinates and of the distance to the camera
_COINCIDING = 64.0
# As far as faces are moved, in the same roundings: beyond the error of points there, and of the faces themselves
_MOVED = 256.0
# Planes of a volume's faces, at most: others are not flat enough to lie on anything
PLANES_MOST = 64
# Planes are the same where their normals differ by less than this
_PARALLEL = 1e-4
# Of what roundings are a share, at least [m]
_LEAST = 1e-30
# Vertices that are looked at in one scene, at most; surfaces beyond them are taken not to coincide
_VERTICES_MOST = 20_000_000


def is_boundary(material: Material) -> bool:
    """Whether a surface is seen by nothing but its volume: it lets all light pass."""
    passes = [c for c in material.closures if c.kind == ClosureKind.TRANSPARENT and c.weight == (1.0, 1.0, 1.0)]
    return material.volume is not None and material.program is None and len(passes) == len(material.closures) == 1


@dataclass(frozen=True)
class _Faces:
    """The planes of those faces of a mesh that bound a volume, in object space."""

    triangles: np.ndarray  # which bound it, int64, shape [n]
    plane: np.ndarray  # of each of them, int64, shape [n]
    normals: np.ndarray  # unit, float64, shape [planes, 3]
    points: np.ndarray  # on each plane, float64, shape [planes, 3]


@dataclass
class _Kept:
    """A mesh whose faces were moved, and what of the scene it was made of."""

    mesh: Mesh
    same: Same


class MovedBoundaries:
    """Meshes of the last scene whose faces were moved, for the next one: kept where arrays and maps are the same."""

    def __init__(self) -> None:
        self._kept: list[_Kept] = []

    def clear(self) -> None:
        """Forget them."""
        self._kept = []

    def moved(self, scene: Scene) -> Scene:
        """`scene` with flat faces of volumes moved off the surfaces that they lie on; itself where there are none.

        Nothing is looked at that moves or deforms while the shutter is open.
        """
        if not any(map(is_boundary, scene.materials)) or len(scene.instances) < 2:
            self.clear()
            return scene
        places = _Places(scene)
        meshes, mesh_of, kept = list(scene.meshes), scene.instances.mesh.copy(), []
        for (index, _), (bounds, which) in places.kinds.items():
            mesh = scene.meshes[index]
            faces = _faces_of(mesh, np.flatnonzero(bounds))
            if faces is None or not (shift := places.shift(mesh, faces, which)).any():
                continue
            arrays = [mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.motion]
            values = (bounds.tobytes(), shift.tobytes())
            found = next((each for each in self._kept if each.same.holds(arrays, values)), None)
            kept.append(found or _Kept(_moved(mesh, faces, shift), Same(arrays, values)))
            mesh_of[which] = len(meshes)
            meshes.append(kept[-1].mesh)
        self._kept = kept
        if not kept:
            return scene
        used, mesh_of = used_meshes(meshes, mesh_of)
        return dataclasses.replace(
            scene, meshes=tuple(used), instances=dataclasses.replace(scene.instances, mesh=mesh_of)
        )


def _faces_of(mesh: Mesh, triangles: np.ndarray) -> _Faces | None:
    """The planes of `triangles` of a mesh; None where they are none or too many, or where two of them lie on each
    other: parts that stand side by side are one volume as long as their faces coincide.
    """
    crosses = triangle_crosses(mesh.positions, mesh.triangles[triangles])
    with_area = (crosses != 0).any(1)
    triangles, normals = triangles[with_area], units(crosses[with_area])
    if not len(triangles):
        return None
    points = mesh.positions[mesh.triangles[triangles, 0]].astype(np.float64)
    height = np.einsum("ij,ij->i", normals, points)
    grain = _COINCIDING * UNIT_ROUNDOFF * float(np.abs(mesh.positions).max()) or 1.0
    keys = np.round(np.column_stack([normals / _PARALLEL, height / grain]))
    _, first, plane = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    if len(first) > PLANES_MOST:
        return None
    opposite = (normals[first] @ normals[first].T < -1 + _PARALLEL) & (
        np.abs(height[first][:, None] + height[first]) <= 2 * grain
    )
    if opposite.any():
        return None
    return _Faces(triangles, plane.reshape(-1), normals[first], points[first])


class _Places:
    """Where the surfaces of a scene are in the world."""

    def __init__(self, scene: Scene):
        self._scene = scene
        instances = scene.instances
        self._maps = np.asarray(instances.transform, np.float64)
        boxes = np.array([fact(mesh.positions, _box_of) for mesh in scene.meshes])[instances.mesh]
        linear, offset = self._maps[:, :, :3], self._maps[:, :, 3]
        self._middle = np.einsum("nij,nj->ni", linear, boxes.mean(1)) + offset
        self._half = np.einsum("nij,nj->ni", np.abs(linear), (boxes[:, 1] - boxes[:, 0]) / 2)
        # terms of the sum by which a coordinate is carried to the world, and the way from the camera
        terms = np.einsum("nij,nj->ni", np.abs(linear), np.abs(boxes).max(1)) + np.abs(offset)
        eye = np.asarray(scene.camera.transform, np.float64)[:, 3]
        far = np.linalg.norm(self._middle - eye, axis=1) + np.linalg.norm(self._half, axis=1)
        # a power of two, or meshes would be others wherever the camera is
        self._rounding = UNIT_ROUNDOFF * np.exp2(np.ceil(np.log2(np.maximum(terms.max(1) + far, _LEAST))))
        self._alone = np.array([is_boundary(material) for material in scene.materials])[scene.slot_materials]
        still = ~apart(scene)
        first, kind = kinds_of(instances.mesh.astype(np.int64) << 32 | instances.slot_first)
        # which triangles bound a volume and the instances for which they do, by mesh and these triangles
        self.kinds: dict[tuple[int, bytes], tuple[np.ndarray, list[int]]] = {}
        has_surface = np.zeros(len(first), bool)
        for k, i in enumerate(first.tolist()):
            mesh = scene.meshes[instances.mesh[i]]
            if len(mesh.triangles) == 0 or mesh.radii is not None:
                continue
            alone = self._alone[int(instances.slot_first[i]) :]
            slots = np.zeros(1, np.int32) if mesh.triangle_slot is None else fact(mesh.triangle_slot, np.unique)
            has_surface[k] = not alone[slots].all()
            if alone[slots].any():
                bounds = self._bounds(i)
                alike = self.kinds.setdefault((int(instances.mesh[i]), bounds.tobytes()), (bounds, []))
                alike[1].extend(np.flatnonzero((kind == k) & still).tolist())
        self._solid = has_surface[kind] & still
        self._left = _VERTICES_MOST

    def _bounds(self, instance: int) -> np.ndarray:
        """Which triangles of an instance bound a volume and nothing else: bool, shape [n]."""
        mesh = self._scene.meshes[self._scene.instances.mesh[instance]]
        alone = self._alone[int(self._scene.instances.slot_first[instance]) :]
        if mesh.triangle_slot is None:
            return np.full(len(mesh.triangles), alone[0])
        return alone[mesh.triangle_slot]

    def shift(self, mesh: Mesh, faces: _Faces, which: list[int]) -> np.ndarray:
        """How far each plane of `faces` is to be moved, in object space, for the instances `which` of `mesh`: float64,
        shape [planes]; 0 where it lies on nothing.
        """
        shift = np.zeros(len(faces.normals))
        for i in which:
            linear = self._maps[i, :, :3]
            if np.linalg.det(linear) == 0:
                continue
            normals = units(faces.normals @ cofactors(linear).T)
            points = faces.points @ linear.T + self._maps[i, :, 3]
            lies = self._lie_on_surfaces(mesh, faces, i, normals, points)
            # a plane moved by 1 in object space moves so far in the world
            carried = np.abs(np.einsum("kj,kj->k", faces.normals @ linear.T, normals))
            shift[lies] = np.maximum(shift, _MOVED * self._rounding[i] / carried)[lies]
        return shift

    def _lie_on_surfaces(
        self, mesh: Mesh, faces: _Faces, i: int, normals: np.ndarray, points: np.ndarray
    ) -> np.ndarray:
        """Which faces of instance `i`, whose planes are these in the world, lie on surfaces of others: bool, shape
        [planes].
        """
        lies = np.zeros(len(normals), bool)
        reach = _COINCIDING * (self._rounding + self._rounding[i])
        near = (np.abs(self._middle - self._middle[i]) <= self._half + self._half[i] + reach[:, None]).all(1)
        near &= self._solid
        near[i] = False
        others = np.flatnonzero(near)
        away = self._middle[others] @ normals.T - np.einsum("kj,kj->k", normals, points)
        meets = np.abs(away) <= self._half[others] @ np.abs(normals).T + reach[others, None]
        if not meets.any():
            return lies
        corners = self._world(i)[mesh.triangles[faces.triangles]]
        boxes = [
            (corners[faces.plane == k].min((0, 1)), corners[faces.plane == k].max((0, 1))) for k in range(len(lies))
        ]
        for other, met in zip(others.tolist(), meets):
            theirs = self._scene.meshes[self._scene.instances.mesh[other]]
            asked = np.flatnonzero(met & ~lies)
            if not len(asked) or len(theirs.positions) > self._left:
                continue
            self._left -= len(theirs.positions)
            world = self._world(other)
            for k in asked.tolist():
                flat = np.abs((world - points[k]) @ normals[k]) <= reach[other]
                if np.count_nonzero(flat) >= 3:
                    found = world[theirs.triangles[flat[theirs.triangles].all(1) & ~self._bounds(other)]]
                    low, high = boxes[k][0] - reach[other], boxes[k][1] + reach[other]
                    lies[k] = ((found.min(1) <= high) & (found.max(1) >= low)).all(1).any()
        return lies

    def _world(self, instance: int) -> np.ndarray:
        """Vertices of an instance in the world, float64, shape [vertex_count, 3]."""
        mesh, matrix = self._scene.meshes[self._scene.instances.mesh[instance]], self._maps[instance]
        return mesh.positions @ matrix[:, :3].T + matrix[:, 3]


def _box_of(positions: np.ndarray) -> np.ndarray:
    """The least and greatest corner, float64, shape [2, 3]; 0 where there are no vertices."""
    if not len(positions):
        return np.zeros((2, 3))
    return np.array([positions.min(0), positions.max(0)], np.float64)


def _moved(mesh: Mesh, faces: _Faces, shift: np.ndarray) -> Mesh:
    """`mesh` with each plane of `faces` moved along its normal by `shift`, in object space. The arrays are frozen."""
    bounds = np.zeros(len(mesh.triangles), bool)
    bounds[faces.triangles] = True
    moved = MovedVertices.of(mesh, bounds)
    # vertices in one place are moved together, by each plane that meets there once
    rows = np.ascontiguousarray(mesh.positions + np.float32(0)).view("V12").ravel()
    place = np.unique(rows, return_inverse=True)[1].reshape(-1)
    corners = place[mesh.triangles[faces.triangles]].reshape(-1)
    pairs = np.unique(np.column_stack([corners, np.repeat(faces.plane, 3)]), axis=0)
    offset = np.zeros((int(place.max()) + 1, 3))
    np.add.at(offset, pairs[:, 0], faces.normals[pairs[:, 1]] * shift[pairs[:, 1], None])
    found = moved_mesh(mesh, moved, offset[place[moved.vertex]], np.zeros(len(mesh.triangles), bool))
    return found if mesh.base_positions is None else dataclasses.replace(found, base_positions=mesh.base_positions)
