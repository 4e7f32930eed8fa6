"""Lights without mesh that a ray meets in volumes: each is seen through what lies before it."""

from __future__ import annotations

import functools

import warp as wp

from ...programs.op import NodeData
from ...programs.point import ShadingPoint
from ...scene.features import narrow
from ...shading.lights.area_shapes import ERROR_SHARE_MOST
from ...shading.lights.choice import ChoiceFeatures, LitPoint, make_light_choice
from ...shading.lights.hits import LightHitFeatures, make_light_hits
from ...shading.lights.lamp_program import make_lamp_emission
from ...shading.lights.lights import light_weights
from ...shading.lights.links import make_counts, make_found_by_sampling
from ...shading.lights.met.boxes import light_of, next_met
from ...shading.lights.table import LightTable
from ...shading.sequences.keys import mix_bits
from .features import VolumeFeatures
from .segment import make_passed
from .table import IN_VACUUM, VolumeData


@wp.struct
class Way:
    """A piece of a ray, and the ray that it belongs to."""

    begin: ShadingPoint  # its begin; `incoming` is the direction reversed
    inside: wp.vec4i  # see `MediaState`
    before: float  # way from where the ray scattered last to `begin` [m]
    length: float  # of the piece [m]
    bsdf_pdf: float  # density of the direction where it scattered last [1/sr]; 0: light sampling had no part
    passed: int  # transparent surfaces since then
    stream: wp.uint32  # of random numbers


@functools.cache
def make_lights_ahead(features: VolumeFeatures) -> wp.Function:
    """Function (volumes, table, nodes, point: LitPoint, way: Way) -> vec3: weighted radiance of all lights on a piece
    of a ray, without suns; `point` is where the ray scattered last.
    """
    meet = make_light_hits(narrow(features, LightHitFeatures)).meet
    selection_pdf = make_light_choice(narrow(features, ChoiceFeatures)).pdf
    found_by_sampling = make_found_by_sampling(features.shadow_links)
    counts = make_counts(features.light_links, features.light_groups)
    hit_weight = light_weights(features.mis)[1]
    attenuated = make_passed(features.volume_program)
    has_programs = bool(features.lamp_program)
    lamp_emission = make_lamp_emission(features.lamp_program) if has_programs else None
    is_met = meet is not None

    @wp.func
    def lights_ahead(volumes: VolumeData, table: LightTable, nodes: NodeData, point: LitPoint, way: Way) -> wp.vec3:
        total = wp.vec3()
        if wp.static(is_met):
            if (table.tree_visibility & way.begin.ray_kind) != 0:
                direction = -way.begin.incoming
                origin = point.position
                t_max = way.before + way.length
                reach = t_max * wp.static(1.0 + 2.0 * ERROR_SHARE_MOST)
                item = int(-1)
                while True:
                    item = next_met(table.tree, origin, direction, reach, item)
                    if item < 0:
                        break
                    emitter = light_of(table.tree, table.tree_leaf, item)
                    light = table.lights[emitter]
                    sampled = way.bsdf_pdf > 0.0 and found_by_sampling(table, emitter, light.visibility)
                    seen = (light.visibility & way.begin.ray_kind) != 0 and not sampled
                    if seen and counts(table, emitter, point):
                        met = meet(light, origin, direction)
                        t = met.distance - met.distance_error
                        if met.pdf > 0.0 and t >= way.before and t < t_max:
                            weight = float(1.0)
                            if way.bsdf_pdf > 0.0:
                                weight = hit_weight(way.bsdf_pdf, met.pdf * selection_pdf(table, point, emitter))
                            radiance = wp.cw_mul(met.radiance, light.emission)
                            if wp.static(has_programs):
                                if light.program != 0:
                                    emitted = lamp_emission(
                                        nodes,
                                        table,
                                        emitter,
                                        origin + met.distance * direction,
                                        direction,
                                        met.distance,
                                        way.begin.bounce + 1,
                                        way.passed,
                                    )
                                    radiance = wp.cw_mul(radiance, emitted)
                            stream = mix_bits(way.stream + wp.uint32(emitter + 1))
                            if wp.static(features.catchers):
                                share = wp.vec3(1.0)
                                if way.inside[0] != wp.static(IN_VACUUM):
                                    share = attenuated(volumes, way.inside, way.begin, t - way.before, stream)
                            else:
                                share = attenuated(volumes, way.inside, way.begin, t - way.before, stream)
                            total += weight * wp.cw_mul(radiance, share)
        return total

    return lights_ahead
