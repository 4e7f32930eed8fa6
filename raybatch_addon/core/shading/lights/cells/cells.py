"""Cells of a volume that emits light: points in them are aimed at.

A point of a cell is found with an even density over its volume. Light along a ray is an integral over its points, and
the square of the distance takes the density to one by solid angle and distance [1/(m sr)]. Divided by the cell's `rate`
[1/m] it is one by solid angle, beside that of the scattered ray which meets the point; emission [W/(m³ sr)] divided by
the same rate is a radiance. So the two ways to a point are weighed as those to a surface are, point by point (Simon,
Hanika, Zirr and Dachsbacher, "Line Integration for Rendering Heterogeneous Emissive Volumes", 2017). Any rate is right;
that with which scattered rays look for light along their way is the best.
"""

from __future__ import annotations

import warp as wp

from ...sequences.keys import mix_bits, sequence_number
from ..emitters import CELL
from ..shapes import LightSample
from ..table import LightRecord, LightTable


@wp.func
def cell_pdf(light: LightRecord, way: wp.vec3) -> float:
    """Density of a point that is chosen in a cell [1/sr], if the cell is, `way` [m] from the shaded one; see above."""
    scaled = light.spread_scale * way  # volumes and squares of lengths may be beyond float32
    return wp.dot(scaled, scaled)


@wp.func
def sample_cell(light: LightRecord, position: wp.vec3, u_choice: float, u: wp.vec2) -> LightSample:
    """A point of a cell, whose radiance is still to be multiplied by that of the volume there [W/(m³ sr)].

    `u_choice`: the number that chose the cell; its last digits make the third number of the point.
    """
    s = LightSample()
    seed = mix_bits(wp.uint32(u_choice * 16777216.0))
    seed = mix_bits(seed + wp.uint32(u[0] * 16777216.0))
    third = sequence_number(mix_bits(seed + wp.uint32(u[1] * 16777216.0)))
    offset = light.position - position
    offset += (2.0 * u[0] - 1.0) * light.half_x * light.axis_x
    offset += (2.0 * u[1] - 1.0) * light.half_y * light.axis_y
    offset += (2.0 * third - 1.0) * light.radius * light.axis
    s.distance = wp.length(offset)
    if s.distance > 0.0:
        s.direction = offset / s.distance
        s.pdf = cell_pdf(light, offset)
    s.radiance = wp.vec3(1.0)
    return s


@wp.func
def is_cell(table: LightTable, emitter: int) -> bool:
    """Whether an emitter is a cell of a volume."""
    if emitter < 0 or emitter >= table.light_count:
        return False
    return table.lights[emitter].kind == wp.static(CELL)
