"""Light of volumes that scattered rays meet, weighed against the points of cells that are aimed at.

Where several volumes lie in one another that may emit, rays alone find their light.
"""

from __future__ import annotations

import functools

import warp as wp

from ....programs.point import ShadingPoint
from ....scene.features import narrow
from ....shading.lights.cells.cells import cell_pdf
from ....shading.lights.choice import ChoiceFeatures, LitPoint, make_light_choice
from ....shading.lights.lights import light_weights
from ....shading.lights.table import LightTable
from ....shading.sequences.keys import mix_bits
from ....shading.volumes.numbers import EMISSION_STREAM, stream_number
from ..along import Sought, lit_length
from ..features import VolumeFeatures
from ..medium import Coefficients, passes
from ..table import INSIDE_MOST, PART, UNLIKE, VolumeData, entry, innermost_instance

# Points along a piece of a ray at which a medium that is the same everywhere is looked at
POINTS = 2


@wp.struct
class Seen:
    """Where a ray scattered last, from where it may meet light that was aimed at too."""

    point: LitPoint
    pdf: float  # density of its direction there [1/sr]; 0: light sampling of volumes had no part


@wp.func
def emitting_code(volumes: VolumeData, inside: wp.vec4i) -> int:
    """The code of the volume that alone may emit where a ray is in these, as in `MediaState.inside`; 0: there is none,
    or there are several, whose light is left to rays. That of the world emits nothing where volumes are emitters. Where
    light has owners, that of the innermost volume owns it.
    """
    code = int(0)
    count = int(0)
    for place in range(wp.static(INSIDE_MOST)):
        found = entry(volumes, inside, place)
        if found[1] >= 0:
            if volumes.lights.emits[found[1]] != 0:
                count += 1
                code = inside[place]
    if count == 1 and volumes.lights.innermost != 0:
        if innermost_instance(inside, volumes.volume_count) != (code - 1) / volumes.volume_count:
            return 0
    return wp.where(count == 1, code, 0)


@wp.func
def is_unaimed(volumes: VolumeData, inside: wp.vec4i) -> bool:
    """Whether no volume is aimed at from within these: a ray that begins in one that it does not see never leaves it,
    so that shadow rays and scattered rays do not agree about what lies ahead.
    """
    if volumes.lights.has_unlike != 0:
        for place in range(wp.static(INSIDE_MOST)):
            if inside[place] > 0:
                if volumes.lights.of[inside[place] - 1] == wp.static(UNLIKE):
                    return True
    return False


@wp.func
def weighed_grid(volumes: VolumeData, inside: wp.vec4i) -> int:
    """The entry in `VolumeLights.grids` of the volume whose light is weighed where a ray is in these; -1: none's is."""
    if volumes.lights.of.shape[0] == 0:
        return -1
    code = emitting_code(volumes, inside)
    if code == 0:
        return -1
    return volumes.lights.of[code - 1]


@wp.func
def cell_at(volumes: VolumeData, number: int, position: wp.vec3) -> int:
    """The emitter that is the cell around `position`, a point of the volume with this grid; -1: there is none."""
    grid = volumes.lights.grids[number]
    at = grid.to_cells * (position - grid.origin)
    size = int(grid.size)
    first = int(grid.first)
    found = int(-2)
    while found < -1:
        cell = int(0)
        for axis in range(3):
            # a point on a face may be beyond it, to rounding
            k = int(wp.clamp(at[axis], 0.0, float(size - 1)))
            cell = cell * size + k
            at[axis] = (at[axis] - float(k)) * wp.static(float(PART))
        found = volumes.lights.emitters[first + cell]
        first = -2 - found
        size = wp.static(PART)
    return found


@functools.cache
def make_weighed(features: VolumeFeatures) -> wp.Function:
    """Function (volumes, table, seen: Seen, inside: vec4i, point: ShadingPoint, emission: vec3) -> vec3: the part of
    `emission` [W/(m³ sr)], which all volumes together have at `point`, that counts for a ray that meets it there.
    """
    selection_pdf = make_light_choice(narrow(features, ChoiceFeatures)).pdf
    hit_weight = light_weights(features.mis)[1]

    @wp.func
    def weighed(
        volumes: VolumeData, table: LightTable, seen: Seen, inside: wp.vec4i, point: ShadingPoint, emission: wp.vec3
    ) -> wp.vec3:
        shines = emission[0] > 0.0 or emission[1] > 0.0 or emission[2] > 0.0
        if not shines or not seen.pdf > 0.0:
            return emission
        number = weighed_grid(volumes, inside)
        if number < 0:
            return emission
        cell = cell_at(volumes, number, point.position)
        if cell < 0:
            return emission
        way = point.position - seen.point.position
        pdf = cell_pdf(table.lights[cell], way) * selection_pdf(table, seen.point, cell)
        if not pdf < wp.inf:  # beyond the range of numbers: no such point is aimed at
            return emission
        return hit_weight(seen.pdf, pdf) * emission

    return weighed


@functools.cache
def make_weighed_constant(weighed: wp.Function) -> wp.Function:
    """Function (volumes, table, seen: Seen, inside: vec4i, begin: ShadingPoint, m: Coefficients, length: float, stream:
    uint32) -> vec3: what a medium that is the same everywhere sends to the begin of a piece of a ray of `length` [m],
    weighed; an estimate by `POINTS` points [W/(m² sr)].
    """

    @wp.func
    def weighed_constant(
        volumes: VolumeData,
        table: LightTable,
        seen: Seen,
        inside: wp.vec4i,
        begin: ShadingPoint,
        m: Coefficients,
        length: float,
        stream: wp.uint32,
    ) -> wp.vec3:
        own = mix_bits(stream + wp.uint32(wp.static(EMISSION_STREAM)))
        shares = wp.vec3(1.0 / 3.0)
        point = begin
        total = wp.vec3(0.0)
        k = int(0)
        while k < wp.static(POINTS):
            along = (float(k) + stream_number(own, wp.uint32(2 * k))) / wp.static(float(POINTS))
            found = lit_length(
                m.extinction, shares, length, Sought(), wp.vec2(stream_number(own, wp.uint32(2 * k + 1)), along)
            )
            if found[1] > 0.0:
                point.position = begin.position - found[0] * begin.incoming
                light = weighed(volumes, table, seen, inside, point, m.emission)
                total += wp.cw_mul(light, passes(m.extinction, found[0])) / found[1]
            k += 1
        return total / wp.static(float(POINTS))

    return weighed_constant
