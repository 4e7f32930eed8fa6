"""The medium at a point: the sum of all volumes that are there."""

from __future__ import annotations

import functools
from dataclasses import replace

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...float32 import UNIT_ROUNDOFF
from ...programs.object_space import object_to_world, world_to_object
from ...programs.point import IN_VOLUME, ShadingPoint
from ...programs.run import make_run
from ...programs.uniform import is_uniform
from ...scene.description import ClosureKind
from ...scene.geometry import image_reach, transform_point, transform_vector
from ...scene.moved import inverse_at, motion_row
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import RECORD_FLOATS, ClosureRecord, address_of, address_of_closure
from ...shading.volumes.enclosures import FARTHEST
from ...shading.volumes.phase import PhaseLobe, phase_pdf, phase_value, sampled_cosine
from .table import FLIGHTS, INSIDE_MOST, Flow, VolumeData, entry

# Scattering closures of a point; those beyond them scatter as the last one
LOBES_MOST = 16
PHASE_LOBE_FLOATS = PhaseLobe.numpy_dtype()["itemsize"] // 4
# Largest coefficient of a closure [1/m]: sums of them are finite
_DENSEST = 1e18
# How far a ray goes into the next cell at least [cells]
_CELL_STEP = 1e-3
# How far the outermost cells of the world's volume go on [sizes of its grid]: beyond, it is empty
WORLD_REACH = 16.0


@wp.struct
class Coefficients:
    """Coefficients at a point, by channel."""

    scattering: wp.vec3  # [1/m]
    extinction: wp.vec3  # absorption too [1/m]
    emission: wp.vec3  # [W/(m³ sr)]
    lobes: int  # entries of the lobes that go with it


@wp.struct
class Reach:
    """How far a bound of the extinction holds."""

    bound: float  # [1/m]
    length: float  # [m]


@wp.struct
class PhaseSum:
    """All lobes of a point for one direction."""

    value: wp.vec3  # the phase function, by channel [1/sr]
    pdf: float  # density with which the direction is sampled [1/sr]


@wp.func
def passes(extinction: wp.vec3, length: float) -> wp.vec3:
    """Share of light that passes `length` [m] of a medium, by channel; also where there is no end."""
    reach = wp.min(length, wp.static(FARTHEST))
    return wp.vec3(wp.exp(-extinction[0] * reach), wp.exp(-extinction[1] * reach), wp.exp(-extinction[2] * reach))


@wp.func
def flowed_from(volumes: VolumeData, flow: Flow, point: ShadingPoint) -> wp.vec3:
    """Where what is at `point` at its time was when the grids were made [m]: against the way that it takes, whose
    vector is looked up where that of the point says (semi-Lagrangian advection; Kim and Ko, "Eulerian Motion Blur",
    2007). Cycles does so.
    """
    here = transform_point(world_to_object(volumes.nodes, point), point.position)
    elapsed = point.time - flow.time
    there = here
    for _ in range(2):
        way = wp.volume_sample_v(flow.grid, transform_point(flow.to_index, there), wp.Volume.LINEAR)
        there = here - elapsed * way
    if there[0] == here[0] and there[1] == here[1] and there[2] == here[2]:
        return point.position
    return transform_point(object_to_world(volumes.nodes, point), there)


