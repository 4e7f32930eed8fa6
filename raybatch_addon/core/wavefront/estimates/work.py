"""The arguments that a kernel of estimates is launched with."""

from __future__ import annotations

from enum import IntEnum

import warp as wp

from ...displacement.evaluate import VertexWork
from ...shading.lights.table import LightTable
from ...shading.lights.world import WorldTable


class Estimate(IntEnum):
    """The subject of an estimate, as `EstimateWork.estimate` has it."""

    TRIANGLES = 0
    WORLD = 1
    LAMPS = 2
    DISPLACEMENT = 3  # no estimate, but a program as well that runs before a render


@wp.struct
class EstimateWork:
    """Items of one estimate; arrays of the others are empty."""

    estimate: int
    points: int  # of each lamp; of each texel along either axis; directions of each triangle
    every_point: int  # 1: all points of a triangle are seen in each direction
    instance: wp.array(dtype=int)  # of each triangle
    primitive: wp.array(dtype=int)
    radiance: wp.array(dtype=wp.vec3)  # result of each triangle [W/(m² sr)]
    world: WorldTable  # of which width and height count
    row_first: int  # item 0 is the first texel of this row, where none are listed
    listed: wp.array(dtype=int)  # texel of each item
    directions: wp.array(dtype=wp.vec3)  # of each item, instead of texels; unit
    texels: wp.array(dtype=float)  # result of each texel of the world, or of each direction [W/(m² sr)]
    lamps: wp.array(dtype=int)  # numbers of lights
    lights: LightTable  # these lights
    scene_radius: float  # [m]
    brightness: wp.array(dtype=wp.float64)  # result of each lamp
    vertices: VertexWork  # that materials move
