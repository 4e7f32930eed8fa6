"""The vertex of a path: what the stages at a surface know of a hit before its material is evaluated."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ....rays import Rays
from ....shading.bsdf.materials import ShadingFrame
from ....shading.bsdf.normals import shading_frame
from ....shading.lights.choice import packed_side
from ....shading.lights.links import receiver_of
from ....shading.segments import make_surface_point
from ....shading.sequences.keys import DIMENSIONS_PER_BOUNCE
from ....shading.sequences.sampler import make_sampler
from ....shading.surface import SurfacePoint
from ...catchers.copies import receiver_of_copy
from ...rays import CAME_BACK, SHADOW_PASS, Paths, Status, bounce_of, time_of
from ...scene.shading_data import SceneData
from ..generate import PixelSample, pixel_sample
from ..limits import PathLimits
from ..walk import STEPS_MOST, walk_dimension
from ..work import TileWork
from .history import is_spent

_INSIDE = int(Status.INSIDE)


@dataclass(frozen=True, kw_only=True)
class VertexFeatures:
    """Features that a vertex is specialised on; the fields are those of `SceneFeatures`."""

    instancing: bool
    smooth_normals: bool
    curves: bool
    transparency: bool
    subsurface: bool
    shadow_rays: bool
    light_choice: bool
    sample_sequence: str
    bounces_by_kind: bool
    moving: bool = False
    light_links: bool = False
    catchers: bool = False


@wp.struct
class Vertex:
    """A path at a surface."""

    there: bool  # False: the hit is that of a step below a surface, which ended before or met another object
    status: int  # of the path, without what says how it came here
    bounce: int
    passed: int  # transparent surfaces that the path passed since it scattered
    comes_out: bool  # from below the surface, as if a white diffuse closure scattered it
    last: bool  # it scatters no more
    pixel: PixelSample
    key: wp.vec2ui  # of the pixel's random numbers
    dimension: wp.uint32  # of the first of this vertex
    wo: wp.vec3
    surface: SurfacePoint
    frame: ShadingFrame
    side: wp.uint32  # `packed_side`, for the choice among emitters
    receiver: int  # the light set of the instance, where light is linked; -1: it is not


@functools.cache
def make_vertex(features: VertexFeatures) -> wp.Function:
    """Function (data, work, limits, paths, rays, path) -> Vertex."""
    pixel_key = make_sampler(features.sample_sequence).pixel_key
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)

    @wp.func
    def vertex(data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int) -> Vertex:
        v = Vertex()
        v.status = paths.status[path] & ~wp.static(CAME_BACK)
        v.bounce = bounce_of(v.status)
        direction = rays.direction[path]
        v.wo = -direction
        if wp.static(features.subsurface):
            if (v.status & wp.static(_INSIDE)) != 0:
                if paths.walk.step[path] != 0:
                    return v
                v.status = v.status & wp.static(~_INSIDE)
                v.comes_out = True
                v.wo = direction
        v.there = True
        v.last = v.bounce > limits.bounce_max
        if wp.static(features.bounces_by_kind):
            v.last = v.last or is_spent(limits, paths.history[path])
        if wp.static(features.transparency):
            v.passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        v.pixel = pixel_sample(work, paths.item[path])
        v.key = pixel_key(limits.seed, wp.uint32(v.pixel.x), wp.uint32(v.pixel.y), wp.uint32(work.frame_width))
        # every surface that a path meets has numbers of its own, also those that it passes
        v.dimension = wp.uint32(v.bounce + v.passed) * wp.uint32(DIMENSIONS_PER_BOUNCE)
        if wp.static(features.subsurface):
            if v.comes_out:
                v.dimension = walk_dimension(v.bounce + v.passed, wp.static(STEPS_MOST + 1))
        v.surface = surface_point(
            data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
        )
        v.frame = shading_frame(v.surface, v.wo)
        if wp.static(features.shadow_rays and features.light_choice):
            if data.lights.emitter_count > 1:  # else nobody asks
                v.side = packed_side(v.frame.normal, data.materials.records[v.surface.material].transmits != 0)
        if wp.static(features.light_links):
            v.receiver = receiver_of(data.lights, rays.hit_instance[path])
            if wp.static(features.catchers):
                v.receiver = receiver_of_copy(paths, path, v.receiver)
        return v

    return vertex
