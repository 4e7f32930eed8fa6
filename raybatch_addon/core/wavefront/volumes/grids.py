"""Grids of volumes on the device: sparse ones (NanoVDB), in the table in which programs look up attributes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import warp as wp

from ...device.devices import load_module
from ...device.kernel import KERNEL_OPTIONS
from ...programs.inputs_data import InputData
from ...programs.ops.inputs.grids import GRID_NUMBERS
from ...scene.description import Grid, Scene
from ...shading.volumes.grids import CUBE_CORNERS, TILE, grid_digest, is_scalar, tiles_of
from .table import Flow, VolumeData

# Tiles of a grid whose voxels are looked at together
_TILES_TOGETHER = 2048


class GridCache:
    """The grids of the last frame on the device, by what they hold: most of a file's frames read the same again."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, bytes], wp.Volume] = {}

    @property
    def device_bytes(self) -> int:
        """Memory that they take on the device [bytes]."""
        return sum(volume.get_grid_info().size_in_bytes for volume in self._kept.values())

    def clear(self) -> None:
        """Forget them."""
        self._kept = {}

    def keep_only(self, used: Iterable[tuple[str, bytes]]) -> None:
        """Forget those whose keys are not `used`, before there are more of them."""
        self._kept = {key: self._kept[key] for key in set(used) if key in self._kept}

    def get(self, key: tuple[str, bytes], grid: Grid, device: wp.Device) -> wp.Volume:
        """`grid`, with its `grid_key`, on `device`."""
        if key not in self._kept:
            self._kept[key] = load_grid(grid, device)
        return self._kept[key]


def grid_key(grid: Grid, device: wp.Device) -> tuple[str, bytes]:
    """What sets a grid apart from others."""
    return device.alias, grid_digest(grid)


def load_grid(grid: Grid, device: wp.Device) -> wp.Volume:
    """The tiles of `grid` on `device`."""
    corners, values = tiles_of(grid)
    if not len(corners):  # a volume has a tile at least
        corners, values = np.zeros((1, 3), np.int32), np.zeros((1, *values.shape[1:]), np.float32)
    scalar = is_scalar(grid)
    first = wp.array(corners, dtype=wp.vec3i, device=device)
    volume = wp.Volume.allocate_by_tiles(first, 1.0, 0.0 if scalar else wp.vec3(), device=device)
    numbers = np.ascontiguousarray(values, np.float32).reshape(-1, *values.shape[4:])
    stored = wp.array(numbers, dtype=float if scalar else wp.vec3, device=device)
    kernel = store_numbers if scalar else store_vectors
    load_module(kernel, device)
    wp.launch(kernel, len(numbers), [volume.id, first, stored], device=device)
    return volume


@wp.func
def _voxel(corners: wp.array(dtype=wp.vec3i), i: int) -> wp.vec3i:
    """Indices of value `i` of all tiles."""
    corner = corners[i / wp.static(TILE**3)]
    at = i % wp.static(TILE**3)
    return corner + wp.vec3i(at / wp.static(TILE**2), (at / wp.static(TILE)) % wp.static(TILE), at % wp.static(TILE))


@wp.kernel(**KERNEL_OPTIONS)
def store_numbers(volume: wp.uint64, corners: wp.array(dtype=wp.vec3i), values: wp.array(dtype=float)):
    """Write values of tiles to a volume that has them."""
    i = wp.tid()
    at = _voxel(corners, i)
    wp.volume_store(volume, at[0], at[1], at[2], values[i])


@wp.kernel(**KERNEL_OPTIONS)
def store_vectors(volume: wp.uint64, corners: wp.array(dtype=wp.vec3i), values: wp.array(dtype=wp.vec3)):
    """The same for vectors."""
    i = wp.tid()
    at = _voxel(corners, i)
    wp.volume_store(volume, at[0], at[1], at[2], values[i])


def upload_grids(scene: Scene, inputs: InputData, device: wp.Device, cache: GridCache) -> list[wp.Volume]:
    """The grids of all meshes of `scene`, noted in `inputs`; they have to be kept. Nothing where there are none."""
    if not any(mesh.grids for mesh in scene.meshes):
        cache.clear()
        return []
    keys: dict[int, tuple[str, bytes]] = {}  # by identity of the values
    for mesh in scene.meshes:
        grids = mesh.grids if mesh.flow is None else (*mesh.grids, mesh.flow)
        keys |= {id(grid.values): grid_key(grid, device) for grid in grids if id(grid.values) not in keys}
    cache.keep_only(keys.values())
    uploaded: dict[int, wp.Volume] = {}
    shape = (len(scene.meshes), max(len(scene.attributes), 1))
    first, layout = np.full(shape, -1, np.int32), np.zeros(shape, np.int32)
    numbers: list[np.ndarray] = []
    for row, mesh in enumerate(scene.meshes):
        for grid in mesh.grids:
            columns = [i for i, each in enumerate(scene.attributes) if each in _keys(grid.name)]
            if not columns:
                continue
            if id(grid.values) not in uploaded:
                uploaded[id(grid.values)] = cache.get(keys[id(grid.values)], grid, device)
            first[row, columns] = GRID_NUMBERS * len(numbers)
            layout[row, columns] = 1 if is_scalar(grid) else 3
            address = np.array([uploaded[id(grid.values)].id], np.uint64).view(np.float32)
            numbers.append(np.concatenate([address, np.asarray(grid.to_index, np.float32).ravel()]))
    inputs.attribute_row = wp.array(np.asarray(scene.instances.mesh, np.int32), dtype=int, device=device)
    inputs.attribute_first = wp.array(first, dtype=int, device=device)
    inputs.attribute_layout = wp.array(layout, dtype=int, device=device)
    joined = np.concatenate(numbers) if numbers else np.zeros(0, np.float32)
    inputs.attribute_values = wp.array(joined, dtype=float, device=device)
    return list(uploaded.values())


