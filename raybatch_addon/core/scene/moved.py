"""Geometry at a time: what moves lies behind the entries of the arrays of `Geometry`, which has no arrays more for it.

Behind the `instance_count` entries of `instance_mesh` are as many rows of keys (-1: the instance stays where it is),
then the steps of keys and those of vertices. Behind the maps in `instance_transform` are the keys, `KEY_FLOATS` each,
row by row. Behind the first triangles of all meshes in `mesh_triangle_first` are four numbers a mesh: what is added to
the index of a vertex for its place at the first step, and the vertices of a step (0: it does not deform), and the same
of the normals of corners. The vertices and normals of steps lie behind the others. Where `Geometry.positions` holds the
corners of triangles, so it does those of steps, and the first two numbers count corners.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import warp as wp

from ..native.build import native_source
from .flatten import FlatGeometry
from .geometry import Geometry, mat34, transform_point
from .motion import KEY_FLOATS


def with_motion(flat: FlatGeometry, corners: bool = False) -> FlatGeometry:
    """`flat` with what moves behind its arrays, for kernels alone; itself where nothing moves. With `corners` for a
    `Geometry` that is to hold those of triangles: the triangles of steps lie behind the others.
    """
    motion = flat.motion
    if motion is None:
        return flat
    place = np.zeros((len(flat.mesh_triangle_first) - 1, 4), np.int32)
    positions, normals, triangles = [flat.positions], [flat.corner_normals], [flat.triangles]
    for mesh, (vertices, own_normals) in motion.steps.items():
        own = slice(*flat.mesh_triangle_first[mesh : mesh + 2].tolist())
        first = sum(map(len, positions)) - flat.mesh_vertex_first[mesh]
        place[mesh, :2] = first, vertices.shape[1]
        if corners:
            place[mesh, :2] = 3 * (sum(map(len, triangles)) - own.start), 3 * (own.stop - own.start)
            shifts = (first + np.arange(len(vertices)) * vertices.shape[1]).astype(np.int32)
            triangles += [flat.triangles[own] + shift for shift in shifts]
        positions.append(vertices.reshape(-1, 3))
        if own_normals is not None and len(flat.corner_normals):
            place[mesh, 2:] = sum(map(len, normals)) - 3 * own.start, own_normals[0].size // 3
            normals.append(own_normals.reshape(-1, 3))
    keys = motion.keys.reshape(-1, 3, 4)
    counts = np.array([motion.keys.shape[1], motion.vertex_steps], np.int32)
    return dataclasses.replace(
        flat,
        positions=np.concatenate(positions).astype(np.float32),
        triangles=flat.triangles if len(triangles) == 1 else np.concatenate(triangles),
        corner_normals=np.concatenate(normals).astype(np.float32),
        mesh_triangle_first=np.concatenate([flat.mesh_triangle_first, place.ravel()]),
        instance_mesh=np.concatenate([flat.instance_mesh, motion.row, counts]),
        instance_transform=np.concatenate([flat.instance_transform, keys]),
    )


@wp.func_native(native_source("math/motion.h", "math/moved_transform.h", KEY_FLOATS=KEY_FLOATS))
def moved_transform(transforms: wp.array(dtype=mat34), first: int, steps: int, time: float) -> mat34:
    """Object to world at `time`, by the keys that begin at the map `first`."""


@wp.func_native(native_source("math/motion.h", "math/moved_inverse.h", KEY_FLOATS=KEY_FLOATS))
def moved_inverse(transforms: wp.array(dtype=mat34), first: int, steps: int, time: float) -> mat34:
    """World to object at `time`."""


# Out of line, so that a kernel has their code once: it asks for maps in many places, and in most scenes nothing moves.
@wp.func(inline=False)
def _transform_apart(transforms: wp.array(dtype=mat34), first: int, steps: int, time: float) -> mat34:
    """`moved_transform`, out of line."""
    return moved_transform(transforms, first, steps, time)


@wp.func(inline=False)
def _inverse_apart(transforms: wp.array(dtype=mat34), first: int, steps: int, time: float) -> mat34:
    """`moved_inverse`, out of line."""
    return moved_inverse(transforms, first, steps, time)


@wp.func
def motion_row(geometry: Geometry, instance: int) -> int:
    """The row of an instance's keys, or -1."""
    count = geometry.instance_slot_first.shape[0]
    if geometry.instance_mesh.shape[0] > count:
        return geometry.instance_mesh[count + instance]
    return -1


