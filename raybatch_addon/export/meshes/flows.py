"""How what grids hold moves while the shutter is open, by grids of velocities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...core.scene.description import Grid, Mesh
from ...core.scene.frozen import freeze
from ...core.shading.volumes.grids import TILE, flow_reach, is_scalar, tiles_of

if TYPE_CHECKING:
    from ..motion.shutter import Exposure

# Names of grids of velocities, beside those that a volume object asks for: as Cycles knows them
_VECTORS = "velocity"
_NUMBERS = ("velocity_x", "velocity_y", "velocity_z")


def _vector_names(volume: bpy.types.Volume) -> list[str]:
    return [name for name in (_VECTORS, volume.velocity_grid) if name]


def _number_names(volume: bpy.types.Volume) -> list[tuple[str, ...]]:
    """By axis: the grids of one number that may hold the velocity along it."""
    asked = (volume.velocity_x_grid, volume.velocity_y_grid, volume.velocity_z_grid)
    return [tuple(filter(None, names)) for names in zip(_NUMBERS, asked, strict=True)]


def flow_names(volume: bpy.types.Volume) -> set[str]:
    """Names of the grids that may hold velocities of `volume`, whose grids are loaded; none where nothing moves by
    them.
    """
    if volume.velocity_scale == 0:
        return set()
    return {*_vector_names(volume), *(name for names in _number_names(volume) for name in names)}


def flow_of_volume(
    volume: bpy.types.Volume, grids: Mapping[str, Grid], exposure: Exposure, label: str, warnings: list[str]
) -> Grid | None:
    """How far what `volume` holds moves in the time of `exposure`; `grids`: those that it has of `flow_names`, by
    name. None where nothing moves.
    """
    if volume.velocity_scale == 0:
        return None
    found = [grids[name] for name in _vector_names(volume) if name in grids and not is_scalar(grids[name])]
    velocity = found[-1] if found else _joined(volume, grids, label, warnings)
    # vectors a frame count for the time that the shutter is open, however long that is: as in Cycles
    seconds = exposure.length / exposure.fps if volume.velocity_unit == "SECOND" else 1.0
    return _scaled(velocity, volume.velocity_scale * seconds)


def flow_of_smoke(domain: bpy.types.FluidDomainSettings, velocity: Grid | None, exposure: Exposure) -> Grid | None:
    """The same of smoke with the grid `velocity`."""
    return _scaled(velocity, domain.velocity_scale * exposure.length / exposure.fps)


def _scaled(velocity: Grid | None, scale: float) -> Grid | None:
    if velocity is None or not math.isfinite(scale):
        return None
    with np.errstate(over="ignore"):
        values = velocity.values * np.float32(scale)
    if not np.isfinite(values).all() or not values.any():
        return None
    return replace(velocity, values=freeze(values))


def _joined(volume: bpy.types.Volume, grids: Mapping[str, Grid], label: str, warnings: list[str]) -> Grid | None:
    """The vectors of which `grids` have a number each."""
    axes = [next((grids[name] for name in names if name in grids), None) for names in _number_names(volume)]
    there = [each for each in axes if each is not None]
    if not there:
        return None
    if any(not is_scalar(each) for each in there):
        return None
    linear = there[0].to_index[:, :3]
    if any(not np.allclose(each.to_index[:, :3], linear, rtol=1e-5) for each in there):
        warnings.append(
            f"{label}: its grids of velocities have voxels of different sizes; it is rendered without motion"
        )
        return None
    where: dict[tuple[int, ...], np.ndarray] = {}
    for axis, grid in enumerate(axes):
        if grid is None:
            continue
        # grids begin at tiles of one lattice, each with indices of its own
        shift = np.rint((there[0].to_index[:, 3] - grid.to_index[:, 3]) / TILE).astype(int) * TILE
        corners, values = tiles_of(grid)
        for corner, tile in zip((corners + shift).tolist(), values, strict=True):
            where.setdefault(tuple(corner), np.zeros((TILE, TILE, TILE, 3), np.float32))[..., axis] = tile
    if not where:
        return None
    return Grid(_VECTORS, np.stack(list(where.values())), there[0].to_index, np.array(list(where), np.int32))


def with_flow(mesh: Mesh, flow: Grid | None, exposure: Exposure) -> Mesh:
    """`mesh`, the box around grids, with how what they hold moves in the time of `exposure`: as large as that comes."""
    if flow is None:
        return mesh
    # grids are of whole frames
    begin = exposure.middle - exposure.length / 2
    moved = replace(mesh, flow=flow, flow_time=(math.floor(exposure.middle) - begin) / exposure.length)
    return enlarged(moved, flow_reach(moved))


def enlarged(mesh: Mesh, reach: np.ndarray) -> Mesh:
    """`mesh`, a box, that goes on by `reach` along each axis to both sides; float64, shape [3]."""
    side = np.sign(mesh.positions - mesh.positions.mean(0))
    return replace(mesh, positions=(mesh.positions + side * reach).astype(np.float32))
