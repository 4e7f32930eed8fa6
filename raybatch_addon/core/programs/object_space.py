"""The space of the point's object, where that is while the shutter is open."""

import warp as wp

from ..scene.geometry import mat34
from ..scene.moved import inverse_at, motion_row, transform_at
from .op import NodeData
from .point import ShadingPoint


@wp.func
def world_to_object(data: NodeData, point: ShadingPoint) -> mat34:
    """World to object; a lamp does not move."""
    if point.primitive >= 0:
        row = motion_row(data.geometry, point.instance)
        if row >= 0:
            return inverse_at(data.geometry, row, point.time)
    return data.inputs.to_object[point.instance]


@wp.func
def object_to_world(data: NodeData, point: ShadingPoint) -> mat34:
    """Object to world, also where the geometry is in world space already."""
    if point.primitive >= 0:
        if motion_row(data.geometry, point.instance) >= 0:
            return transform_at(data.geometry, point.instance, point.time)
    return data.inputs.to_world[point.instance]
