"""Bounds of the extinction of volumes whose coefficients programs give: found before the render, on grids of cells.

A program is evaluated at a point of each octant of a cell, and where grids that it may read are largest in the cell.
The largest extinction of the cell and of the octants around it counts, where the volume moves of the cells around it;
and of cells further away, where the others do not tell what is found at a point, as in clouds of small parts. That is
an estimate: where a program exceeds it, the volume is rendered as dense as the bound: to shadow rays that of
the extinction, to paths that of flights, which is larger where there is light.

What moves by grids is looked at as the grids have it, and what was found counts as far as anything comes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...device.codegen.local_arrays import Unset
from ...native.structs import to_numpy
from ...scene.description import Mesh, Scene, Visibility
from ...scene.frozen import fact
from ...scene.geometry import transform_point
from ...scene.motion import moving_instances
from ...scene.moved import transform_at
from ...scene.program import ProgramFeatures
from ...scene.validate import box_of
from ...shading.bsdf.materials import address_of
from ...shading.sequences.keys import mix_bits, sequence_number
from ...shading.volumes.grids import flow_reach
from ...shading.volumes.phase import PhaseLobe
from .grids import peaks_of
from .medium import LOBES_MOST, PHASE_LOBE_FLOATS, WORLD_REACH, make_medium
from .segment import ray_point
from .table import EXTINCTION, BoundBox, Bounds, BoundWork, VolumeData

# Cells along each axis at most, cells of all volumes together (8 bytes each), those that a launch finds (64 bytes each
# meanwhile), and points of a cell, one an octant
CELLS_MOST, CELLS_TOGETHER, CELLS_AT_ONCE = 32, 1 << 20, 1 << 18
CELL_POINTS = 8
# A volume is taken to be this much denser than at the densest point that was found
_MARGIN = 1.1
# Bounds are widened until points that are asked alone have at most this share of the density above them
_MISSING_MOST = 0.005
# Flights along an edge of a cell at most: what is denser lets nothing through a small part of the cell
_FLIGHTS_MOST = 4096.0
# Lines go out of the middle of the world's volume to its end: their cells, the optical depth of a cell below which it
# is empty, and that of a line from which on no light comes in
_LINE_CELLS = 8
_DIMS_LEAST, _DIMS_MOST = 1e-3, 7.0
# The largest numbers of two sets of those of each set: the largest one (NumPy's maximum), or more of them
Join = Callable[[np.ndarray, np.ndarray], np.ndarray]
# Kinds of rays, of which each has a bit; each with bounce 0 and 1
RAYS = 2 * int(Visibility.ALL).bit_count()


@dataclass(frozen=True)
class Bounded:
    """A volume with a program, where an instance has it; instance -1 is the world."""

    instance: int
    volume: int
    box: np.ndarray  # two corners in the space of the instance, or in the world [m], float64, shape [2, 3]
    to_world: np.ndarray  # float64, shape [3, 4]
    moves: bool = False  # the instance does, while the shutter is open
    mesh: Mesh | None = None  # that has grids; None: the world


@wp.func
def point_of_cell(number: int, cells: int, k: int) -> wp.vec3:
    """Point `k` of cell `number` of `cells`^3, the last axis changing fastest, drawn at random in the cell's octant
    `k`: from the corner of their box [cells].
    """
    seed = mix_bits(wp.uint32(number * wp.static(CELL_POINTS) + k))
    return wp.vec3(
        float(number / (cells * cells)) + 0.5 * (float((k >> 2) & 1) + sequence_number(seed)),
        float((number / cells) % cells) + 0.5 * (float((k >> 1) & 1) + sequence_number(mix_bits(seed + wp.uint32(1)))),
        float(number % cells) + 0.5 * (float(k & 1) + sequence_number(mix_bits(seed + wp.uint32(2)))),
    )


@functools.cache
def make_bound(programs: ProgramFeatures, emission: bool = False) -> wp.Function:
    """Function (volumes, i: int): finds the largest extinction at points of cell `i` of the boxes that are `asked` for,
    and what is known of its `emission`.
    """
    medium = make_medium(replace(programs, flows=False))

    @wp.func
    def bound(volumes: VolumeData, i: int):
        cells = volumes.asked.cells
        per_box = cells * cells * cells
        box = volumes.asked.boxes[i / per_box]
        cell = i % per_box
        inside = wp.vec4i(box.code, 0, 0, 0)
        floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        emitted = wp.vec2(0.0)
        points = int(CELL_POINTS)
        more = volumes.asked.places.shape[0] / (volumes.asked.boxes.shape[0] * per_box)
        first = points * (box.first + cell)
        everywhere = wp.vec2(0.0)  # what counts in all octants: peaks of grids, and what is looked at at one time alone
        for k in range(points + more):
            largest = float(0.0)
            least = float(0.0)
            place = box.origin + box.edges * (point_of_cell(cell, cells, k) / float(cells))
            if k >= points:
                place = volumes.asked.places[i * more + k - points]
            time = float(0.0)
            if box.moving >= 0:
                time = wp.min(float(k) / float(points - 1), 1.0)
                place = transform_point(transform_at(volumes.nodes.geometry, box.moving, time), place)
            ray = int(0)
            while ray < volumes.asked.rays:
                point = ray_point(place, wp.vec3(0.0, 0.0, 1.0), int(1) << (ray / 2), ray % 2, time)
                m = medium(volumes, inside, point, lobes)
                if wp.static(emission):
                    light = wp.min((m.emission[0] + m.emission[1] + m.emission[2]) / 3.0, 1.0e18)
                    emitted += wp.vec2(light, light * light) / wp.static(float(CELL_POINTS))
                for axis in range(3):
                    largest = wp.max(largest, m.extinction[axis])
                    if m.emission[axis] > 0.0:  # it must be met too, however little else is there
                        least = box.least_flights
                ray += 1
            largest = wp.min(largest, 1.0e18)
            found = wp.vec2(largest, wp.max(largest, least))
            if k < points and box.moving < 0:
                volumes.asked.found[first + k] = found
            else:
                everywhere = wp.max(everywhere, found)
        if more > 0 or box.moving >= 0:
            for octant in range(points):
                volumes.asked.found[first + octant] = wp.max(volumes.asked.found[first + octant], everywhere)
        if wp.static(emission):
            if volumes.asked.emitted.shape[0] > 0:
                volumes.asked.emitted[i] = emitted

    return bound


@dataclass(frozen=True)
class FoundBounds:
    """Bounds on a device; see `VolumeData`."""

    grids: wp.array
    bounds: wp.array
    # the largest extinction that each of them may have where some of it is denser [1/m], else infinity: float64
    most: np.ndarray
    goes_on: bool = False  # the world's volume, beyond its end (`goes_on_beyond`)

    @property
    def device_bytes(self) -> int:
        """Memory that they take on the device [bytes]."""
        return self.grids.capacity + self.bounds.capacity


def find_bounds(
    volumes: VolumeData,
    bounded: list[Bounded],
    launch: Callable[[VolumeData, int], None],
    device: wp.Device,
    rays: int = RAYS,
) -> FoundBounds | None:
    """The bounds of `volumes`, of which everything else is there, by `launch(volumes, cell_count)` of `make_bound`;
    None where there are none. `rays`: of how many kinds of rays the largest counts; 1 where programs do not
    distinguish them.
    """
    if not bounded:
        return None
    cells = int(np.clip((CELLS_TOGETHER / len(bounded)) ** (1 / 3), 1, CELLS_MOST))
    count = cells**3
    grids = np.zeros(len(bounded), Bounds.numpy_dtype())
    boxes = np.zeros(len(bounded), BoundBox.numpy_dtype())
    low = np.stack([each.box[0] for each in bounded])
    extent = np.stack([np.abs(each.box).max() for each in bounded])
    size = np.maximum(
        np.stack([np.ptp(each.box, axis=0) for each in bounded]), 1e-6 * np.maximum(extent, 1e-12)[:, None]
    )
    placed = np.stack([each.to_world for each in bounded])
    edge = np.linalg.norm(placed[:, :, :3] * size[:, None], axis=1).max(1) / cells
    # bounds of what moves go with it
    placed[[each.moves for each in bounded]] = np.eye(3, 4)
    origin = np.einsum("nij,nj->ni", placed[:, :, :3], low) + placed[:, :, 3]
    edges = placed[:, :, :3] * size[:, None]
    boxes["origin"], boxes["edges"] = origin, edges
    boxes["code"] = [1 + each.instance * volumes.volume_count + each.volume for each in bounded]
    boxes["code"][[each.instance < 0 for each in bounded]] = 0
    boxes["moving"] = [each.instance if each.moves else -1 for each in bounded]
    boxes["least_flights"] = 1.0 / edge
    inverse = np.linalg.inv(edges) * cells
    grids["to_cells"][:, :, :3], grids["to_cells"][:, :, 3] = inverse, -np.einsum("nij,nj->ni", inverse, origin)
    grids["size"], grids["first"] = cells, np.arange(len(bounded)) * count
    most = _FLIGHTS_MOST / edge
    peaks: dict[int, np.ndarray] = {}  # by identity of the mesh
    world = volumes.world
    alike: dict[tuple[bool, int], list[int]] = {}  # by what a launch has in common
    for number, each in enumerate(bounded):
        grid_count = 0 if each.mesh is None else len(each.mesh.grids)
        alike.setdefault((each.instance < 0, grid_count), []).append(number)
    at_once = max(CELLS_AT_ONCE // count, 1)
    launches = [
        (*what, numbers[first : first + at_once])
        for what, numbers in alike.items()
        for first in range(0, len(numbers), at_once)
    ]
    around = np.zeros((len(bounded), cells, cells, cells, 2), np.float32)
    for is_world, grid_count, together in launches:
        volumes.world = world if is_world else -1  # each alone
        boxes["first"][together] = np.arange(len(together)) * count
        asked = BoundWork()
        asked.cells, asked.rays = cells, rays
        asked.found = wp.zeros(len(together) * count * CELL_POINTS, dtype=wp.vec2, device=device)
        asked.boxes = wp.array(boxes[together], dtype=BoundBox, device=device)
        if grid_count:
            places = []
            for number in together:
                mesh = bounded[number].mesh
                assert mesh is not None
                if id(mesh) not in peaks:
                    of_grids = [peaks_of(grid, low[number], size[number], cells)[0] for grid in mesh.grids]
                    peaks[id(mesh)] = np.stack(of_grids, 1).reshape(-1, 3)
                places.append((peaks[id(mesh)] @ placed[number, :, :3].T + placed[number, :, 3]).astype(np.float32))
            asked.places = wp.array(np.concatenate(places), dtype=wp.vec3, device=device)
        volumes.asked = asked
        launch(volumes, len(together) * count)
        shape = len(together), cells, cells, cells, 2, 2, 2, 2
        around[together] = _largest_anywhere_near(to_numpy(asked.found).reshape(shape))
        for number in together:
            mesh = bounded[number].mesh
            if mesh is not None and mesh.flow is not None:
                around[number] = _spread(around[number], np.ceil(flow_reach(mesh) / size[number] * cells).astype(int))
        volumes.asked = asked = BoundWork()  # before the next one takes memory
    volumes.world = world
    denser = around.reshape(len(bounded), -1).max(1) > most
    numbers = np.minimum(_MARGIN * around, most[:, None, None, None, None])
    return FoundBounds(
        grids=wp.array(grids, dtype=Bounds, device=device),
        bounds=wp.array(numbers.reshape(-1, 2).astype(np.float32), dtype=wp.vec2, device=device),
        most=np.where(denser, most, np.inf),
    )


def goes_on_beyond(
    volumes: VolumeData, box: np.ndarray, launch: Callable[[VolumeData, int], None], device: wp.Device
) -> bool:
    """Whether the world's volume, whose bounds are those of `box`, would dim light that comes from beyond its end: if
    there is any of it at the end, and not so much before that hardly any light comes from there.
    """
    cells = 2 * _LINE_CELLS + 1
    edge = (1 + 2 * WORLD_REACH) * (box[1] - box[0])
    whole = np.zeros(1, BoundBox.numpy_dtype())
    whole["origin"], whole["edges"], whole["moving"] = box.mean(0) - edge / 2, np.diag(edge), -1
    asked = BoundWork()
    asked.cells, asked.rays = cells, 1
    asked.boxes = wp.array(whole, dtype=BoundBox, device=device)
    asked.found = wp.zeros(cells**3 * CELL_POINTS, dtype=wp.vec2, device=device)
    volumes.asked = asked
    launch(volumes, cells**3)
    volumes.asked = BoundWork()
    found = largest_of_cells(asked.found).reshape(cells, cells, cells)
    for axis in range(3):
        line = np.moveaxis(found, axis, 0)[:, _LINE_CELLS, _LINE_CELLS] * edge[axis] / cells
        for way in (line[_LINE_CELLS:], line[_LINE_CELLS::-1]):
            if way[-1] > _DIMS_LEAST and way.sum() < _DIMS_MOST:
                return True
    return False


def largest_of_cells(found: wp.array) -> np.ndarray:
    """The largest extinction of each cell of `BoundWork.found` [1/m], float64."""
    return to_numpy(found)[:, EXTINCTION].reshape(-1, CELL_POINTS).max(1).astype(np.float64)


def _largest_anywhere_near(octants: np.ndarray) -> np.ndarray:
    """The largest of each cell and of all around it, so far away as it takes for other points to tell of the largest
    that is found in a cell. Of volumes together: shape [n, x, y, z, 2] from [n, x, y, z, 2, 2, 2, 2].
    """
    octants = np.ascontiguousarray(np.moveaxis(octants, 0, 6))
    extinction, cells = octants[..., EXTINCTION], len(octants)
    own = extinction.max((3, 4, 5))
    whole = np.maximum(extinction.sum((0, 1, 2, 3, 4, 5), dtype=np.float64), 1e-300)

    def missing(of: np.ndarray, largest_two: np.ndarray) -> np.ndarray:
        """Shares of the density of the volumes `of` that `largest_two` points of a cell and around it leave out."""
        (most, second), alone = np.moveaxis(largest_two, -1, 0), own[..., of]
        above = alone - _MARGIN * np.where(alone < most, most, second)
        return np.maximum(above, 0.0).sum((0, 1, 2), dtype=np.float64) / whole[of]

    largest, every = _largest_around(octants), np.arange(octants.shape[6])
    # sets that are joined have nothing in common: points of octants, or of cells
    lacks = missing(every, _largest_around(np.stack([extinction, np.zeros_like(extinction)], -1), _two_largest))
    wider = np.flatnonzero(lacks > _MISSING_MOST)
    if len(wider):
        points = extinction[..., wider].reshape(*own.shape[:3], CELL_POINTS, len(wider))
        in_cell = np.moveaxis(np.partition(points, -2, 3)[:, :, :, :-3:-1], 3, -1)
        # what no other point tells of is not found by widening either
        most = np.maximum(_MISSING_MOST, 1.1 * missing(wider, _spread(in_cell, np.full(3, cells), _two_largest)))
        far, lacks = 0, lacks[wider]
        while (left := lacks > most).any():
            far = min(max(1, 2 * far), cells)
            wider, most, in_cell = wider[left], most[left], in_cell[..., left, :]
            lacks = missing(wider, _spread(in_cell, np.full(3, far), _two_largest))
            enough = wider[~(lacks > most)]
            largest[..., enough, :] = _spread(largest[..., enough, :], np.full(3, far))
    return np.moveaxis(largest, 3, 0)


def _two_largest(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The two largest, [..., 2], of those of two sets."""
    (first, second), (other, next_one) = np.moveaxis(some, -1, 0), np.moveaxis(others, -1, 0)
    return np.stack([np.maximum(first, other), np.maximum(np.minimum(first, other), np.maximum(second, next_one))], -1)


