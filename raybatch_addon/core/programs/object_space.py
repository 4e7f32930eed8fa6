"""The space of the point's object, where that is while the shutter is open."""

import warp as wp

from ..scene.geometry import mat34
from ..scene.moved import inverse_at, motion_row, transform_at
from .op import NodeData
from .point import IN_VOLUME, ShadingPoint


@wp.func
def _may_move(point: ShadingPoint) -> bool:
    # a lamp does not, and its number is one among lamps
    return point.primitive >= 0 or point.primitive == wp.static(IN_VOLUME)


@wp.func
def world_to_object(data: NodeData, point: ShadingPoint) -> mat34:
    """World to object."""
    if _may_move(point):
        row = motion_row(data.geometry, point.instance)
        if row >= 0:
            return inverse_at(data.geometry, row, point.time)
    return data.inputs.to_object[point.instance]


@wp.func
def object_to_world(data: NodeData, point: ShadingPoint) -> mat34:
    """Object to world, also where the geometry is in world space already."""
    if _may_move(point):
        if motion_row(data.geometry, point.instance) >= 0:
            return transform_at(data.geometry, point.instance, point.time)
    return data.inputs.to_world[point.instance]
