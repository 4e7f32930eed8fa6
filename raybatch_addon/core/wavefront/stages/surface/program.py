"""Runs the shader program of a surface: from a hit to its closures."""

import functools

import warp as wp

from ....device.codegen.local_arrays import Unset
from ....programs.op import NodeData
from ....programs.ops.inputs.geometry_inputs import footprint_axis, pixel_footprint
from ....programs.point import ShadingPoint
from ....programs.run import make_run
from ....scene.moved import triangle_vertices_at
from ....scene.program import ProgramFeatures
from ....shading.bsdf.materials import ClosureRecord, address_of, address_of_closure
from ....shading.surface import SurfacePoint
from ...scene.shading_data import SceneData


@wp.func
def shading_point(
    surface: SurfacePoint, incoming: wp.vec3, instance: int, primitive: int, barycentric: wp.vec2, ray_length: float
) -> ShadingPoint:
    """The point of a hit. Both normals are turned by the side of the triangle that is met, whichever way the
    interpolated one leans.
    """
    point = ShadingPoint()
    point.position = surface.position
    point.incoming = incoming
    point.normal = surface.normal
    point.geometric_normal = surface.geometric_normal
    if wp.dot(incoming, surface.geometric_normal) < 0.0:
        point.normal = -surface.normal
        point.geometric_normal = -surface.geometric_normal
        point.backfacing = 1
    point.instance = instance
    point.primitive = primitive
    point.barycentric = barycentric
    point.ray_length = ray_length
    point.time = surface.time
    return point


# Share of a pixel that heights are compared over, as in Blender; and how many roundings of a position it is at least
BUMP_STEP = 0.1
_ROUNDINGS = 256.0


@wp.func
def with_steps(data: NodeData, point: ShadingPoint) -> ShadingPoint:
    """`point`, its steps filled in: in the plane of its triangle, a share of the pixel's width where its ray met it."""
    n = point.geometric_normal
    p = point.position
    largest = wp.max(wp.abs(p[0]), wp.max(wp.abs(p[1]), wp.abs(p[2])))
    length = wp.max(wp.static(BUMP_STEP) * pixel_footprint(data, point), wp.static(_ROUNDINGS * 2.0**-24) * largest)
    # the axes that Blender takes: where a height is curved over a step, they matter
    across = footprint_axis(n)
    point.step_x = length * across
    point.step_y = length * wp.cross(n, across)
    a, b, c = triangle_vertices_at(data.geometry, point.instance, point.primitive, point.time)
    point.step_x_barycentric = _in_triangle(b - a, c - a, point.step_x)
    point.step_y_barycentric = _in_triangle(b - a, c - a, point.step_y)
    return point


@wp.func
def _in_triangle(edge_1: wp.vec3, edge_2: wp.vec3, step: wp.vec3) -> wp.vec2:
    """A step in the plane of a triangle as weights of its second and third corners; 0 where it has no area."""
    normal = wp.cross(edge_1, edge_2)
    square = wp.dot(normal, normal)
    result = wp.vec2(0.0, 0.0)
    if square > 0.0:
        result = wp.vec2(
            wp.dot(wp.cross(step, edge_2), normal) / square, wp.dot(wp.cross(edge_1, step), normal) / square
        )
    return result


@wp.func
def program_of(data: SceneData, material: int) -> int:
    """The word of code at which the program of `material` begins; -1 where it has none."""
    if data.nodes.program_first.shape[0] > 0:  # the general kernels shade scenes without programs too
        return data.nodes.program_first[material]
    return -1


@wp.func
def passing_program_of(data: SceneData, material: int) -> int:
    """The word of code at which that part of the program of `material` begins that makes its transparent closures; -1
    where it has none.
    """
    count = data.nodes.program_first.shape[0]
    if count > 0:
        return data.nodes.program_first[count - data.materials.records.shape[0] + material]
    return -1


@wp.func
def fixed_closures(data: SceneData, material: int) -> wp.uint64:
    """The address of the first closure of a material without program, which nobody may write."""
    return address_of_closure(data.materials.closures, data.materials.records[material].closure_first)


@wp.func
def fixed_closure_count(data: SceneData, material: int) -> int:
    """How many closures a material without program has."""
    return data.materials.records[material].closure_end - data.materials.records[material].closure_first


@functools.cache
def make_surface_program(features: ProgramFeatures) -> wp.Function:
    """Function (data, first: int, point, records) -> int: runs the program at word `first`, which writes closures to
    `records`, a local array of `closure_count` records as floats; their number.
    """
    run = make_run(features)
    bumps = "bump" in features.ops

    @wp.func
    def run_surface(data: SceneData, first: int, point: ShadingPoint, records: wp.array(dtype=Unset)) -> int:
        stack = wp.zeros(wp.static(features.register_count), dtype=float)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(features.closure_count),), dtype=ClosureRecord)
        if wp.static(bumps):
            return run(data.nodes, stack, first, with_steps(data.nodes, point), closures)
        return run(data.nodes, stack, first, point, closures)

    return run_surface
