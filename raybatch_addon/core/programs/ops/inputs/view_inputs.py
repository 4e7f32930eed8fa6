"""Inputs that depend on how a surface is looked at: Fresnel, Layer Weight, Light Path."""

import warp as wp

from ....scene.description import Visibility
from ....shading.bsdf.fresnel import fresnel_dielectric
from ...op import NodeData, number, op, put_number, vector, wanted
from ...point import DEPTH_BITS, DEPTH_SHIFT, PORTAL_SHIFT, PORTALS_MOST, HistoryBits, ShadingPoint

_BELOW_ONE = 1e-5


@op("fresnel", "nv>N", foldable=False)
@wp.func
def fresnel(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Reflectance of a dielectric: index, normal."""
    index = wp.max(number(data, stack, pc + 1), wp.static(_BELOW_ONE))
    if point.backfacing != 0:
        index = 1.0 / index
    put_number(
        data, stack, pc + 3, fresnel_dielectric(wp.abs(wp.dot(point.incoming, vector(data, stack, pc + 2))), index)
    )


@op("layer_weight", "nv>NN", foldable=False)
@wp.func
def layer_weight(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Weights for layers: by Fresnel, and by how far the surface faces the viewer."""
    blend = number(data, stack, pc + 1)
    cosine = wp.abs(wp.dot(point.incoming, vector(data, stack, pc + 2)))
    if wanted(data, pc + 3):
        index = wp.max(1.0 - blend, wp.static(_BELOW_ONE))
        if point.backfacing == 0:
            index = 1.0 / index
        put_number(data, stack, pc + 3, fresnel_dielectric(cosine, index))
    facing = cosine
    if blend != 0.5:
        blend = wp.clamp(blend, 0.0, wp.static(1.0 - _BELOW_ONE))
        power = 0.5 / (1.0 - blend)
        if blend < 0.5:
            power = 2.0 * blend
        facing = wp.pow(wp.max(cosine, 0.0), power)
    put_number(data, stack, pc + 4, 1.0 - facing)


@wp.func
def _truth(condition: bool) -> float:
    if condition:
        return 1.0
    return 0.0


@op("light_path", ">NNNNNNNNNN", foldable=False)
@wp.func
def light_path(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Light path, first outputs.

    1 or 0 for each: the ray is of the camera, for shadows, diffuse, glossy, reflected, transmitted. Then its length
    [m], bounces, and surfaces passed; then 1 or 0: a volume scattered it.
    """
    kind = point.ray_kind
    put_number(data, stack, pc + 1, _truth((kind & wp.static(int(Visibility.CAMERA))) != 0))
    put_number(data, stack, pc + 2, _truth((kind & wp.static(int(Visibility.SHADOW))) != 0))
    put_number(data, stack, pc + 3, _truth((kind & wp.static(int(Visibility.DIFFUSE))) != 0))
    put_number(data, stack, pc + 4, _truth((kind & wp.static(int(Visibility.GLOSSY))) != 0))
    put_number(data, stack, pc + 5, _truth((kind & wp.static(int(Visibility.DIFFUSE | Visibility.GLOSSY))) != 0))
    put_number(data, stack, pc + 6, _truth((kind & wp.static(int(Visibility.TRANSMISSION))) != 0))
    put_number(data, stack, pc + 7, point.ray_length)
    put_number(data, stack, pc + 8, float(point.bounce))
    put_number(data, stack, pc + 9, float(point.passed))
    put_number(data, stack, pc + 10, _truth((kind & wp.static(int(Visibility.VOLUME_SCATTER))) != 0))


@wp.func
def _depth(history: int, index: int) -> float:
    return float(
        (history >> (wp.static(DEPTH_SHIFT) + wp.static(DEPTH_BITS) * index)) & wp.static((1 << DEPTH_BITS) - 1)
    )


@op("path_history", ">NNNNNN", foldable=False)
@wp.func
def path_history(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Light path, further outputs.

    1 or 0 for each: the path scattered last diffusely, glossily, sharply. Then the counts of diffuse, glossy and
    transmitted scatterings.
    """
    h = point.history
    put_number(data, stack, pc + 1, _truth((h & wp.static(int(HistoryBits.DIFFUSE))) != 0))
    put_number(data, stack, pc + 2, _truth((h & wp.static(int(HistoryBits.GLOSSY))) != 0))
    put_number(data, stack, pc + 3, _truth((h & wp.static(int(HistoryBits.SINGULAR))) != 0))
    put_number(data, stack, pc + 4, _depth(h, 0))
    put_number(data, stack, pc + 5, _depth(h, 1))
    put_number(data, stack, pc + 6, _depth(h, 2))


@op("portal_depth", ">N", foldable=False, general=False)
@wp.func
def portal_depth(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """How many portals the path has passed, as far as they are counted (`PORTALS_MOST`)."""
    put_number(data, stack, pc + 1, float((point.history >> wp.static(PORTAL_SHIFT)) & wp.static(PORTALS_MOST)))
