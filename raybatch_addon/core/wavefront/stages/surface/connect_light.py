"""The light that was chosen at a vertex, weighed by the BSDF there: a shadow ray to it."""

from __future__ import annotations

import functools

import warp as wp

from ....rays import Rays
from ....scene.description import ALL_SHADOW_SETS, SHADOW_SET_SHIFT, Visibility
from ....shading.bsdf.bsdf import BsdfValue
from ....shading.lights.lights import light_weights
from ....shading.lights.shapes import LightSample
from ....shading.lights.visibility import is_lit_in_part
from ....shading.surface import spawn_origin
from ...passes.light import divide_shadow_ray, divide_volume_shadow_ray, make_add_light
from ...rays import Paths, Status, bounce_of
from ...scene.shading_data import SceneData
from ..limits import PathLimits, clamped, has_light
from .features import SurfaceFeatures
from .lift import make_lift, make_lit_side
from .vertex import Vertex

_SHADOW_NEW = int(Status.SHADOW_NEW)


@wp.func
def lit_value(value: wp.vec3, diffuse: wp.vec3, visibility: int, reflected: bool) -> wp.vec3:
    """What is left of a BSDF's `value`, of which `diffuse` is Lambertian, for a light that only some rays see."""
    if not reflected:
        return wp.where((visibility & wp.static(int(Visibility.TRANSMISSION))) != 0, value, wp.vec3(0.0))
    left = wp.vec3(0.0)
    if (visibility & wp.static(int(Visibility.DIFFUSE))) != 0:
        left += diffuse
    if (visibility & wp.static(int(Visibility.GLOSSY))) != 0:
        left += value - diffuse
    return left


@functools.cache
def make_connect_light(features: SurfaceFeatures, in_volume: bool = False) -> wp.Function:
    """Function (data, limits, paths, rays, path: int, v: Vertex, light: LightSample, bsdf: BsdfValue) -> int: sends a
    shadow ray to `light`, in whose direction the BSDF is `bsdf`; the status bit that submits it, or 0.
    `in_volume`: the vertex is one of a volume.
    """
    programs = features.programs
    sample_weight = light_weights(features.mis)[0]
    lift_of = make_lift(features.instancing, features.moving) if features.terminator else None
    side_of = make_lit_side(features.terminator and not in_volume)
    add_light = make_add_light(features.splits_light, features.light_groups)

    @wp.func
    def connect_light(
        data: SceneData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        v: Vertex,
        light: LightSample,
        bsdf: BsdfValue,
    ) -> int:
        value = bsdf.value
        weight = 1.0 / light.pdf
        if wp.static(in_volume):
            if (light.visibility & wp.static(int(Visibility.VOLUME_SCATTER))) == 0:
                return 0
        if is_lit_in_part(light.visibility):
            # lobes whose rays do not see the light are not lit by it; this strategy alone finds such a light
            if wp.static(not in_volume):
                side = side_of(data, rays, path, v.frame, light.direction)
                value = lit_value(bsdf.value, bsdf.diffuse, light.visibility, wp.dot(light.direction, side) > 0.0)
        elif light.delta == 0:
            weight = sample_weight(light.pdf, bsdf.pdf) / light.pdf
            if wp.static(features.shadow_links):
                if light.visibility >> wp.static(SHADOW_SET_SHIFT) != wp.static(ALL_SHADOW_SETS):
                    weight = 1.0 / light.pdf  # scattered rays know nothing of what blocks the light
        if not has_light(value):
            return 0
        contribution = weight * wp.cw_mul(wp.cw_mul(paths.throughput[path], value), light.radiance)
        if not has_light(contribution):
            return 0
        if wp.static(features.splits_light):
            if paths.passes.shape[0] > 0:
                if wp.static(in_volume):
                    divide_volume_shadow_ray(paths, path, v.bounce)
                else:
                    reflected = wp.dot(light.direction, side_of(data, rays, path, v.frame, light.direction)) > 0.0
                    diffuse = bsdf.diffuse
                    if is_lit_in_part(light.visibility):
                        diffuse = lit_value(diffuse, diffuse, light.visibility, reflected)
                    divide_shadow_ray(paths, path, v.bounce, value, diffuse, reflected)
        if light.casts_shadow == 0 and light.program == 0:
            if wp.static(features.clamping):
                contribution = clamped(limits, contribution, bounce_of(paths.status[path]) + 1)
            add_light(paths, path, contribution, bounce_of(paths.status[path]) + 1, True)
            return 0
        begin = v.surface.position
        if wp.static(features.terminator and not in_volume):
            begin += lift_of(data, rays, path, v.frame, light.direction, v.surface.time)
        origin = spawn_origin(begin, v.surface.error, v.frame.geometric_normal, light.direction)
        slot = paths.status.shape[0] + path
        direction = light.direction
        distance = light.distance
        if distance < wp.inf:
            # from the moved origin to the same point; the light itself must not hide it
            ray = v.surface.position + distance * direction - origin
            distance = wp.length(ray)
            if distance > 0.0:
                direction = ray / distance
            distance = wp.max(distance - light.distance_error, 0.0)
        if wp.static(features.lamp_programs or features.world_light):
            if light.casts_shadow == 0:  # nothing may be in its way
                distance = 0.0
        rays.origin[slot] = origin
        rays.direction[slot] = direction
        rays.t_max[slot] = distance
        if rays.visibility.shape[0] > 0:
            seen_by = int(wp.static(int(Visibility.SHADOW)))
            if wp.static(features.shadow_links):
                # shadow sets have bits of their own; what blocks at all is in one of them, where light is linked
                sets = light.visibility & wp.static(ALL_SHADOW_SETS << SHADOW_SET_SHIFT)
                if sets != wp.static(ALL_SHADOW_SETS << SHADOW_SET_SHIFT):
                    seen_by = sets
            rays.visibility[slot] = seen_by
        paths.shadow_light[path] = contribution
        if wp.static(features.transparency and bool(programs)):
            paths.shadow_t[path] = 0.0
        return wp.static(_SHADOW_NEW)

    return connect_light
