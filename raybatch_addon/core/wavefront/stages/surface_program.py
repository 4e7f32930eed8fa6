"""Runs the shader program of a surface: from a hit to its closures."""

import functools

import warp as wp

from ...scene.program import ProgramFeatures
from ...shading.materials import ClosureRecord
from ...shading.nodes.point import ShadingPoint
from ...shading.nodes.run import make_run
from ...shading.surface import SurfacePoint
from ..scene_data import SceneData


@wp.func
def shading_point(
    surface: SurfacePoint, incoming: wp.vec3, normal: wp.vec3, instance: int, primitive: int, barycentric: wp.vec2, ray_length: float
) -> ShadingPoint:
    """The point of a hit; `normal` is the shading normal on the side of `incoming`."""
    point = ShadingPoint()
    point.position = surface.position
    point.incoming = incoming
    point.normal = normal
    point.geometric_normal = surface.geometric_normal
    if wp.dot(incoming, surface.geometric_normal) < 0.0:
        point.geometric_normal = -surface.geometric_normal
        point.backfacing = 1
    point.instance = instance
    point.primitive = primitive
    point.barycentric = barycentric
    point.ray_length = ray_length
    return point


@functools.cache
def make_surface_program(features: ProgramFeatures) -> wp.Function:
    """Function (data, material: int, point, closures) -> int: fills `closures`, a local array of `closure_count` records; how many there are.

    Materials without program have their closures copied.
    """
    run = make_run(features)

    @wp.func
    def surface_closures(data: SceneData, material: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord)) -> int:
        first = data.nodes.program_first[material]
        if first >= 0:
            stack = wp.zeros(wp.static(features.register_count), dtype=float)
            return run(data.nodes, stack, first, point, closures)
        count = int(0)
        for c in range(data.materials.closure_first[material], data.materials.closure_first[material + 1]):
            closures[count] = data.materials.closures[c]
            count += 1
        return count

    return surface_closures
