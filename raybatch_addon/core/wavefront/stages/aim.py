"""Light sampling at a surface (next-event estimation): a shadow ray is aimed at a light."""

from __future__ import annotations

import warp as wp

from ...rays import Rays
from ...scene.description import Visibility
from ...shading.bsdf.bsdf import ShadingFrame
from ...shading.bsdf.materials import ClosureRecord
from ...shading.lights.light_choice import lit_point
from ...shading.lights.light_shapes import LAMP_PROGRAM
from ...shading.lights.lights import is_lit_in_part
from ...shading.surface import SurfacePoint, spawn_origin
from ..rays import Paths, Status, bounce_of
from ..scene.scene_data import SceneData
from .limits import PathLimits, clamped, has_light
from .surface_features import SurfaceFeatures

SHADOW_NEW = int(Status.SHADOW_NEW)


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


def make_connect_light(
    features: SurfaceFeatures, bsdf_evaluate: wp.Function, light_sample: wp.Function, sample_weight: wp.Function
) -> wp.Function:
    """Function (data, limits, paths, rays, path, surface, frame, wo, closures, first, end, side: uint32, u_choice:
    float, u: vec2) -> int: the status bit that submits the path's shadow ray, or 0. `side`: as of `packed_side`.

    The last three are `Bsdf.evaluate`, `Lights.sample` and the weight of samples of `light_weights`.
    """
    programs = features.programs

    @wp.func
    def connect_light(
        data: SceneData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        surface: SurfacePoint,
        frame: ShadingFrame,
        wo: wp.vec3,
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        side: wp.uint32,
        u_choice: float,
        u: wp.vec2,
    ) -> int:
        """Aim a shadow ray at a light; returns the status bit that submits it, or 0."""
        light = light_sample(data.lights, data.geometry, lit_point(surface.position, side), u_choice, u)
        if light.pdf <= 0.0:
            return 0
        bsdf = bsdf_evaluate(closures, first, end, data.materials.albedo, frame, wo, light.direction)
        value = bsdf.value
        weight = 1.0 / light.pdf
        if is_lit_in_part(light.visibility):
            # lobes whose rays do not see the light are not lit by it; this strategy alone finds such a light
            value = lit_value(
                bsdf.value, bsdf.diffuse, light.visibility, wp.dot(light.direction, frame.geometric_normal) > 0.0
            )
        elif light.delta == 0:
            weight = sample_weight(light.pdf, bsdf.pdf) / light.pdf
        if not has_light(value):
            return 0
        contribution = weight * wp.cw_mul(wp.cw_mul(paths.throughput[path], value), light.radiance)
        if wp.static(features.clamping):
            if light.program == 0:
                contribution = clamped(limits, contribution, bounce_of(paths.status[path]) + 1)
        if not has_light(contribution):
            return 0
        if light.casts_shadow == 0 and light.program == 0:
            paths.radiance[path] = paths.radiance[path] + contribution
            return 0
        origin = spawn_origin(surface.position, surface.error, frame.geometric_normal, light.direction)
        slot = paths.status.shape[0] + path
        direction = light.direction
        distance = light.distance
        if distance < wp.inf:
            # from the moved origin to the same point; the light itself must not hide it
            ray = surface.position + distance * direction - origin
            distance = wp.length(ray)
            if distance > 0.0:
                direction = ray / distance
            distance = wp.max(distance - light.distance_error, 0.0)
        rays.origin[slot] = origin
        rays.direction[slot] = direction
        rays.t_max[slot] = distance
        if rays.visibility.shape[0] > 0:
            rays.visibility[slot] = wp.static(int(Visibility.SHADOW))
        paths.shadow_light[path] = contribution
        if wp.static(features.transparency and bool(programs)):
            paths.shadow_t[path] = 0.0
        if wp.static(features.light_programs):
            # the program says how bright the light is when the ray is back, if nothing hides it
            paths.light_program[path] = light.program
            paths.light_instance[path] = light.instance
            paths.light_primitive[path] = light.primitive
            paths.light_barycentric[path] = light.barycentric
            if wp.static(features.lamp_programs):
                if light.program == wp.static(LAMP_PROGRAM):
                    paths.light_barycentric[path] = wp.vec2(light.distance, 0.0)
                    if light.casts_shadow == 0:  # nothing may be in its way
                        paths.light_barycentric[path] = wp.vec2(light.distance, light.distance)
                        rays.t_max[slot] = 0.0
        return wp.static(SHADOW_NEW)

    return connect_light
