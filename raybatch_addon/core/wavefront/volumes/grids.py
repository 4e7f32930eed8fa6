"""Grids of volumes on the device: sparse ones (NanoVDB), in the table in which programs look up attributes."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...programs.inputs_data import InputData
from ...programs.ops.inputs.grids import GRID_NUMBERS
from ...scene.description import Scene


def upload_grids(scene: Scene, inputs: InputData, device: wp.Device) -> list[wp.Volume]:
    """The grids of all meshes of `scene`, noted in `inputs`; they have to be kept. Nothing where there are none."""
    if not any(mesh.grids for mesh in scene.meshes):
        return []
    kept: list[wp.Volume] = []
    uploaded: dict[int, wp.Volume] = {}  # by identity of the values
    shape = (len(scene.meshes), max(len(scene.attributes), 1))
    first, layout = np.full(shape, -1, np.int32), np.zeros(shape, np.int32)
    numbers: list[np.ndarray] = []
    for row, mesh in enumerate(scene.meshes):
        for grid in mesh.grids:
            columns = [i for i, each in enumerate(scene.attributes) if each in _keys(grid.name)]
            if not columns:
                continue
            values = np.ascontiguousarray(grid.values, np.float32)
            if id(grid.values) not in uploaded:
                background = 0.0 if values.ndim == 3 else (0.0, 0.0, 0.0)
                uploaded[id(grid.values)] = wp.Volume.load_from_numpy(values, bg_value=background, device=device)
                kept.append(uploaded[id(grid.values)])
            first[row, columns] = GRID_NUMBERS * len(numbers)
            layout[row, columns] = 1 if values.ndim == 3 else 3
            address = np.array([uploaded[id(grid.values)].id], np.uint64).view(np.float32)
            numbers.append(np.concatenate([address, np.asarray(grid.to_index, np.float32).ravel()]))
    inputs.attribute_row = wp.array(np.asarray(scene.instances.mesh, np.int32), dtype=int, device=device)
    inputs.attribute_first = wp.array(first, dtype=int, device=device)
    inputs.attribute_layout = wp.array(layout, dtype=int, device=device)
    joined = np.concatenate(numbers) if numbers else np.zeros(0, np.float32)
    inputs.attribute_values = wp.array(joined, dtype=float, device=device)
    return kept


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
