"""Emission of a surface that the extending ray of a path met, weighed against light sampling."""

from __future__ import annotations

import warp as wp

from ....rays import Rays
from ....shading.bsdf.materials import ClosureRecord
from ....shading.lights.light_choice import lit_point
from ....shading.lights.lights import is_lit_in_part
from ...passes.light import make_add_light
from ...rays import Paths, bounce_of, left_side
from ...scene.scene_data import SceneData
from ..limits import PathLimits, clamped, has_light


def make_gather_emission(
    bsdf_emission: wp.Function, light_hit_pdf: wp.Function, hit_weight: wp.Function, clamping: bool, splits: bool
) -> wp.Function:
    """Function (data, limits, paths, rays, path, closures, first, end, seen_from: float) that adds what the surface
    emits to the path's light. `seen_from`: how far the path came straight on before its ray began [m].

    The first three are `Bsdf.emission`, `Lights.hit_pdf` and the weight of hits of `light_weights`; `splits`: light is
    divided among passes.
    """
    add_light = make_add_light(splits)

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
        if has_light(emission):
            weight = float(1.0)
            pdf = paths.pdf[path]
            if pdf > 0.0:
                direction = rays.direction[path]
                light_pdf = light_hit_pdf(
                    data.lights,
                    data.geometry,
                    rays.hit_instance[path],
                    rays.hit_primitive[path],
                    lit_point(rays.origin[path] - seen_from * direction, left_side(paths, path)),
                    direction,
                    seen_from + rays.hit_t[path],
                )
                weight = hit_weight(pdf, light_pdf)
                # what is not aimed at is in no table
                if light_pdf > 0.0 and is_lit_in_part(data.lights.instance_visibility[rays.hit_instance[path]]):
                    weight = 0.0  # found by light sampling alone
            light = weight * wp.cw_mul(paths.throughput[path], emission)
            if wp.static(clamping):
                light = clamped(limits, light, bounce_of(paths.status[path]))
            add_light(paths, path, light, bounce_of(paths.status[path]), False)

    return gather_emission
