"""Stage: shadow rays of scenes in which surfaces may let them through are back. Next: `trace` again behind such a
surface, or shading.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...film.tile import FilmTile
from ...rays import Rays
from ...scene.description import Visibility
from ...shading.bsdf.bsdf import ClosureFeatures, make_bsdf
from ...shading.bsdf.materials import RECORD_FLOATS, ClosureRecord, address_of
from ...shading.segments import make_surface_point
from ...shading.surface import material_at, spawn_origin
from ..passes.light import make_add_light
from ..rays import SHADOW_PASS, Paths, Status, bounce_to_light, time_of
from ..scene.shading_data import SceneData
from .connect import ConnectFeatures, make_arrived
from .limits import PathLimits, has_light
from .surface.features import SurfaceFeatures
from .surface.history import DEPTHS
from .surface.program import (
    fixed_closure_count,
    fixed_closures,
    make_surface_program,
    passing_program_of,
    shading_point,
)
from .work import ShadingStage, TileWork

CONNECT = int(ShadingStage.CONNECT)
_SHADOW_NEW = int(Status.SHADOW_NEW)
_SHADOW_OUT = int(Status.SHADOW_OUT)


@functools.cache
def make_connect_transparent(features: SurfaceFeatures, connect: ConnectFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it: shadow rays of scenes in which surfaces may let them through.

    They come back with closest hits, in order, and go on behind each surface that is not opaque. Of a program only the
    part runs that makes transparent closures; the rest, often nearly all of it, would change nothing. In the general
    tier it is the stage `CONNECT` too, whose rays end at any hit: light that arrives is one piece of code.
    """
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    transparency = make_bsdf(ClosureFeatures(features.closures)).transparency
    arrived = make_arrived(connect)
    add_light = make_add_light(features.splits_light, features.light_groups)
    programs = features.programs
    run_surface = make_surface_program(programs)

    @wp.func
    def connect_transparent(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, slot: int
    ):
        path = slot - paths.status.shape[0]
        status = paths.status[path] & ~wp.static(_SHADOW_OUT)
        passed = paths.passed[path]
        if rays.hit_instance[slot] < 0:
            brought = arrived(data, limits, paths, rays, path, slot)
            add_light(paths, path, brought, bounce_to_light(status), True)
        elif wp.static(not programs.apart) or work.stage != wp.static(CONNECT):
            instance = rays.hit_instance[slot]
            primitive = rays.hit_primitive[slot]
            material = material_at(data.geometry, instance, primitive)
            # what is opaque need not be shaded to end a ray
            if data.materials.records[material].is_clear != 0 and has_light(paths.shadow_light[path]):
                uv = rays.hit_uv[slot]
                surface = surface_point(data.geometry, instance, primitive, uv, time_of(rays, path))
                if wp.static(bool(programs)):
                    address = fixed_closures(data, material)
                    first = int(0)
                    end = int(0)
                    program = passing_program_of(data, material)
                    if program >= 0:
                        point = shading_point(
                            surface,
                            -rays.direction[slot],
                            instance,
                            primitive,
                            uv,
                            paths.shadow_t[path] + rays.hit_t[slot],
                        )
                        point.ray_kind = wp.static(int(Visibility.SHADOW))
                        point.bounce = bounce_to_light(status)
                        if wp.static(features.path_history):
                            point.history = paths.shadow_history[path] & wp.static(DEPTHS)
                        point.passed = passed / wp.static(SHADOW_PASS)
                        records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
                        end = run_surface(data, program, point, records)
                        address = address_of(records)
                    else:
                        end = fixed_closure_count(data, material)
                    closures = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
                else:
                    closures = data.materials.closures
                    first = data.materials.records[material].closure_first
                    end = data.materials.records[material].closure_end
                light = wp.cw_mul(paths.shadow_light[path], transparency(closures, first, end))
                if has_light(light) and passed / wp.static(SHADOW_PASS) < limits.transparent_bounce_max:
                    direction = rays.direction[slot]
                    origin = spawn_origin(surface.position, surface.error, surface.geometric_normal, direction)
                    ray = origin - rays.origin[slot]
                    t_max = rays.t_max[slot]
                    if t_max < wp.inf:
                        # to the same end: moved aside only, the ray could find the light that it was aimed at in its
                        # own way
                        left = t_max * direction - ray
                        t_max = wp.length(left)
                        if t_max > 0.0:
                            rays.direction[slot] = left / t_max
                    rays.t_max[slot] = t_max
                    if wp.static(bool(programs)):
                        paths.shadow_t[path] = paths.shadow_t[path] + wp.dot(ray, direction)
                    rays.origin[slot] = origin
                    paths.shadow_light[path] = light
                    paths.passed[path] = passed + wp.static(SHADOW_PASS)
                    status = status | wp.static(_SHADOW_NEW)
        paths.status[path] = status

    return connect_transparent
