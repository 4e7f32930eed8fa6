"""Stage: shadow rays are back, which volumes dim on their way. Next: `connect_transparent`."""

from __future__ import annotations

import functools

import warp as wp

from ...rays import Rays
from ...scene.description import Visibility
from ...shading.segments import make_is_closed, make_surface_point
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import material_at
from ...shading.volumes.numbers import SHADOW_STREAM, stream_of
from ..catchers.copies import is_in_vacuum
from ..rays import SHADOW_PASS, Paths, bounce_to_light, time_of
from ..scene.shading_data import SceneData
from ..stages.generate import pixel_sample
from ..stages.limits import PathLimits
from ..stages.work import TileWork
from .cross import behind_surface
from .emission.weigh import emitting_code, is_unaimed
from .features import VolumeFeatures
from .scatter import SEGMENTS_MOST
from .segment import make_passed, ray_point
from .table import VolumeData, is_empty
from .track import make_shining

# Pieces of a shadow ray that have random numbers of their own
_PIECES = 1 << 10


@functools.cache
def make_transmit(features: VolumeFeatures) -> wp.Function:
    """Function (data, volumes, work, limits, paths, rays, slot: int): a piece of a shadow ray, to the next surface."""
    pixel_key = make_sampler(features.sample_sequence).pixel_key
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    is_closed = make_is_closed(features.curves)
    attenuated = make_passed(features.volume_program)
    shining = make_shining(features.volume_program) if features.volume_lights else None

    @wp.func
    def transmit(
        data: SceneData, volumes: VolumeData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, slot: int
    ):
        path = slot - paths.status.shape[0]
        inside = volumes.state.shadow_inside[path]
        number = volumes.state.shadow_segment[path]
        volumes.state.shadow_segment[path] = number + 1
        if wp.static(features.volume_lights):
            if number == 0 and paths.light_cell.shape[0] > 0:
                if paths.light_cell[path] >= 0 and is_unaimed(volumes, inside):
                    paths.shadow_light[path] = wp.vec3(0.0)
                    return
        direction = rays.direction[slot]
        hit = bool(rays.hit_instance[slot] >= 0)
        length = rays.t_max[slot]
        borders = bool(False)
        material = int(-1)
        if hit:
            material = material_at(data.geometry, rays.hit_instance[slot], rays.hit_primitive[slot])
            if data.materials.records[material].is_clear == 0:  # nothing arrives, whatever lies before it
                return
            borders = bool(volumes.volume_of[material] >= 0 or volumes.enclosures.touching != 0)
            length = rays.hit_t[slot]
        empty = is_empty(volumes, inside)
        if wp.static(features.catchers):
            empty = empty or is_in_vacuum(paths, path, inside)
        if not empty:
            pixel = pixel_sample(work, paths.item[path])
            key = pixel_key(limits.seed, wp.uint32(pixel.x), wp.uint32(pixel.y), wp.uint32(work.frame_width))
            # the path's number of pieces tells its vertices apart
            piece = wp.uint32(volumes.state.segment[path] * wp.static(_PIECES) + wp.min(number, wp.static(_PIECES - 1)))
            stream = stream_of(key, pixel.sample, piece | wp.uint32(wp.static(SHADOW_STREAM)))
            bounce = bounce_to_light(paths.status[path])
            kind = int(wp.static(int(Visibility.SHADOW)))
            begin = ray_point(rays.origin[slot], direction, kind, bounce, time_of(rays, path))
            share = attenuated(volumes, inside, begin, length, stream)
            paths.shadow_light[path] = wp.cw_mul(paths.shadow_light[path], share)
        if wp.static(features.volume_lights):
            if not hit and paths.light_cell.shape[0] > 0:
                cell = paths.light_cell[path]
                if cell >= 0:
                    # it has come to the point that it was aimed at, which is in the volume or not
                    code = volumes.lights.codes[cell - volumes.lights.first]
                    shines = wp.vec3(0.0)
                    if emitting_code(volumes, inside) == code:
                        end = rays.origin[slot] + length * direction
                        kind = int(wp.static(int(Visibility.SHADOW)))
                        bounce = bounce_to_light(paths.status[path])
                        shines = shining(volumes, inside, ray_point(end, direction, kind, bounce, time_of(rays, path)))
                    paths.shadow_light[path] = wp.cw_mul(paths.shadow_light[path], shines)
        if borders:
            surface = surface_point(
                data.geometry, rays.hit_instance[slot], rays.hit_primitive[slot], rays.hit_uv[slot], time_of(rays, path)
            )
            closed = is_closed(data.geometry, rays.hit_instance[slot], rays.hit_primitive[slot])
            volumes.state.shadow_inside[path] = behind_surface(
                data.geometry, volumes, inside, rays.hit_instance[slot], surface, direction, closed
            )
            if volumes.is_boundary[material] != 0 and number < wp.static(SEGMENTS_MOST):
                paths.passed[path] = paths.passed[path] - wp.static(SHADOW_PASS)

    return transmit
