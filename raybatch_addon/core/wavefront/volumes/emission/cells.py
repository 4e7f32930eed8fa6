"""Cells of the volumes that emit: found before the render, on a grid over each.

How bright a cell is, is estimated at some points of it: by the program of the volume, and by the share of the points
that lie within its surface. What is brighter than estimated is aimed at more seldom, and what no point shows is left to
scattered rays. So are volumes that move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.devices import load_module
from ....device.kernel import KERNEL_OPTIONS
from ....scene.description import ClosureKind, Mesh, Scene
from ....scene.features import emits_somewhere, scene_volumes
from ....scene.linking import links_lights
from ....scene.passes import light_group_passes
from ....shading.lights.emitters import EmissiveCells
from ....shading.sequences.keys import mix_bits, sequence_number
from ....shading.volumes.enclosures import AHEAD, FARTHEST
from ..bounds import CELLS_MOST, Bounded
from ..grids import density_scale
from ..table import UNLIKE, BoundWork, EmissionGrid, VolumeData, VolumeLights
from .aimed import aimed_volumes
from .weigh import POINTS

# Cells along each axis at most, and cells of all volumes together
_EMITTERS_ALONG, _EMITTERS_TOGETHER = 16, 1 << 16
_POINTS = 8
# Share of its own brightness that a cell gives to the cells around it, whose points may have missed something
_SPREAD = 0.1


@dataclass(frozen=True)
class FoundCells:
    """Cells of volumes as emitters, and where they are."""

    cells: EmissiveCells
    of: np.ndarray  # see `VolumeLights`
    grids: np.ndarray
    emitters: np.ndarray  # from 0 on
    codes: np.ndarray
    emits: np.ndarray
    innermost: bool

    def upload(self, first: int, device: wp.Device) -> VolumeLights:
        """The table for kernels; `first`: the first emitter that is a cell."""
        lights = VolumeLights()
        lights.emits = wp.array(self.emits, dtype=int, device=device)
        lights.of = wp.array(self.of, dtype=int, device=device)
        lights.grids = wp.array(self.grids, dtype=EmissionGrid, device=device)
        shifted = np.where(self.emitters >= 0, self.emitters + first, -1).astype(np.int32)
        lights.emitters = wp.array(shifted, dtype=int, device=device)
        lights.codes = wp.array(self.codes, dtype=int, device=device)
        lights.first = first
        lights.has_unlike, lights.innermost = int(bool((self.of == UNLIKE).any())), int(self.innermost)
        return lights


@wp.kernel(**KERNEL_OPTIONS)
def inside_kernel(mesh: wp.uint64, cells: int, found: wp.array(dtype=float)):
    """The share of the points of each cell of the box from 0 to 1 that are in a closed surface."""
    i = wp.tid()
    cell = wp.vec3(float(i / (cells * cells)), float((i / cells) % cells), float(i % cells))
    inside = int(0)
    for k in range(_POINTS):
        seed = mix_bits(wp.uint32(i * _POINTS + k))
        u = wp.vec3(
            sequence_number(seed),
            sequence_number(mix_bits(seed + wp.uint32(1))),
            sequence_number(mix_bits(seed + wp.uint32(2))),
        )
        ahead = wp.normalize(wp.vec3(wp.static(AHEAD[0]), wp.static(AHEAD[1]), wp.static(AHEAD[2])))
        hit = wp.mesh_query_ray(mesh, (cell + u) / float(cells), ahead, wp.static(FARTHEST))
        if hit.result and hit.sign < 0.0:
            inside += 1
    found[i] = float(inside) / float(_POINTS)


def find_cells(
    volumes: VolumeData,
    scene: Scene,
    volume_of: np.ndarray,
    launch: Callable[[VolumeData, int], None],
    device: wp.Device,
) -> FoundCells | None:
    """The cells of `volumes` of `scene`, of which everything else is there; None where none is aimed at.

    `volume_of`: volume of each material, -1: none. `launch(volumes, cell_count)`: of `make_bound` with emission.
    """
    filling = scene_volumes(scene)
    bounded, unlike = aimed_volumes(scene, volume_of)
    if not bounded:
        return None
    count = int(np.clip((_EMITTERS_TOGETHER / len(bounded)) ** (1 / 3), 1, _EMITTERS_ALONG))
    grids = np.zeros(len(bounded), EmissionGrid.numpy_dtype())
    of = np.full(max(len(scene.instances), 1) * volumes.volume_count, -1, np.int32)
    of[[each.instance * volumes.volume_count + each.volume for each in unlike]] = UNLIKE
    thinner = density_scale(scene)
    shares: dict[tuple, np.ndarray] = {}
    parts, emitters, codes, total = [], [], [], 0
    for number, each in enumerate(bounded):
        code = 1 + each.instance * volumes.volume_count + each.volume
        low, size = each.box[0], np.maximum(np.ptp(each.box, axis=0), 1e-30)
        slots = _slots(scene, each, volume_of)
        key = (id(each.mesh), slots.tobytes())
        if key not in shares:
            shares[key] = _inside(each.mesh, slots, low, size, count, device)
        edges = each.to_world[:, :3] * size
        # as kernels have it: cells begin where they are looked for
        origin = (each.to_world[:, :3] @ low + each.to_world[:, 3]).astype(np.float32).astype(np.float64)
        longest = float(np.linalg.norm(edges, axis=0).max())
        volume = filling[each.volume]
        if volume.program is None:
            scale = 1.0 if thinner is None else float(thinner[each.instance])
            weights = {True: np.zeros(3), False: np.zeros(3)}
            for closure in volume.closures:
                weights[closure.kind == ClosureKind.EMISSION] += scale * np.asarray(closure.weight, float)
            emission = np.full(count**3, weights[True].mean())
            rate = np.full(count**3, weights[False].max() + POINTS / longest)
        else:
            emission, extinction = _evaluated(volumes, code, origin, edges, count, launch, device)
            rate = np.maximum(extinction, (CELLS_MOST if volumes.varies else POINTS) / longest)
        strength = emission * shares[key] * abs(np.linalg.det(edges)) / count**3
        strength = _spread(strength.reshape((count,) * 3)).ravel() * (shares[key] > 0)
        strength = np.where(np.isfinite(strength), strength, 0)
        bright = np.flatnonzero(strength > 0)
        grids[number]["origin"], grids[number]["to_cells"] = origin, np.linalg.inv(edges) * count
        grids[number]["size"], grids[number]["first"] = count, number * count**3
        of[code - 1] = number
        place = np.stack(np.unravel_index(bright, (count,) * 3), 1)
        middle = origin + (place + 0.5) / count @ edges.T
        half = np.broadcast_to(edges.T / (2 * count), (len(bright), 3, 3))
        parts.append((middle, half, rate[bright], strength[bright], np.full(len(bright), each.instance, np.int32)))
        numbers = np.full(count**3, -1)
        numbers[bright] = total + np.arange(len(bright))
        emitters.append(numbers)
        codes.append(np.full(len(bright), code, np.int32))
        total += len(bright)
    if not total:
        return None
    cells = EmissiveCells(*(np.concatenate(values) for values in zip(*parts)))
    may_emit = np.array([emits_somewhere(volume) for volume in filling], np.int32)
    owned = links_lights(scene) or bool(light_group_passes(scene.frame.passes))
    return FoundCells(cells, of, grids, np.concatenate(emitters), np.concatenate(codes), may_emit, owned)


def _slots(scene: Scene, each: Bounded, volume_of: np.ndarray) -> np.ndarray:
    """Whether each material slot of an instance has the volume."""
    slots = 1 if each.mesh.triangle_slot is None else int(each.mesh.triangle_slot.max()) + 1
    first = int(scene.instances.slot_first[each.instance])
    return volume_of[scene.slot_materials[first : first + slots]] == each.volume


def _inside(
    mesh: Mesh, slots: np.ndarray, low: np.ndarray, size: np.ndarray, count: int, device: wp.Device
) -> np.ndarray:
    """Share of each cell that is in the surface of the triangles with these `slots`; float64, shape [count^3]."""
    corners = mesh.triangles if mesh.triangle_slot is None else mesh.triangles[slots[mesh.triangle_slot]]
    if not len(corners):
        return np.zeros(count**3)
    positions = ((mesh.positions - low) / size).astype(np.float32)
    surface = wp.Mesh(
        wp.array(positions, dtype=wp.vec3, device=device),
        wp.array(np.ascontiguousarray(corners, np.int32).ravel(), dtype=int, device=device),
    )
    found = wp.zeros(count**3, dtype=float, device=device)
    load_module(inside_kernel, device)
    wp.launch(inside_kernel, count**3, [surface.id, count, found], device=device)
    return found.numpy().astype(np.float64)


def _evaluated(
    volumes: VolumeData,
    code: int,
    origin: np.ndarray,
    edges: np.ndarray,
    count: int,
    launch: Callable[[VolumeData, int], None],
    device: wp.Device,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean emission [W/(m³ sr)] and largest extinction [1/m] of each cell of a volume, float64, shape [count^3]."""
    world, volumes.world = volumes.world, -1
    asked = BoundWork()
    asked.inside, asked.cells, asked.rays, asked.moving = wp.vec4i(code, 0, 0, 0), count, 1, -1
    asked.origin, asked.edges, asked.emission = wp.vec3(*origin), wp.mat33(*edges.ravel()), 1
    asked.found = wp.zeros(2 * count**3, dtype=float, device=device)
    volumes.asked = asked
    launch(volumes, count**3)
    volumes.asked, volumes.world = BoundWork(), world
    extinction, emission = asked.found.numpy().astype(np.float64).reshape(2, -1)
    return emission, extinction


def _spread(strength: np.ndarray) -> np.ndarray:
    """`strength` of cells, shape [n, n, n], with a part of the mean of those around."""
    padded, n = np.pad(strength, 1), strength.shape[0]
    around = sum(padded[x : x + n, y : y + n, z : z + n] for x in range(3) for y in range(3) for z in range(3))
    return strength + _SPREAD / 27 * around
