"""Light that programs give: of the world in a direction, of a point on a surface."""

import functools

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...float32 import LARGEST
from ...programs.point import ShadingPoint
from ...programs.run import make_run
from ...scene.description import ClosureKind
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import RECORD_FLOATS, ClosureRecord, address_of
from ...shading.surface import make_surface
from ..scene.shading_data import SceneData
from .surface.program import fixed_closure_count, fixed_closures, make_surface_program, program_of, shading_point


@wp.func
def emission_of(closures: wp.array(dtype=ClosureRecord), count: int) -> wp.vec3:
    """Radiance of all emission closures [W/(m² sr)]."""
    radiance = wp.vec3(0.0)
    for c in range(count):
        if closures[c].kind == wp.static(int(ClosureKind.EMISSION)):
            radiance += closures[c].weight
    return radiance


@functools.cache
def make_world_emission(programs: ProgramFeatures) -> wp.Function:
    """Function (data, origin, direction, ray_kind: int, bounce: int, passed: int) -> vec3: the world's radiance."""
    run = make_run(programs)

    @wp.func
    def world_emission(
        data: SceneData, origin: wp.vec3, direction: wp.vec3, ray_kind: int, bounce: int, passed: int
    ) -> wp.vec3:
        point = ShadingPoint()
        point.position = origin
        point.incoming = -direction
        point.normal = -direction
        point.geometric_normal = -direction
        point.instance = -1
        point.ray_length = LARGEST  # as in Cycles
        point.ray_kind = ray_kind
        point.bounce = bounce
        point.passed = passed
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        return emission_of(closures, run(data.world_nodes, stack, data.world_nodes.program_first[0], point, closures))

    return world_emission


@functools.cache
def make_surface_emission(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Function:
    """Function (data, instance: int, primitive: int, barycentric: vec2, incoming: vec3, distance: float, bounce: int,
    passed: int, history: int) -> vec3: radiance towards `incoming`; bounce, passed and history as `ShadingPoint` has
    them.
    """
    surface_point = make_surface(instancing, smooth_normals).point
    run_surface = make_surface_program(programs)

    @wp.func
    def surface_emission(
        data: SceneData,
        instance: int,
        primitive: int,
        barycentric: wp.vec2,
        incoming: wp.vec3,
        distance: float,
        bounce: int,
        passed: int,
        history: int,
    ) -> wp.vec3:
        surface = surface_point(data.geometry, instance, primitive, barycentric, 0.5)
        point = shading_point(surface, incoming, instance, primitive, barycentric, distance)
        point.bounce = bounce
        point.passed = passed
        point.history = history
        program = program_of(data, surface.material)
        address = fixed_closures(data, surface.material)
        count = int(0)
        if program >= 0:
            records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
            count = run_surface(data, program, point, records)
            address = address_of(records)
        else:
            count = fixed_closure_count(data, surface.material)
        return emission_of(
            wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord), count
        )

    return surface_emission
