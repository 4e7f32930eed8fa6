"""The arrays that kernels read of volumes, and which of them each path and its shadow ray are in."""

from __future__ import annotations

import warp as wp

from ...programs.op import NodeData
from ...scene.geometry import mat34
from ...shading.bsdf.materials import ClosureRecord
from ...shading.volumes.enclosures import Enclosures
from ...shading.volumes.overlaps import INSIDE_MOST

# In place of what is inside, for paths of scenes with shadow catchers: there is no volume, not even the world's
IN_VACUUM = -1
# How a path met the surface where its ray ended: `MediaState.side`
FRONT, BACK = 1, 2
AIMED, GOES_ON, UNAIMED = 1, 2, 4
# What is counted: columns of `VolumeData.counts`. Sums of shares are in units of 1 / `measure.volumes.SHARE_UNITS`
COLLISIONS, EXCEEDED, DENSITY, DENSITY_LOST, SHADOW_RAYS, SHADOW_RAYS_CUT, PATHS_CUT = range(7)
COUNTS = 7
# Rows of `VolumeData.counts`: threads of a GPU that count at once seldom wait for each other
COUNT_ROWS = 256
# In place of a grid of cells: `VolumeLights.of`
UNLIKE = -2
# Cells of a part of a grid along each axis: what a cell is divided into
PART = 4


# What bounds are of: entries of `BoundWork.found` and `VolumeData.bounds`
EXTINCTION, FLIGHTS = wp.constant(0), wp.constant(1)


@wp.struct
class Bounds:
    """A grid of cells that bound the extinction of one volume whose coefficients a program gives."""

    # world to cells, or the space of an object that moves: cell (i, j, k) is from (i, j, k) to (i + 1, j + 1, k + 1)
    to_cells: mat34
    size: wp.vec3i  # cells along each axis; the outermost go on without end
    first: int  # of its cells in `VolumeData.bounds`, the last axis changing fastest


@wp.struct
class BoundBox:
    """A box whose cells are given bounds; see `bounds.py`."""

    origin: wp.vec3  # a corner of the box, in object space where it moves [m]
    edges: wp.mat33  # its edges from there, by columns [m]
    code: int  # the volume that is looked at, as in `MediaState`; 0: none but that of the world
    moving: int  # the instance that moves; -1: nothing does
    first: int  # of its cells among all
    least_flights: float  # per length, where light is emitted [1/m]


@wp.struct
class BoundWork:
    """Boxes whose cells are given bounds, the last axis changing fastest."""

    boxes: wp.array(dtype=BoundBox)
    cells: int  # along each axis
    rays: int  # kinds of rays that are looked at, see `bounds.py`
    places: wp.array(dtype=wp.vec3)  # where more is looked at: as many points of each cell [m]; or none
    # result of each octant of a cell [1/m]: the largest extinction, and that or `BoundBox.least_flights` where light is
    # emitted
    found: wp.array(dtype=wp.vec2)
    # and, where volumes are emitters: means of emission [W/(m³ sr)] and of its square; or none
    emitted: wp.array(dtype=wp.vec2)


@wp.struct
class EmissionGrid:
    """A grid of cells over a volume that emits."""

    origin: wp.vec3  # corner of cell (0, 0, 0) in the world [m]
    to_cells: wp.mat33  # from there: cell (i, j, k) is from (i, j, k) to (i + 1, j + 1, k + 1)
    size: int  # cells along each axis
    first: int  # of its cells in `VolumeLights.emitters`, the last axis changing fastest


@wp.struct
class VolumeLights:
    """Volumes as emitters, by cells; no entries where none is."""

    emits: wp.array(dtype=int)  # of each volume: 1: it may emit, whether it is an emitter or not
    # entry in `grids` of each code of `MediaState.inside`, less 1; -1: it is no emitter; UNLIKE: it may emit, and some
    # of the rays by which light of volumes is found do not see it
    of: wp.array(dtype=int)
    has_unlike: int  # 1: there is such a volume
    innermost: int  # 1: a volume is an emitter only where it is the innermost, as that owns the light of all of them
    grids: wp.array(dtype=EmissionGrid)
    # emitter of each cell; -1: none; -2 or less: it has `PART`³ cells of its own here, from that below -2 on
    emitters: wp.array(dtype=int)
    first: int  # the first emitter that is a cell
    codes: wp.array(dtype=int)  # code of the volume of each emitter from there on


@wp.struct
class MediaState:
    """Where paths are, one entry each."""

    # The volumes of meshes that the extending ray is in: 0, or 1 + instance * volume_count + volume
    inside: wp.array(dtype=wp.vec4i)
    shadow_inside: wp.array(dtype=wp.vec4i)  # those of the shadow ray
    side: wp.array(dtype=int)  # FRONT, BACK: side of the surface that the path came from; 0: it is at none
    segment: wp.array(dtype=int)  # pieces of its way that the path has passed
    shadow_segment: wp.array(dtype=int)  # the same of its shadow ray
    scattered: wp.array(dtype=int)  # scattering events in volumes so far
    # AIMED: light has been looked for along the piece on which the extending ray is back, which is decided next;
    # GOES_ON: lights that rays meet have been counted to the end of that piece; UNAIMED: where the ray began, no volume
    # was aimed at
    lit: wp.array(dtype=int)


