"""Stage: where a path met a surface, a light is chosen, and a point on it (next-event estimation). Next:
`shade_surface`, which weighs its light by the material.

On a GPU this is a kernel of its own: what was found waits in the path's slot for a shadow ray, which is not under way
meanwhile. A CPU has room for the code of both stages in one kernel, which computes the vertex once.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ....film.tile import FilmTile
from ....rays import Rays
from ....scene.description import SCATTERED_RAYS, LightKind
from ....scene.features import narrow
from ....shading.lights.cells.cells import is_cell
from ....shading.lights.choice import lit_point
from ....shading.lights.lights import LightFeatures, make_lights
from ....shading.lights.links import group_of, owner_of
from ....shading.lights.shapes import LAMP_PROGRAM, LightSample
from ....shading.lights.table import LightTable
from ....shading.sequences.keys import LIGHT
from ....shading.sequences.sampler import make_sampler
from ...catchers.copies import shines_on_copy
from ...passes.light import has_groups
from ...rays import Paths
from ...scene.shading_data import SceneData
from ..limits import PathLimits
from ..work import TileWork
from .vertex import Vertex, VertexFeatures, make_vertex

# A number that a float holds exactly: bits of `LightSample.delta` and `casts_shadow`, then its visibility to rays that
# surfaces scatter, and program
_CASTS_SHADOW, _VISIBILITY_SHIFT, _PROGRAM_SHIFT = 2, 2, 7


@dataclass(frozen=True, kw_only=True)
class AimFeatures:
    """Features that the stage is specialised on; the fields are those of `SceneFeatures`."""

    instancing: bool
    smooth_normals: bool
    curves: bool
    transparency: bool
    subsurface: bool
    shadow_rays: bool
    sample_sequence: str
    moving: bool
    lights: tuple[LightKind, ...]
    light_sphere: bool
    light_choice: bool
    mesh_lights: bool
    mesh_programs: bool
    world_light: bool
    light_programs: bool
    lamp_programs: bool
    bounces_by_kind: bool
    light_links: bool = False
    shadow_links: bool = False
    light_groups: bool = False
    light_portals: bool = False
    volume_lights: bool = False
    light_bounces: bool = False
    catchers: bool = False


@wp.func
def is_aimed(lights: LightTable, limits: PathLimits, v: Vertex) -> bool:
    """Whether light is sampled at a vertex. Without emitters, of which kernels need not know, paths have no slots for
    shadow rays.
    """
    return lights.emitter_count > 0 and v.pixel.x < limits.nee_end and not v.last


@functools.cache
def make_choose_light(features: AimFeatures) -> wp.Function:
    """Function (data, paths, path: int, v: Vertex) -> LightSample: the light that is aimed at from a vertex where
    `is_aimed`. What its program needs is written to the path.
    """
    light_sample = make_lights(narrow(features, LightFeatures)).sample
    sample_3d = make_sampler(features.sample_sequence).sample_3d

    @wp.func
    def choose_light(data: SceneData, paths: Paths, path: int, v: Vertex) -> LightSample:
        point = lit_point(v.surface.position, v.side)
        if wp.static(features.light_links):
            point.receiver = v.receiver
        if wp.static(features.light_bounces):
            point.bounce = v.bounce
        u = sample_3d(v.key, v.pixel.sample, v.dimension + wp.uint32(LIGHT))
        light = light_sample(data.lights, data.geometry, point, u[2], wp.vec2(u[0], u[1]))
        if wp.static(features.catchers):
            if light.pdf > 0.0 and not shines_on_copy(data.lights, paths, path, light.emitter):
                light.pdf = 0.0
        if wp.static(features.volume_lights):
            if paths.light_cell.shape[0] > 0:
                # its volume says how bright it is when the ray is back, if it is there
                paths.light_cell[path] = wp.where(is_cell(data.lights, light.emitter), light.emitter, -1)
        if wp.static(features.light_groups):
            if has_groups(paths):
                group = int(-1)
                if light.pdf > 0.0:
                    group = group_of(data.lights, owner_of(data.lights, light.emitter))
                paths.passes[0].shadow_group[path] = group
        if wp.static(features.light_programs):
            # the program says how bright the light is when the ray is back, if nothing hides it
            paths.light_program[path] = light.program
            paths.light_instance[path] = light.instance
            paths.light_primitive[path] = light.primitive
            paths.light_barycentric[path] = light.barycentric
            if wp.static(features.lamp_programs):
                if light.program == wp.static(LAMP_PROGRAM):
                    lacks = wp.where(light.casts_shadow == 0, light.distance, 0.0)
                    paths.light_barycentric[path] = wp.vec2(light.distance, lacks)
        return light

    return choose_light


@functools.cache
def make_aim(features: AimFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it."""
    vertex = make_vertex(narrow(features, VertexFeatures))
    choose_light = make_choose_light(features)

    @wp.func
    def aim(data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int):
        v = vertex(data, work, limits, paths, rays, path)
        if not v.there or not is_aimed(data.lights, limits, v):
            return
        light = choose_light(data, paths, path, v)
        slot = paths.status.shape[0] + path
        bits = light.delta | (light.casts_shadow * wp.static(_CASTS_SHADOW))
        visibility = light.visibility
        if wp.static(features.shadow_links):
            rays.visibility[slot] = visibility  # whose bits are too many for a float
        visibility = visibility & wp.static(SCATTERED_RAYS)
        bits = bits | (visibility << wp.static(_VISIBILITY_SHIFT)) | (light.program << wp.static(_PROGRAM_SHIFT))
        rays.origin[slot] = wp.vec3(light.pdf, light.distance_error, float(bits))
        rays.direction[slot] = light.direction
        rays.t_max[slot] = light.distance
        paths.shadow_light[path] = light.radiance

    return aim


@wp.func
def aimed_light(paths: Paths, rays: Rays, path: int) -> LightSample:
    """What `aim` found for a path, without what is known of the light's program."""
    slot = paths.status.shape[0] + path
    found = rays.origin[slot]
    bits = int(found[2])
    light = LightSample()
    light.pdf = found[0]
    light.distance_error = found[1]
    light.delta = bits & 1
    light.casts_shadow = (bits / wp.static(_CASTS_SHADOW)) & 1
    light.visibility = (bits >> wp.static(_VISIBILITY_SHIFT)) & 31
    light.program = bits >> wp.static(_PROGRAM_SHIFT)
    light.direction = rays.direction[slot]
    light.distance = rays.t_max[slot]
    light.radiance = paths.shadow_light[path]
    return light
