"""Lights without mesh that a ray meets in volumes: each is seen through what lies before it."""

from __future__ import annotations

import functools

import warp as wp

from ...programs.op import NodeData
from ...programs.point import ShadingPoint
from ...scene.features import narrow
from ...shading.lights.choice import LitPoint
from ...shading.lights.hits import LightHitFeatures, make_light_hits
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
    following = make_light_hits(narrow(features, LightHitFeatures)).following
    attenuated = make_passed(features.volume_program)
    is_met = following is not None

    @wp.func
    def lights_ahead(volumes: VolumeData, table: LightTable, nodes: NodeData, point: LitPoint, way: Way) -> wp.vec3:
        total = wp.vec3()
        if wp.static(is_met):
            item = int(-1)
            while True:
                hit = following(
                    table,
                    nodes,
                    point,
                    -way.begin.incoming,
                    way.before,
                    way.before + way.length,
                    way.begin.ray_kind,
                    way.bsdf_pdf,
                    way.begin.bounce + 1,
                    way.passed,
                    item,
                )
                if hit.item < 0:
                    break
                item = hit.item
                stream = mix_bits(way.stream + wp.uint32(hit.emitter + 1))
                share = wp.vec3(1.0)
                if wp.static(not features.catchers) or way.inside[0] != wp.static(IN_VACUUM):
                    share = attenuated(volumes, way.inside, way.begin, hit.distance - way.before, stream)
                total += wp.cw_mul(hit.radiance, share)
        return total

    return lights_ahead