@wp.func
def _first_key(geometry: Geometry, row: int) -> int:
    count = geometry.instance_slot_first.shape[0]
    return count + wp.static(KEY_FLOATS // 12) * geometry.instance_mesh[2 * count] * row


@wp.func
def transform_at(geometry: Geometry, instance: int, time: float) -> mat34:
    """Object to world of an instance at `time`."""
    row = motion_row(geometry, instance)
    if row < 0:
        return geometry.instance_transform[instance]
    steps = geometry.instance_mesh[2 * geometry.instance_slot_first.shape[0]]
    return _transform_apart(geometry.instance_transform, _first_key(geometry, row), steps, time)


@wp.func
def inverse_at(geometry: Geometry, row: int, time: float) -> mat34:
    """World to object at `time`, of an instance that moves."""
    steps = geometry.instance_mesh[2 * geometry.instance_slot_first.shape[0]]
    return _inverse_apart(geometry.instance_transform, _first_key(geometry, row), steps, time)


@wp.struct
class StepPlace:
    """Where the values of a mesh's steps are at a time."""

    first: int  # what is added to an index for the step before
    stride: int  # and further for the step behind; 0: there are no steps
    share: float  # of the way between them


@wp.func
def step_place(geometry: Geometry, mesh: int, time: float, what: int) -> StepPlace:
    """The step of the vertices (`what` 0) or normals (2) of a mesh."""
    place = StepPlace()
    count = geometry.instance_slot_first.shape[0]
    if geometry.instance_mesh.shape[0] > count:
        meshes = (geometry.mesh_triangle_first.shape[0] - 1) / 5
        numbers = meshes + 1 + 4 * mesh + what
        place.stride = geometry.mesh_triangle_first[numbers + 1]
        steps = geometry.instance_mesh[2 * count + 1]
        at = time * float(steps - 1)
        step = wp.clamp(int(at), 0, steps - 2)
        place.first = geometry.mesh_triangle_first[numbers] + step * place.stride
        place.share = at - float(step)
    return place


@wp.func
def _between(values: wp.array(dtype=wp.vec3), place: StepPlace, index: int) -> wp.vec3:
    """A corner between two steps, mixed as by traversal, so that it is the same to the bit."""
    a = values[place.first + index]
    b = values[place.first + index + place.stride]
    mixed = a + place.share * (b - a)
    return wp.min(wp.max(mixed, wp.min(a, b)), wp.max(a, b))


@wp.func
def positions_at(geometry: Geometry, mesh: int, corners: wp.vec3i, time: float) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """Corners of a triangle of a mesh at `time`, in its own space [m]."""
    place = step_place(geometry, mesh, time, 0)
    if place.stride == 0:
        return geometry.positions[corners[0]], geometry.positions[corners[1]], geometry.positions[corners[2]]
    a = _between(geometry.positions, place, corners[0])
    b = _between(geometry.positions, place, corners[1])
    c = _between(geometry.positions, place, corners[2])
    return a, b, c


@wp.func
def normals_at(geometry: Geometry, mesh: int, triangle: int, time: float) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """Normals of the corners of a triangle at `time`, in the space of its mesh; between steps not of length 1."""
    first = 3 * triangle
    place = step_place(geometry, mesh, time, 2)
    if place.stride == 0:
        return geometry.corner_normals[first], geometry.corner_normals[first + 1], geometry.corner_normals[first + 2]
    a = _between(geometry.corner_normals, place, first)
    b = _between(geometry.corner_normals, place, first + 1)
    c = _between(geometry.corner_normals, place, first + 2)
    return a, b, c


@wp.func
def triangle_vertices_at(
    geometry: Geometry, instance: int, primitive: int, time: float
) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """World-space corners of a triangle at `time` [m]."""
    mesh = geometry.instance_mesh[instance]
    triangle = geometry.mesh_triangle_first[mesh] + primitive
    corners = wp.vec3i(3 * triangle, 3 * triangle + 1, 3 * triangle + 2)
    if geometry.triangles.shape[0] > 0:
        corners = geometry.triangles[triangle]
    a, b, c = positions_at(geometry, mesh, corners, time)
    matrix = transform_at(geometry, instance, time)
    return transform_point(matrix, a), transform_point(matrix, b), transform_point(matrix, c)