@functools.cache
def make_medium(programs: ProgramFeatures) -> wp.Function:
    """Function (volumes, inside: vec4i, point: ShadingPoint, lobes: array of PhaseLobe) -> Coefficients: what there is
    at `point`, of which instance and primitive are set here. Scattering closures are written to `lobes`. Without
    `programs` volumes that have one count as empty.
    """
    run = make_run(replace(programs, flows=False))

    @wp.func
    def medium(
        volumes: VolumeData, inside: wp.vec4i, point: ShadingPoint, lobes: wp.array(dtype=PhaseLobe)
    ) -> Coefficients:
        m = Coefficients()
        place = int(0)
        while place < wp.static(INSIDE_MOST + 1):
            found = entry(volumes, inside, place)
            place += 1
            volume = found[1]
            if volume >= 0:
                first = volumes.closure_first[volume]
                count = volumes.closure_first[volume + 1] - first
                address = address_of_closure(volumes.closures, first)
                if wp.static(bool(programs)):
                    word = int(-1)
                    if volumes.nodes.program_first.shape[0] > 0:  # general kernels: none of the volumes may have any
                        word = volumes.nodes.program_first[volume]
                    if word >= 0:
                        here = point
                        here.instance = found[0]
                        here.primitive = wp.static(IN_VOLUME)
                        if wp.static(programs.flows):
                            if found[0] >= 0 and volumes.flow_of.shape[0] > 0:
                                flow = volumes.flow_of[found[0]]
                                if flow >= 0:
                                    here.position = flowed_from(volumes, volumes.flows[flow], here)
                        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
                        records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
                        address = address_of(records)
                        made = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
                        count = run(volumes.nodes, stack, word, here, made)
                scale = float(1.0)
                if found[0] >= 0 and volumes.density_scale.shape[0] > 0:
                    scale = volumes.density_scale[found[0]]
                closures = wp.array(ptr=address, shape=(count,), dtype=ClosureRecord)
                for c in range(count):
                    kind = closures[c].kind
                    weight = scale * closures[c].weight
                    if kind == wp.static(int(ClosureKind.EMISSION)):
                        m.emission += weight
                    else:
                        weight = wp.min(weight, wp.vec3(wp.static(_DENSEST)))
                    if kind == wp.static(int(ClosureKind.VOLUME_ABSORPTION)):
                        m.extinction += weight
                    elif kind > wp.static(int(ClosureKind.VOLUME_ABSORPTION)):
                        m.extinction += weight
                        m.scattering += weight
                        if m.lobes < wp.static(LOBES_MOST):
                            lobe = PhaseLobe()
                            lobe.kind = kind
                            lobe.weight = weight
                            lobe.first = closures[c].mean_cosine
                            lobe.second = closures[c].aspect
                            if kind == wp.static(int(ClosureKind.FOURNIER_FORAND)):
                                lobe.first = closures[c].ior
                                lobe.second = closures[c].roughness
                            lobes[m.lobes] = lobe
                            m.lobes += 1
                        else:
                            lobes[wp.static(LOBES_MOST - 1)].weight = lobes[wp.static(LOBES_MOST - 1)].weight + weight
        return m

    return medium


def may_vary(programs: ProgramFeatures) -> bool:
    """Whether coefficients by `programs` may change along a ray."""
    return bool(programs) and not is_uniform(programs.ops)


def make_constant_medium(programs: ProgramFeatures) -> wp.Function:
    """`make_medium` for rays along which nothing varies. Specialised kernels of programs that vary leave all programs
    out, since rays through them are tracked; general kernels keep them, for scenes where `VolumeData.varies` is 0.
    """
    return make_medium(programs if programs.apart or not may_vary(programs) else ProgramFeatures())


@wp.func
def varies_along(volumes: VolumeData, inside: wp.vec4i) -> bool:
    """Whether coefficients change along a ray."""
    if volumes.varies != 0:
        for place in range(wp.static(INSIDE_MOST + 1)):
            found = entry(volumes, inside, place)
            if found[1] >= 0:
                if volumes.nodes.program_first[found[1]] >= 0:
                    return True
    return False


