"""All geometry of a scene as one set of arrays, in the order in which trees want it.

A mesh that is placed once is moved to world space (*baked*), so that all such meshes share one tree and are shaded
without transforms. A mesh that is placed more often stays in object space, once for all its instances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..device.bulk import add_rows, copy_rows
from ..host_memory import Room
from .description import Mesh, Scene
from .grouping.groups import Group, Member, baked_instances, groups_of
from .motion import KEY_FLOATS, apart, deforming_meshes, motion_keys, moving_maps
from .segments import pack_segments

IDENTITY = np.eye(3, 4, dtype=np.float32)


@dataclass(frozen=True)
class Merged:
    """Baked instances that share one world-space tree."""

    visibility: int  # `Visibility` bits, which all of them share
    triangle_first: int  # their triangles are contiguous in `FlatGeometry.triangles`
    triangle_count: int  # with those of empty places, which nothing meets
    instance: np.ndarray  # instance ids in the order of their triangles, int32, shape [n]
    # first triangle of each instance, counted from `triangle_first`, int32, shape [n]
    instance_triangle_first: np.ndarray


@dataclass(frozen=True)
class FlatMotion:
    """Motion of the geometry: keys of the instances that move, and vertices of the meshes that deform."""

    row: np.ndarray  # by instance, row of its keys, or -1: int32, shape [n]
    keys: np.ndarray  # `motion_keys`: float32, shape [rows, steps, KEY_FLOATS]
    # by mesh that deforms: `Mesh.motion` and `Mesh.motion_normals`
    steps: dict[int, tuple[np.ndarray, np.ndarray | None]]

    @property
    def vertex_steps(self) -> int:
        """Steps of vertices, the same of all meshes; 2 where none deforms."""
        return max((len(vertices) for vertices, _ in self.steps.values()), default=2)


@dataclass(frozen=True, kw_only=True)
class FlatGeometry:
    """All triangles; instance ids and primitive indices are those of the `Scene`. Its arrays may be among these, which
    are only read.
    """

    positions: np.ndarray  # float32, shape [vertex_count, 3]
    triangles: np.ndarray  # indices into `positions`, int32, shape [triangle_count, 3]
    corner_normals: np.ndarray  # float32, shape [triangle_count * 3, 3], or [0, 3] when all is flat
    triangle_slot: np.ndarray  # int32, shape [triangle_count], or [0] when every mesh has one slot
    mesh_triangle_first: np.ndarray  # int32, shape [mesh_count + 1]; no mesh is empty
    mesh_vertex_first: np.ndarray  # first of the vertices of each mesh, int64, shape [mesh_count + 1]
    instance_mesh: np.ndarray  # index into `mesh_triangle_first`, int32, shape [n]
    instance_transform: np.ndarray  # float32, shape [n, 3, 4]; the identity for baked instances
    merged: tuple[Merged, ...]
    shared: np.ndarray  # instances that are not baked, int32
    motion: FlatMotion | None = None  # None: nothing moves
    curves: bool = False  # whether some triangles are segments of curves, as `segments.py` packs them


Bake = Callable[[Mesh, np.ndarray], "MeshChunk"]


def flatten(
    scene: Scene, groups: Sequence[Group] | None = None, bake: Bake | None = None, room: Room = np.empty
) -> FlatGeometry:
    """Arrays of all geometry that `scene` uses; its baked instances are in `groups` (default: `groups_of` it), and
    `bake` (default: `baked_mesh`) brings them to their places. Arrays that grow with the triangles of several meshes
    are those of `room`.
    """
    bake = bake or baked_mesh
    instances, baked = scene.instances, baked_instances(scene)
    filled = np.array([len(mesh.triangles) > 0 for mesh in scene.meshes], bool)
    alive = filled[instances.mesh] if len(instances) else np.zeros(0, bool)

    chunks: list[MeshChunk] = []
    merged: list[Merged] = []
    mesh_position: dict[int, int] = {}
    triangle_first = 0
    for group in groups_of(scene) if groups is None else groups:
        members, starts, start = [], [], 0
        for member in group.members:
            i = member.instance
            if i < 0:
                chunks.append(_empty_place(member))
            else:
                mesh_position[int(instances.mesh[i])] = len(chunks)
                chunks.append(bake(scene.meshes[instances.mesh[i]], instances.transform[i]))
                members.append(i)
                starts.append(start)
            start += len(chunks[-1].triangles)
        ids, firsts = np.array(members, np.int32), np.array(starts, np.int32)
        merged.append(Merged(group.visibility, triangle_first, start, ids, firsts))
        triangle_first += start
    shared = np.flatnonzero(alive & ~baked).astype(np.int32)
    for mesh in np.flatnonzero(np.bincount(instances.mesh[shared])).tolist():
        mesh_position[mesh] = len(chunks)
        chunks.append(_keep(scene.meshes[mesh]))

    transform = np.array(instances.transform, np.float32).reshape(-1, 3, 4)
    transform[baked] = IDENTITY
    position = np.zeros(len(scene.meshes), np.int32)
    position[list(mesh_position)] = list(mesh_position.values())
    instance_mesh = position[instances.mesh]
    motion = _motion(scene, mesh_position) if apart(scene).any() else None
    return _joined(chunks, instance_mesh, transform, tuple(merged), shared, motion, room)


def _motion(scene: Scene, mesh_position: dict[int, int]) -> FlatMotion:
    moving = moving_maps(scene)
    row = np.full(len(scene.instances), -1, np.int32)
    row[moving.instance] = np.arange(len(moving.instance), dtype=np.int32)
    keys = np.zeros((0, 2, KEY_FLOATS), np.float32)
    if len(moving.instance):
        keys = motion_keys(moving.maps)
    deforms = deforming_meshes(scene)
    steps = {place: _steps_of(scene.meshes[mesh]) for mesh, place in mesh_position.items() if deforms[mesh]}
    return FlatMotion(row, keys, steps)


def _steps_of(mesh: Mesh) -> tuple[np.ndarray, np.ndarray | None]:
    assert mesh.motion is not None, "the mesh deforms"
    if mesh.radii is None:
        return mesh.motion, mesh.motion_normals
    packed = [pack_segments(each, mesh.radii, mesh.triangles, mesh.ribbons)[0] for each in mesh.motion]
    return np.stack(packed), None


def is_mirrored_where_baked(scene: Scene) -> np.ndarray:
    """Whether each instance has the last two corners of its triangles exchanged in `FlatGeometry`.

    Bool, shape [instance_count].
    """
    instances = scene.instances
    if len(instances) == 0:
        return np.zeros(0, bool)
    uses = np.bincount(instances.mesh, minlength=len(scene.meshes))
    baked = (uses[instances.mesh] == 1) & ~apart(scene)
    baked[baked] = np.linalg.det(np.asarray(instances.transform, np.float64)[baked, :, :3]) < 0
    return baked


@dataclass(frozen=True)
class MeshChunk:
    """The geometry of one mesh as it is joined to that of others."""

    positions: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray | None
    triangle_slot: np.ndarray | None
    curves: bool = False


def _keep(mesh: Mesh) -> MeshChunk:
    if mesh.radii is not None:
        return _segments(mesh, mesh.positions, mesh.radii)
    return MeshChunk(mesh.positions, mesh.triangles, mesh.corner_normals, mesh.triangle_slot)


def _empty_place(member: Member) -> MeshChunk:
    """As many vertices and triangles, all in one point."""
    positions = np.empty((member.vertex_count, 3), np.float32)
    positions[:] = member.point
    return MeshChunk(positions, np.zeros((member.triangle_count, 3), np.int32), None, None)


def _segments(mesh: Mesh, positions: np.ndarray, radii: np.ndarray) -> MeshChunk:
    corners, triangles = pack_segments(positions, radii, mesh.triangles, mesh.ribbons)
    return MeshChunk(corners, triangles, None, mesh.triangle_slot, curves=True)


def baked_mesh(mesh: Mesh, transform: np.ndarray) -> MeshChunk:
    """`mesh` in the world, where `transform` [3, 4] places it."""
    matrix = np.asarray(transform, np.float64)
    if np.array_equal(matrix, IDENTITY):
        return _keep(mesh)
    linear, offset = matrix[:, :3], matrix[:, 3]
    positions = (mesh.positions.astype(np.float64) @ linear.T + offset).astype(np.float32)
    if mesh.radii is not None:
        # round in the world too, by the mean scale, as in Cycles
        scale = np.cbrt(abs(np.linalg.det(linear)))
        return _segments(mesh, positions, (mesh.radii * scale).astype(np.float32))
    triangles, normals = mesh.triangles, mesh.corner_normals
    if normals is not None:
        # the cofactor matrix is the inverse transpose times the determinant, and exists for singular matrices too
        cofactor = np.stack(
            [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
        )
        if np.linalg.det(linear) < 0:
            cofactor = -cofactor
        turned = normals.astype(np.float64) @ cofactor.T
        length = np.linalg.norm(turned, axis=-1, keepdims=True)
        normals = (turned / np.where(length > 0, length, 1)).astype(np.float32)
    if np.linalg.det(linear) < 0:
        # A mirrored triangle keeps its front outside: exchange its last two corners
        triangles = np.ascontiguousarray(triangles[:, [0, 2, 1]])
        normals = None if normals is None else np.ascontiguousarray(normals[:, [0, 2, 1]])
    return MeshChunk(positions, triangles, normals, mesh.triangle_slot)


def _joined(chunks, instance_mesh, transform, merged, shared, motion, room) -> FlatGeometry:
    triangle_counts = [len(chunk.triangles) for chunk in chunks]
    vertex_first = np.concatenate([[0], np.cumsum([len(chunk.positions) for chunk in chunks])]).astype(np.int64)
    triangles = _rows([chunk.triangles for chunk in chunks], np.int32, room, vertex_first)
    first = np.concatenate([[0], np.cumsum(triangle_counts)]).astype(np.int32)
    # of flat meshes normals are 0: shaded flat
    corner_normals = _column([chunk.corner_normals for chunk in chunks], triangle_counts, (3, 3), np.float32, room)
    return FlatGeometry(
        positions=_rows([chunk.positions for chunk in chunks], np.float32, room),
        triangles=triangles,
        corner_normals=corner_normals.reshape(-1, 3),
        triangle_slot=_column([chunk.triangle_slot for chunk in chunks], triangle_counts, (), np.int32, room),
        mesh_triangle_first=first,
        mesh_vertex_first=vertex_first,
        instance_mesh=instance_mesh,
        instance_transform=transform,
        merged=merged,
        shared=shared,
        motion=motion,
        curves=any(chunk.curves for chunk in chunks),
    )


def _column(
    parts: list[np.ndarray | None], counts: list[int], shape: tuple[int, ...], dtype: type[np.generic], room: Room
) -> np.ndarray:
    """Values of `shape` of all triangles, 0 where a part has none; no rows where all parts have none."""
    if all(part is None for part in parts):
        return np.zeros((0, *shape), dtype)
    if len(parts) == 1:
        return np.ascontiguousarray(parts[0], dtype)
    rows, start = room((sum(counts), *shape), dtype), 0
    for part, count in zip(parts, counts, strict=True):
        out = rows[start : start + count]
        if part is None:
            out.fill(0)
        else:
            copy_rows(part, out)
        start += count
    return rows


def _rows(parts: list[np.ndarray], dtype: type[np.generic], room: Room, added: np.ndarray | None = None) -> np.ndarray:
    """All rows of `parts`, contiguous, those of each with its number of `added`; of a single one they are itself."""
    if len(parts) == 1:
        return np.ascontiguousarray(parts[0], dtype).reshape(-1, 3)
    first = np.cumsum([0, *(len(part) for part in parts)])
    rows = room((int(first[-1]), 3), dtype)
    for i, part in enumerate(parts):
        out = rows[first[i] : first[i + 1]]
        if added is None:
            copy_rows(part, out)
        else:
            add_rows(part, int(added[i]), out)
    return rows
