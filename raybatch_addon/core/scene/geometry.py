"""All triangles of a scene on the device."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
from ..device.bulk import copy_rows, take_rows
from ..device.locked import OWN_PAGES_LEAST, locked_empty, locked_view
from ..native.build import native_source
from ..native.structs import to_numpy
from .description import Scene
from .features import needs_instancing
from .flatten import FlatGeometry

mat34 = wp.types.matrix(shape=(3, 4), dtype=wp.float32)
# Triangles whose corners an array can hold: its entries are counted in int32
CORNERS_MOST = (2**31 - 1) // 3


@wp.struct
class Geometry:
    """Device arrays of `FlatGeometry`. What moves lies behind the entries that are listed here (`moved.py`)."""

    # [m], shape [vertex_count], or the corners of every triangle, shape [3 * triangle_count]
    positions: wp.array(dtype=wp.vec3)
    # indices into `positions`, shape [triangle_count]; empty if `positions` holds the corners
    triangles: wp.array(dtype=wp.vec3i)
    mesh_triangle_first: wp.array(dtype=int)  # shape [mesh_count + 1]
    instance_mesh: wp.array(dtype=int)  # shape [instance_count]
    instance_transform: wp.array(dtype=mat34)  # object to world, shape [instance_count]
    # Corner normals, shape [3 * triangle_count], 0 where flat; no entries when the whole scene is flat
    corner_normals: wp.array(dtype=wp.vec3)
    triangle_slot: wp.array(dtype=int)  # material slot, shape [triangle_count]; no entries when all are in slot 0
    instance_slot_first: wp.array(dtype=int)  # shape [instance_count]
    slot_materials: wp.array(dtype=int)  # material of slot s of an instance: [instance_slot_first + s]
    instancing: int  # 1: `instance_transform` takes points to the world, which are in it already where this is 0


# Kernels run the header, which traversal has too. The bodies are what ops folded on the host run (`as_python`).
@wp.func_native(native_source("math/transform.h", "math/transform_point.h"))
def transform_point(m: mat34, p: wp.vec3) -> wp.vec3:
    """The point `p` under the affine map `m`."""
    return wp.vec3(
        m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3],
        m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3],
        m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3],
    )


@wp.func_native(native_source("math/transform.h", "math/transform_vector.h"))
def transform_vector(m: mat34, d: wp.vec3) -> wp.vec3:
    """The direction `d` under the linear part of `m`, not normalised, so that ray distances stay those of the world."""
    return wp.vec3(
        m[0, 0] * d[0] + m[0, 1] * d[1] + m[0, 2] * d[2],
        m[1, 0] * d[0] + m[1, 1] * d[1] + m[1, 2] * d[2],
        m[2, 0] * d[0] + m[2, 1] * d[1] + m[2, 2] * d[2],
    )


@wp.func
def image_reach(m: mat34, reach: wp.vec3) -> wp.vec3:
    """Half the extent along each axis of the image under `m` of a box whose half extent is `reach`."""
    return wp.vec3(
        wp.abs(m[0, 0]) * reach[0] + wp.abs(m[0, 1]) * reach[1] + wp.abs(m[0, 2]) * reach[2],
        wp.abs(m[1, 0]) * reach[0] + wp.abs(m[1, 1]) * reach[1] + wp.abs(m[1, 2]) * reach[2],
        wp.abs(m[2, 0]) * reach[0] + wp.abs(m[2, 1]) * reach[1] + wp.abs(m[2, 2]) * reach[2],
    )


@wp.func
def corners_of(geometry: Geometry, triangle: int) -> wp.vec3i:
    """Indices in `positions` of the corners of `triangle`."""
    if geometry.triangles.shape[0] == 0:
        return wp.vec3i(3 * triangle, 3 * triangle + 1, 3 * triangle + 2)
    return geometry.triangles[triangle]


@wp.func
def triangle_vertices(geometry: Geometry, instance: int, primitive: int) -> tuple[wp.vec3, wp.vec3, wp.vec3]:
    """World-space corners [m] of triangle `primitive` of the mesh that `instance` places."""
    triangle = corners_of(geometry, geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive)
    matrix = geometry.instance_transform[instance]
    a = transform_point(matrix, geometry.positions[triangle[0]])
    b = transform_point(matrix, geometry.positions[triangle[1]])
    c = transform_point(matrix, geometry.positions[triangle[2]])
    return a, b, c


def upload_geometry(
    flat: FlatGeometry, scene: Scene, device: wp.Device, on_host: bool = False, in_place: bool = False
) -> Geometry:
    """`flat`, the geometry of `scene`, on `device`.

    With `on_host` arrays that grow with the triangles stay in host memory, pinned for a CUDA device, which reads them
    through the bus. There the corners of a triangle lie together where an array can hold all (`holds_corners`), so that
    it takes two reads instead of five.
    With `in_place` arrays are read where they lie: then nobody may change them as long as the result lives.
    """
    geometry = Geometry()
    geometry.instancing = int(needs_instancing(scene))
    triangles, positions = [("triangles", flat.triangles, wp.vec3i)], flat.positions
    together = on_host and holds_corners(flat)
    if together:
        triangles = [("triangles", flat.triangles[:0], wp.vec3i)]
        flat = replace(flat, positions=flat.positions[:0])
    per_mesh = [("mesh_triangle_first", flat.mesh_triangle_first, int), ("instance_mesh", flat.instance_mesh, int)]
    for name, values, dtype in triangles + per_mesh + _what_moves(flat, scene):
        stays = on_host and device.is_cuda and name in _BY_TRIANGLE
        if stays:
            array = readable(values, dtype, device) if in_place else host_array(values, dtype, device)
        elif in_place and device.is_cpu:
            array = wp.array(np.ascontiguousarray(values), dtype=dtype, device=device, copy=False)
        else:
            array = uploaded(values, dtype, device)
        setattr(geometry, name, array)
    if together:
        geometry.positions = _corners(positions, flat.triangles, device)
    return geometry


def holds_corners(flat: FlatGeometry) -> bool:
    """Whether one array can hold the corners of all triangles."""
    return len(flat.triangles) <= CORNERS_MOST


def _corners(positions: np.ndarray, triangles: np.ndarray, device: wp.Device) -> wp.array:
    """The corners of every triangle in host memory, as an array of `device`."""
    count = triangles.size
    on_host = locked_empty(count, wp.vec3) if device.is_cuda else wp.empty(count, dtype=wp.vec3, device="cpu")
    take_rows(positions, triangles.reshape(-1), to_numpy(on_host))
    return _alias(on_host, device) if device.is_cuda else on_host


_BY_INSTANCE = ("instance_transform", "instance_slot_first", "slot_materials")
_BY_TRIANGLE = ("triangles", "positions", "corner_normals", "triangle_slot")


def uploaded(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """An array on `device`; a large one is locked where it lies meanwhile, so that a CUDA device copies it by itself
    (measured: 55 GB/s instead of 9).
    """
    if not (device.is_cuda and values.nbytes >= OWN_PAGES_LEAST and values.flags.c_contiguous):
        return wp.array(values, dtype=dtype, device=device)
    there = locked_view(values, dtype, wp.get_device("cpu"))
    out = wp.array(values, dtype=dtype, device=device) if there is None else there.to(device)
    wp.synchronize_stream(device.stream)  # what is locked is given back now, here or by another device
    return out


def readable(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """An array that `device` reads where `values` lie; on CUDA they are locked as long as it lives, and copied where
    they cannot be. Nobody may change them as long.
    """
    values = np.ascontiguousarray(values)
    if not device.is_cuda:
        return wp.array(values, dtype=dtype, device=device, copy=False)
    there = locked_view(values, dtype, device)
    return host_array(values, dtype, device) if there is None else there


def host_array(values: np.ndarray, dtype: type, device: wp.Device) -> wp.array:
    """An array of the CUDA device `device` that lies in pinned memory of the host."""
    source = wp.array(values, dtype=dtype, device="cpu", copy=False)
    pinned = locked_empty(source.shape, dtype)
    copy_rows(to_numpy(source), to_numpy(pinned))
    return _alias(pinned, device)


def _alias(pinned: wp.array, device: wp.Device) -> wp.array:
    """Pinned memory as an array of `device`: the host's addresses are the device's too."""
    if pinned.size == 0:
        return wp.zeros(0, dtype=pinned.dtype, device=device)
    return wp.array(
        ptr=pinned.ptr,
        dtype=pinned.dtype,
        shape=pinned.shape,
        device=device,
        deleter=lambda pointer, size, kept=pinned: None,
    )


def update_geometry(geometry: Geometry, flat: FlatGeometry, scene: Scene, cut_anew: bool = False) -> None:
    """Make `geometry` hold `flat`, which has the same meshes with as many triangles; these are others if `cut_anew`.

    Arrays of the same size are overwritten.
    """
    device = geometry.triangles.device
    moving = [("instance_mesh", flat.instance_mesh, int)] if flat.motion else []
    triangles = [("triangles", flat.triangles, wp.vec3i)] if cut_anew else []
    for name, values, dtype in _what_moves(flat, scene) + moving + triangles:
        array = getattr(geometry, name)
        if array.size == len(values):
            wp.copy(array, wp.array(values, dtype=dtype, device="cpu", copy=False))
        else:
            setattr(geometry, name, wp.array(values, dtype=dtype, device=device))


def update_instances(geometry: Geometry, flat: FlatGeometry, scene: Scene) -> None:
    """Make `geometry` hold the instances of `flat`, which has the same meshes, none of which moves."""
    device = geometry.triangles.device
    geometry.instancing = int(needs_instancing(scene))
    geometry.instance_mesh = wp.array(flat.instance_mesh, dtype=int, device=device)
    for name, values, dtype in _what_moves(flat, scene):
        if name in _BY_INSTANCE:
            setattr(geometry, name, wp.array(values, dtype=dtype, device=device))


def _what_moves(flat: FlatGeometry, scene: Scene) -> list[tuple[str, np.ndarray, Any]]:
    """Names, contents and element types of the arrays that may change where triangles do not."""
    return [
        ("positions", flat.positions, wp.vec3),
        ("instance_transform", flat.instance_transform, mat34),
        ("corner_normals", flat.corner_normals, wp.vec3),
        ("triangle_slot", flat.triangle_slot, int),
        ("instance_slot_first", scene.instances.slot_first, int),
        ("slot_materials", scene.slot_materials, int),
    ]
