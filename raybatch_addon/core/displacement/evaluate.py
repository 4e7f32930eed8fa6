"""Displacement programs run at vertices, on a device."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import warp as wp

from ..device.codegen.local_arrays import Unset
from ..device.devices import load_module
from ..device.kernel import KERNEL_OPTIONS
from ..native.structs import to_numpy
from ..programs.op import NodeData
from ..programs.point import ShadingPoint
from ..programs.run import make_run
from ..programs.table import upload_programs
from ..scene.description import Scene, Visibility
from ..scene.flatten import flatten, is_mirrored_where_baked
from ..scene.geometry import upload_geometry
from ..scene.program import ProgramFeatures, program_features
from ..shading.bsdf.materials import RECORD_FLOATS, ClosureRecord, address_of
from ..shading.images.textures import ImageTable
from .vertices import MovedVertices, cofactors, triangle_crosses, units, vertex_normals

_CORNERS = np.array([(0, 0), (1, 0), (0, 1)], np.float32)  # weights of a triangle's second and third corner


@wp.struct
class VertexWork:
    """Vertices in world space, shape [n]."""

    position: wp.array(dtype=wp.vec3)  # [m]
    normal: wp.array(dtype=wp.vec3)  # unit, of the vertex
    geometric_normal: wp.array(dtype=wp.vec3)  # unit, of the triangle that the vertex is seen from
    primitive: wp.array(dtype=int)  # that triangle
    barycentric: wp.array(dtype=wp.vec2)  # the vertex in it
    program: wp.array(dtype=int)  # index of its program
    offset: wp.array(dtype=wp.vec3)  # result [m]


@functools.cache
def make_displace(programs: ProgramFeatures) -> wp.Function:
    """Function (data, work, i: int): what the programs of a mesh, which is instance 0, move vertex `i` by."""
    run = make_run(programs)

    @wp.func
    def displace(data: NodeData, work: VertexWork, i: int):
        point = ShadingPoint()
        point.position = work.position[i]
        point.normal = work.normal[i]
        point.geometric_normal = work.geometric_normal[i]
        point.incoming = work.geometric_normal[i]
        point.primitive = work.primitive[i]
        point.barycentric = work.barycentric[i]
        point.ray_kind = wp.static(int(Visibility.CAMERA))
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        offset = wp.vec3(0.0)
        if run(data, stack, data.program_first[work.program[i]], point, closures) > 0:
            offset = closures[0].normal
        work.offset[i] = offset

    return displace


@functools.cache
def displacement_kernel(programs: ProgramFeatures) -> wp.Kernel:
    """Kernel (data, work) of `make_displace`, for all vertices."""
    displace = make_displace(programs)

    @wp.kernel(**KERNEL_OPTIONS)
    def displacement_of_vertices(data: NodeData, work: VertexWork):
        displace(data, work, wp.tid())

    return displacement_of_vertices


# (data, programs, work, vertex count, device): runs `displacement_kernel`, or one that gives the same bits
Move = Callable[[NodeData, ProgramFeatures, VertexWork, int, wp.Device], None]


def move_vertices(data: NodeData, programs: ProgramFeatures, work: VertexWork, count: int, device: wp.Device) -> None:
    """Run the kernel that is specialised on `programs`."""
    kernel = displacement_kernel(programs)
    load_module(kernel, device)
    wp.launch(kernel, count, [data, work], device=device)


def offsets_of(
    scene: Scene, moved: MovedVertices, images: ImageTable, device: wp.Device, move: Move = move_vertices
) -> np.ndarray:
    """How far vertices of the one mesh of `scene`, which its one instance places, are moved in object space [m],
    float64, shape [n, 3]. What is not finite is so.
    """
    mesh, matrix = scene.meshes[0], np.asarray(scene.instances.transform[0], np.float64)
    linear = matrix[:, :3]
    cofactor = cofactors(linear)
    faces = triangle_crosses(mesh.positions, mesh.triangles[moved.triangle])
    corner = moved.corner
    if is_mirrored_where_baked(scene)[0]:
        corner = np.array([0, 2, 1])[corner]
    slots = 0 if mesh.triangle_slot is None else mesh.triangle_slot[moved.triangle]
    programs = [material.displacement for material in scene.materials]
    features = program_features(programs)
    flat = flatten(scene)
    data = upload_programs(programs, features, scene, upload_geometry(flat, scene, device), images, device)
    work = VertexWork()
    vectors = {
        "position": mesh.positions[moved.vertex].astype(np.float64) @ linear.T + matrix[:, 3],
        "normal": units(vertex_normals(mesh)[moved.vertex] @ cofactor.T),
        "geometric_normal": units(faces @ cofactor.T),
        "offset": np.zeros((len(moved.vertex), 3)),
    }
    for name, values in vectors.items():
        setattr(work, name, wp.array(values.astype(np.float32), dtype=wp.vec3, device=device))
    work.primitive = wp.array(moved.triangle.astype(np.int32), dtype=int, device=device)
    work.barycentric = wp.array(_CORNERS[corner], dtype=wp.vec2, device=device)
    material = scene.slot_materials[scene.instances.slot_first[0] + slots]
    work.program = wp.array(np.broadcast_to(material, len(moved.vertex)).astype(np.int32), dtype=int, device=device)
    move(data, features, work, len(moved.vertex), device)
    world = to_numpy(work.offset).astype(np.float64)
    # across a flattened object nothing can move: the least solution
    with np.errstate(invalid="ignore"):
        return world @ np.linalg.pinv(linear).T
