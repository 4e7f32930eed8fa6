"""Grids by tiles: cubes of voxels, of which only those are kept in which there is something."""

from __future__ import annotations

import numpy as np

from ...device.bulk import digest_of
from ...scene.description import Grid, Mesh
from ...scene.frozen import fact

# Voxels along an edge of a tile
TILE = 8
# Corners of a unit cube
CUBE_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def tiles_of(grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Where the tiles of `grid` begin, int32, shape [n, 3], and their values, float32, shape [n, 8, 8, 8] or
    [n, 8, 8, 8, 3].
    """
    if grid.corners is not None:
        return grid.corners, grid.values
    return cut_into_tiles(grid.values)


def cut_into_tiles(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of a block of `values`, shape [x, y, z] or [x, y, z, 3]; without tiles that are 0 everywhere."""
    counts = tuple(-(-size // TILE) for size in values.shape[:3])
    width = values.shape[3:]
    corners, tiles = [np.zeros((0, 3), np.int32)], [np.zeros((0, TILE, TILE, TILE, *width), np.float32)]
    for x in range(counts[0]):
        slab = np.zeros((TILE, counts[1] * TILE, counts[2] * TILE, *width), np.float32)
        part = values[x * TILE : (x + 1) * TILE]
        slab[: part.shape[0], : part.shape[1], : part.shape[2]] = part
        cut = np.moveaxis(slab.reshape(TILE, counts[1], TILE, counts[2], TILE, *width), (1, 3), (0, 1))
        y, z = np.nonzero(cut.any(tuple(range(2, cut.ndim))))
        corners.append(TILE * np.stack([np.full(len(y), x), y, z], 1).astype(np.int32))
        tiles.append(cut[y, z])
    return np.concatenate(corners), np.concatenate(tiles)


def is_scalar(grid: Grid) -> bool:
    """Whether a voxel has one number."""
    return grid.values.ndim == (3 if grid.corners is None else 4)


def flow_reach(mesh: Mesh) -> np.ndarray:
    """How far anything that fills `mesh` is from where its grids have it, at most, along each axis of its space [m];
    float64, shape [3].
    """
    if mesh.flow is None:
        return np.zeros(3)
    most = np.abs(mesh.flow.values.reshape(-1, 3)).max(0, initial=0).astype(np.float64)
    return most * max(abs(mesh.flow_time), abs(1 - mesh.flow_time))


def grid_digest(grid: Grid) -> bytes:
    """Equal for grids of equal values in equal places among their indices only."""
    return fact(grid.values, _digest) + (b"" if grid.corners is None else fact(grid.corners, _digest))


def _digest(array: np.ndarray) -> bytes:
    return digest_of([array])