def _largest_around(octants: np.ndarray, join: Join = np.maximum) -> np.ndarray:
    """The largest of each cell and of the octants that touch it; shape [x, y, z, ...] from [x, y, z, 2, 2, 2, ...]."""
    cells = octants
    for axis in range(3):
        # the half of a cell before it, its own two, the half of one behind it; those at the ends have none
        low, high = (half.squeeze(3) for half in np.split(cells, 2, 3))
        before, behind = (np.moveaxis(half, axis, 0) for half in (low, high))
        own = np.moveaxis(join(low, high), axis, 0)
        own[1:] = join(own[1:], behind[:-1])
        own[:-1] = join(own[:-1], before[1:])
        cells = np.moveaxis(own, 0, axis)
    return cells


def _spread(cells: np.ndarray, reach: np.ndarray, join: Join = np.maximum) -> np.ndarray:
    """The largest of all cells that are at most `reach` cells from each along each axis; shape [x, y, z, ...]."""
    for axis, far in enumerate(np.minimum(reach, cells.shape[:3]).tolist()):
        moved = np.moveaxis(cells, axis, 0)
        spread = moved.copy()
        for step in range(1, far + 1):
            spread[step:] = join(spread[step:], moved[:-step])
            spread[:-step] = join(spread[:-step], moved[step:])
        cells = np.moveaxis(spread, 0, axis)
    return cells