@wp.struct
class Flow:
    """How what fills a mesh moves while the shutter is open."""

    grid: wp.uint64  # of vectors: how far in that time, in object space [m]
    to_index: mat34  # object space to its indices
    time: float  # at which all is where the grids have it, 0 to 1


@wp.struct
class VolumeData:
    """Volumes of a scene, numbered in the order of the materials that have them, the world's last."""

    volume_of: wp.array(dtype=int)  # volume of each material; -1: none
    is_boundary: wp.array(dtype=int)  # 1: the surface of a material is seen by nothing but its volume
    volume_count: int
    world: int  # volume of the world; -1: none
    closure_first: wp.array(dtype=int)  # volume v has the closures [closure_first[v], closure_first[v + 1])
    closures: wp.array(dtype=ClosureRecord)
    nodes: NodeData  # programs of volumes; `program_first` by volume
    varies: int  # 1: a program may give other coefficients at other points of an object
    scatters: int  # 0: no light is looked for along rays, as none of the volumes scatters
    density_scale: wp.array(dtype=float)  # of each instance: factor of all coefficients; empty: 1
    flow_of: wp.array(dtype=int)  # entry in `flows` of each instance; -1: nothing moves there. Empty: nothing does
    flows: wp.array(dtype=Flow)
    bounds_of: wp.array(dtype=int)  # entry in `grids`, by instance * volume_count + volume; -1: there is no program
    world_bounds: int
    grids: wp.array(dtype=Bounds)
    # of each cell: bound of the extinction, and of flights that meet what is emitted as well [1/m]
    bounds: wp.array(dtype=wp.vec2)
    enclosures: Enclosures
    lights: VolumeLights
    bounce_max: int  # a path scatters in volumes once more at most
    asked: BoundWork  # before the render
    state: MediaState
    counts: wp.array2d(dtype=wp.int64)  # of one worker, any rows; they enter statistics alone, and are sums of integers


def state_bytes_per_path() -> int:
    """Device memory of the state of one path [bytes]."""
    return sum(wp.types.type_size_in_bytes(array.type.dtype) for array in MediaState.vars.values())


@wp.func
def note_count(counts: wp.array2d(dtype=wp.int64), stream: wp.uint32, column: int, amount: wp.int64):
    """Add to a count, in a row by the `stream` of random numbers."""
    wp.atomic_add(counts, int(stream % wp.uint32(wp.static(COUNT_ROWS))), column, amount)


@wp.func
def entry(volumes: VolumeData, inside: wp.vec4i, place: int) -> wp.vec2i:
    """Instance and volume at `place` of those that a ray is in, the world's behind the others; volume -1: none."""
    if place < wp.static(INSIDE_MOST):
        code = inside[place] - 1
        if code < 0:
            return wp.vec2i(-1, -1)
        instance = code / volumes.volume_count
        return wp.vec2i(instance, code - instance * volumes.volume_count)
    return wp.vec2i(-1, volumes.world)


@wp.func
def innermost_instance(inside: wp.vec4i, volume_count: int) -> int:
    """The instance of the last place of `inside`, mostly of the volume that a ray entered last; -1: it is in none."""
    instance = int(-1)
    for place in range(wp.static(INSIDE_MOST)):
        if inside[place] > 0:
            instance = (inside[place] - 1) / volume_count
    return instance


@wp.func
def is_empty(volumes: VolumeData, inside: wp.vec4i) -> bool:
    """Whether a ray is in no volume."""
    return volumes.world < 0 and inside[0] == 0 and inside[1] == 0 and inside[2] == 0 and inside[3] == 0


@wp.func
def entered(inside: wp.vec4i, code: int) -> wp.vec4i:
    """`inside` with `code`, in which a ray may be already."""
    result = inside
    free = int(-1)
    for k in range(wp.static(INSIDE_MOST)):
        if inside[k] == code:
            return inside
        if inside[k] == 0 and free < 0:
            free = k
    if free >= 0:
        result[free] = code
    return result


@wp.func
def holds(inside: wp.vec4i, code: int) -> bool:
    """Whether `code` is in `inside`."""
    return inside[0] == code or inside[1] == code or inside[2] == code or inside[3] == code


@wp.func
def left(inside: wp.vec4i, code: int) -> wp.vec4i:
    """`inside` without `code`."""
    result = inside
    for k in range(wp.static(INSIDE_MOST)):
        if inside[k] == code:
            result[k] = 0
    return result


@wp.func
def across(volumes: VolumeData, inside: wp.vec4i, instance: int, material: int, side: int) -> wp.vec4i:
    """`inside` on the other side of a surface, which a ray met from its `side`."""
    volume = volumes.volume_of[material]
    if volume < 0:
        return inside
    code = 1 + instance * volumes.volume_count + volume
    if side == wp.static(FRONT):
        return entered(inside, code)
    return left(inside, code)