def upload_flows(scene: Scene, data: VolumeData, device: wp.Device, cache: GridCache) -> list[wp.Volume]:
    """How what fills meshes moves, noted in `data`; the grids have to be kept. Nothing where nothing does."""
    moving = [i for i, mesh in enumerate(scene.meshes) if mesh.flow is not None]
    if not moving:
        return []
    flows, volumes = np.zeros(len(moving), Flow.numpy_dtype()), []
    row_of = np.full(len(scene.meshes), -1, np.int32)
    for row, index in enumerate(moving):
        mesh = scene.meshes[index]
        assert mesh.flow is not None
        volumes.append(cache.get(grid_key(mesh.flow, device), mesh.flow, device))
        flows[row]["grid"], flows[row]["to_index"] = volumes[-1].id, mesh.flow.to_index
        flows[row]["time"] = mesh.flow_time
        row_of[index] = row
    data.flows = wp.array(flows, dtype=Flow, device=device)
    data.flow_of = wp.array(row_of[scene.instances.mesh], dtype=int, device=device)
    return volumes


def _keys(name: str) -> tuple[tuple[str, str], ...]:
    """What programs ask for the grid `name` as: an attribute of any geometry, or one that only volumes have."""
    return ("GEOMETRY", name), ("GRID", name)


def density_scale(scene: Scene) -> np.ndarray | None:
    """Factor of the coefficients of each instance, float32, shape [n]; None where all are 1. Densities of object space
    are thinner in objects that are larger.
    """
    if not any(mesh.object_density for mesh in scene.meshes):
        return None
    linear = np.asarray(scene.instances.transform, np.float64)[:, :, :3]
    size = np.linalg.norm(linear @ np.full(3, 3**-0.5), axis=1)
    asked = np.array([mesh.object_density for mesh in scene.meshes])[scene.instances.mesh]
    return np.where(asked & (size > 0), 1 / np.where(size > 0, size, 1), 1).astype(np.float32)


def peaks_of(grid: Grid, low: np.ndarray, size: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Where `grid` has its largest value in each of `cells`^3 cells of the box that begins at `low`: object space [m],
    float64, shape [cells^3, 3], the middle of a cell in which there is nothing; and these values, float32.
    """
    whole = np.vstack([np.asarray(grid.to_index, np.float64), [0, 0, 0, 1]])
    to_object = np.linalg.inv(whole)[:3]
    middles = np.stack(np.meshgrid(*[np.arange(cells) + 0.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    places, best = low + middles / cells * size, np.zeros(cells**3, np.float32)

    def cell_of(at: np.ndarray) -> np.ndarray:
        return np.clip((at - low) / size * cells, 0, cells - 1).astype(int)

    def add(voxels: np.ndarray, found: np.ndarray) -> None:
        at = voxels @ to_object[:, :3].T + to_object[:, 3]
        number = cell_of(at) @ (cells * cells, cells, 1)
        np.maximum.at(best, number, found)
        won = found >= best[number]
        places[number[won]] = at[won]

    corners, tiles = tiles_of(grid)
    for first in range(0, len(corners), _TILES_TOGETHER):
        corner = corners[first : first + _TILES_TOGETHER]
        values = tiles[first : first + _TILES_TOGETHER]
        if not is_scalar(grid):
            values = np.abs(values).max(-1)
        # a tile that lies in one cell counts by its largest value alone
        ends = (corner[:, None] + (TILE - 1) * CUBE_CORNERS) @ to_object[:, :3].T + to_object[:, 3]
        in_cells = cell_of(ends)
        alone = (in_cells.min(1) == in_cells.max(1)).all(1)
        flat = values[alone].reshape(-1, TILE**3)
        largest = flat.argmax(1) if len(flat) else np.zeros(0, int)
        found = flat[np.arange(len(flat)), largest]
        voxels = corner[alone] + np.stack(np.unravel_index(largest, (TILE,) * 3), 1)
        add(voxels[found > 0], found[found > 0])
        tile, *voxel = np.nonzero(values[~alone] > 0)
        add(corner[~alone][tile] + np.stack(voxel, 1), values[~alone][(tile, *voxel)])
    return places, best