def bounded_volumes(
    scene: Scene, volume_of: np.ndarray, has_program: list[bool], world_box: np.ndarray
) -> list[Bounded]:
    """All volumes of `scene` with programs, of each instance one; the world's is taken to fill `world_box`."""
    result = []
    instances = scene.instances
    moves = moving_instances(scene)
    for instance, mesh_index in enumerate(instances.mesh.tolist()):
        mesh = scene.meshes[mesh_index]
        if len(mesh.triangles) == 0 or mesh.radii is not None:
            continue
        slots = slots_of(mesh)
        first = int(instances.slot_first[instance])
        for volume in sorted({int(volume_of[m]) for m in scene.slot_materials[first : first + slots]}):
            if volume >= 0 and has_program[volume]:
                box = fact(mesh.positions if mesh.motion is None else mesh.motion, _box_of_steps)
                placing = np.asarray(instances.transform[instance], np.float64)
                result.append(Bounded(instance, volume, box, placing, bool(moves[instance]), mesh))
    if scene.world.volume is not None and has_program[-1]:
        result.append(Bounded(-1, len(has_program) - 1, world_box, np.eye(3, 4)))
    return result


def slots_of(mesh: Mesh) -> int:
    """How many slots of materials the triangles of `mesh` have."""
    return 1 if mesh.triangle_slot is None else fact(mesh.triangle_slot, _largest) + 1


def _largest(numbers: np.ndarray) -> int:
    return int(numbers.max())


def _box_of_steps(positions: np.ndarray) -> np.ndarray:
    """The box of `positions`, [..., 3]: float64, shape [2, 3]."""
    return box_of(positions.reshape(-1, 3)).astype(np.float64)