@wp.func
def bound_ahead(
    volumes: VolumeData, inside: wp.vec4i, origin: wp.vec3, direction: wp.vec3, time: float, of: int
) -> Reach:
    """A bound ahead of `origin` at `time`, `of` the EXTINCTION, or of FLIGHTS, which also meet what emits, a flight a
    cell at least: of what programs give an estimate, of constants their sum. Along each axis of the cells it is taken
    to hold as far as the next place that float32 tells from `origin`, which may be cells ahead far from the world's
    origin.
    """
    reach = Reach()
    emits = bool(False)
    cells_per_length = float(0.0)  # [1/m]
    reach.length = wp.static(FARTHEST)
    place = int(0)
    while place < wp.static(INSIDE_MOST + 1):
        found = entry(volumes, inside, place)
        place += 1
        volume = found[1]
        if volume >= 0:
            if volumes.nodes.program_first[volume] < 0:
                total = wp.vec3(0.0)
                for c in range(volumes.closure_first[volume], volumes.closure_first[volume + 1]):
                    if volumes.closures[c].kind != wp.static(int(ClosureKind.EMISSION)):
                        total += volumes.closures[c].weight
                    else:
                        emits = True
                scale = float(1.0)
                if found[0] >= 0 and volumes.density_scale.shape[0] > 0:
                    scale = volumes.density_scale[found[0]]
                reach.bound += scale * wp.max(total[0], wp.max(total[1], total[2]))
            else:
                number = volumes.world_bounds
                if found[0] >= 0:
                    number = volumes.bounds_of[found[0] * volumes.volume_count + volume]
                grid = volumes.grids[number]
                at = origin
                ahead = direction
                told = wp.static(2.0 * UNIT_ROUNDOFF) * wp.vec3(wp.abs(origin[0]), wp.abs(origin[1]), wp.abs(origin[2]))
                if found[0] >= 0:
                    row = motion_row(volumes.nodes.geometry, found[0])
                    if row >= 0:
                        to_object = inverse_at(volumes.nodes.geometry, row, time)
                        at = transform_point(to_object, at)
                        ahead = transform_vector(to_object, ahead)
                        told = image_reach(to_object, told)
                told = image_reach(grid.to_cells, told)
                at = transform_point(grid.to_cells, at)
                ahead = transform_vector(grid.to_cells, ahead)
                cell = wp.vec3i(0, 0, 0)
                length = float(wp.static(FARTHEST))
                beyond = bool(False)
                cells_per_length = wp.max(cells_per_length, wp.length(ahead))
                for axis in range(3):
                    least = wp.max(told[axis], wp.static(_CELL_STEP))
                    if found[0] < 0:
                        last = float(grid.size[axis]) * wp.static(1.0 + WORLD_REACH)
                        first = float(grid.size[axis]) * wp.static(-WORLD_REACH)
                        if at[axis] >= last or at[axis] <= first:
                            beyond = True
                        if ahead[axis] > 0.0:
                            length = wp.min(length, wp.max(last - at[axis], least) / ahead[axis])
                        if ahead[axis] < 0.0:
                            length = wp.min(length, wp.max(at[axis] - first, least) / -ahead[axis])
                    k = wp.clamp(int(wp.floor(wp.clamp(at[axis], -1.0, 1.0e6))), 0, grid.size[axis] - 1)
                    cell[axis] = k
                    if ahead[axis] > 0.0 and k < grid.size[axis] - 1:
                        length = wp.min(length, wp.max(float(k + 1) - at[axis], least) / ahead[axis])
                    if ahead[axis] < 0.0 and k > 0:
                        length = wp.min(length, wp.max(at[axis] - float(k), least) / -ahead[axis])
                index = grid.first + (cell[0] * grid.size[1] + cell[1]) * grid.size[2] + cell[2]
                if beyond:
                    length = wp.static(FARTHEST)
                else:
                    reach.bound += volumes.bounds[index][of]
                reach.length = wp.min(reach.length, length)
    if emits and of == FLIGHTS:
        reach.bound = wp.max(reach.bound, cells_per_length)
    return reach


@wp.func
def _share(lobe: PhaseLobe, throughput: wp.vec3) -> float:
    # a share of the plain mean, too: light that is lacking in one channel must not hide a lobe of that colour
    return wp.dot(lobe.weight, throughput + wp.vec3(1.0e-3 * (throughput[0] + throughput[1] + throughput[2])))


@wp.func
def phase_sum(lobes: wp.array(dtype=PhaseLobe), m: Coefficients, throughput: wp.vec3, cosine: float) -> PhaseSum:
    """All lobes at `cosine`, for light that was scattered with `throughput`, the coefficient not in it."""
    result = PhaseSum()
    total = float(0.0)
    for k in range(m.lobes):
        share = _share(lobes[k], throughput)
        total += share
        result.pdf += share * phase_pdf(lobes[k], cosine)
        result.value += phase_value(lobes[k], cosine) * lobes[k].weight
    if total > 0.0:
        result.pdf = result.pdf / total
    for axis in range(3):
        if m.scattering[axis] > 0.0:
            result.value[axis] = result.value[axis] / m.scattering[axis]
    return result


@wp.func
def phase_sample(
    lobes: wp.array(dtype=PhaseLobe), m: Coefficients, throughput: wp.vec3, u_lobe: float, u: float
) -> float:
    """Cosine of a direction of the density that `phase_sum` gives."""
    total = float(0.0)
    for k in range(m.lobes):
        total += _share(lobes[k], throughput)
    chosen = int(0)
    below = float(0.0)
    for k in range(m.lobes):
        below += _share(lobes[k], throughput)
        if u_lobe * total >= below and k + 1 < m.lobes:
            chosen = k + 1
    return sampled_cosine(lobes[chosen], u)
