"""Emission of a surface that the extending ray of a path met, weighed against light sampling."""

from __future__ import annotations

import warp as wp

from ....rays import Rays
from ....shading.bsdf.materials import ClosureRecord
from ....shading.lights.links import group_of, is_linked, make_found_by_sampling
from ...passes.light import add_to_group, make_add_light
from ...rays import Paths, bounce_of, left_point
from ...scene.shading_data import SceneData
from ..limits import PathLimits, clamped, has_light
from .features import SurfaceFeatures


def make_gather_emission(
    bsdf_emission: wp.Function, light_hit_pdf: wp.Function, hit_weight: wp.Function, features: SurfaceFeatures
) -> wp.Function:
    """Function (data, limits, paths, rays, path, closures, first, end, seen_from: float) that adds what the surface
    emits to the path's light. `seen_from`: how far the path came straight on before its ray began [m].

    The first three are `Bsdf.emission`, `Lights.hit_pdf` and the weight of hits of `light_weights`.
    """
    add_light = make_add_light(features.splits_light, features.light_groups)
    found_by_sampling = make_found_by_sampling(features.shadow_links)

    @wp.func
    def gather_emission(
        data: SceneData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        seen_from: float,
    ):
        emission = bsdf_emission(closures, first, end)
        there = has_light(emission)
        if there:
            point = left_point(paths, path, rays.origin[path] - seen_from * rays.direction[path])
            owner = data.lights.light_count + rays.hit_instance[path]
            if wp.static(features.light_links):
                there = is_linked(data.lights, owner, point.receiver)
        if there:
            weight = float(1.0)
            pdf = paths.pdf[path]
            if pdf > 0.0:
                direction = rays.direction[path]
                light_pdf = light_hit_pdf(
                    data.lights,
                    data.geometry,
                    rays.hit_instance[path],
                    rays.hit_primitive[path],
                    point,
                    direction,
                    seen_from + rays.hit_t[path],
                )
                weight = hit_weight(pdf, light_pdf)
                # the density of a triangle that light is never aimed at is 0
                if light_pdf > 0.0 and found_by_sampling(
                    data.lights, owner, data.lights.instance_visibility[rays.hit_instance[path]]
                ):
                    weight = 0.0  # found by light sampling alone
            light = weight * wp.cw_mul(paths.throughput[path], emission)
            if wp.static(features.clamping):
                light = clamped(limits, light, bounce_of(paths.status[path]))
            add_light(paths, path, light, bounce_of(paths.status[path]), False)
            if wp.static(features.light_groups):
                add_to_group(paths, path, light, group_of(data.lights, owner))

    return gather_emission
