"""Cells of the volumes that emit: found before the render, on a grid over each.

A cell of which a small part emits is divided into smaller ones, and those again, so that a small flame in a large box,
or one of many in a mesh, is aimed at where it is. What is brighter than estimated is aimed at more seldom, and what no
point shows is left to scattered rays. So are volumes that move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....scene.description import Scene
from ....scene.features import emits_somewhere, scene_volumes
from ....scene.linking import links_lights
from ....scene.passes import light_group_passes
from ....shading.lights.emitters import EmissiveCells
from ..grids import peaks_of
from ..table import PART, UNLIKE, EmissionGrid, VolumeData, VolumeLights
from .aimed import aimed_volumes
from .estimate import CellBoxes, Estimates, Looked

# Cells along each axis at most, and cells of all volumes together
_EMITTERS_ALONG, _EMITTERS_TOGETHER = 16, 1 << 16
# How often cells are divided, and how many of them each time at most
_DIVISIONS, _DIVIDED_MOST = 2, 512
# A cell is divided where less of it emits, and where so much of all light is aimed at in vain in it
_FULL, _IN_VAIN_LEAST = 0.5, 1e-4
# Steps of float32 between points of a cell at least: points that are rounded into a cell beside theirs are few
_STEPS_LEAST = 64


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
        shifted = np.where(self.emitters >= 0, self.emitters + first, self.emitters).astype(np.int32)
        lights.emitters = wp.array(shifted, dtype=int, device=device)
        lights.codes = wp.array(self.codes, dtype=int, device=device)
        lights.first = first
        lights.has_unlike, lights.innermost = int(bool((self.of == UNLIKE).any())), int(self.innermost)
        return lights


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
    estimates = Estimates(volumes, scene, bounded, filling, volume_of, launch, device)
    whole = CellBoxes(np.arange(len(bounded)), np.zeros((len(bounded), 3)), np.ones(len(bounded)), count)
    levels = [(whole, estimates.look(whole))]
    tables = [np.full(len(bounded) * count**3, -1)]
    for level in range(_DIVISIONS):
        room = (_EMITTERS_TOGETHER - sum(int((looked.strength > 0).sum()) for _, looked in levels)) // PART**3
        divided = _divided(estimates, *levels[-1], min(room, _DIVIDED_MOST), is_first=level == 0)
        if not len(divided):
            break
        smaller = _parts_of(levels[-1][0], divided)
        looked = estimates.look(smaller)
        kept = looked.strength.any(1)
        if level + 1 < _DIVISIONS:  # the smallest may show what these do not
            dark = levels[-1][1].strength.ravel()[divided] == 0
            kept |= dark & _touched(estimates, smaller, False).reshape(kept.shape[0], -1).any(1)
        divided, smaller = divided[kept], _chosen(smaller, kept)
        looked = Looked(*(values[kept] for values in vars(looked).values()))
        if not len(divided):
            break
        first = sum(map(len, tables))
        levels[-1][1].strength.ravel()[divided] = 0.0
        tables[-1][divided] = -2 - (first + np.arange(len(divided)) * PART**3)
        levels.append((smaller, looked))
        tables.append(np.full(len(divided) * PART**3, -1))
    made, codes, total = [], [], 0
    for (parts, looked), table in zip(levels, tables):
        lit = np.flatnonzero(looked.strength)
        made.append(_cells_at(estimates, parts, looked, lit))
        codes.append(estimates.code[parts.of[lit // parts.count**3]])
        table[lit] = total + np.arange(len(lit))
        total += len(lit)
    if not total:
        return None
    code = np.concatenate(codes)
    instance = ((code - 1) // volumes.volume_count).astype(np.int32)
    cells = EmissiveCells(*(np.concatenate(values) for values in zip(*made)), instance)
    grids = np.zeros(len(bounded), EmissionGrid.numpy_dtype())
    grids["origin"], grids["to_cells"] = estimates.origin, np.linalg.inv(estimates.edges) * count
    grids["size"], grids["first"] = count, np.arange(len(bounded)) * count**3
    of = np.full(max(len(scene.instances), 1) * volumes.volume_count, -1, np.int32)
    of[[each.instance * volumes.volume_count + each.volume for each in unlike]] = UNLIKE
    of[estimates.code - 1] = np.arange(len(bounded))
    may_emit = np.array([emits_somewhere(volume) for volume in filling], np.int32)
    return FoundCells(cells, of, grids, np.concatenate(tables), code.astype(np.int32), may_emit, has_owners(scene))


def has_owners(scene: Scene) -> bool:
    """Whether it matters whose light a volume's is."""
    return links_lights(scene) or bool(light_group_passes(scene.frame.passes))


def _divided(estimates: Estimates, parts: CellBoxes, looked: Looked, most: int, is_first: bool) -> np.ndarray:
    """Cells of `parts` that are to be divided, `most` at most: numbers in `Looked`, ascending."""
    in_vain = np.where(looked.fill < _FULL, looked.strength * (1 - looked.fill), 0.0).ravel()
    total = looked.strength.sum()
    worth = np.where(in_vain > _IN_VAIN_LEAST * total, in_vain, 0.0)
    # where something is that no point has met
    missed = _touched(estimates, parts, is_first) & (looked.strength == 0).ravel()
    worth[missed] = max(_IN_VAIN_LEAST * total, np.finfo(float).tiny)
    corner, edges = estimates.placed(parts)
    narrowest = np.linalg.norm(edges, axis=1).min(1) / (parts.count * PART)
    told = narrowest >= _STEPS_LEAST * np.spacing(np.abs(corner).max(1).astype(np.float32))
    worth[~np.repeat(told, parts.count**3)] = 0.0
    order = np.argsort(-worth, kind="stable")[: max(most, 0)]
    return np.sort(order[worth[order] > 0])


def _touched(estimates: Estimates, parts: CellBoxes, is_first: bool) -> np.ndarray:
    """Whether corners of a surface, or, where `is_first`, voxels of a grid that are not 0, lie in each cell of
    `parts`: bool, flat. Voxels are looked for where cells are whole grids: of smaller ones their own points tell.
    """
    n = parts.count
    result = np.zeros((len(parts), n**3), bool)
    surface = estimates.surface_of[parts.of]
    across = round(n / parts.edge[0])  # cells along a whole box
    at = np.round(parts.corner * across).astype(int)
    cells = np.stack(np.unravel_index(np.arange(n**3), (n,) * 3), 1)
    for number in np.unique(surface).tolist():
        volume, triangles = estimates.surfaces[number]
        mesh, (low, high) = volume.mesh, volume.box
        assert mesh is not None
        size = high - low
        places = np.clip((mesh.positions[np.unique(triangles)] - low) / size * across, 0, across - 1).astype(int)
        there = np.zeros(across**3, bool)
        there[places @ (across * across, across, 1)] = True
        if is_first:
            for grid in mesh.grids:
                there |= peaks_of(grid, low, size, across)[1] > 0
        these = np.flatnonzero(surface == number)
        result[these] = there[(at[these, None] + cells) @ (across * across, across, 1)]
    return result.ravel()


def _parts_of(parts: CellBoxes, divided: np.ndarray) -> CellBoxes:
    """The cells `divided` of `parts`, as parts of their own."""
    part, cell = np.divmod(divided, parts.count**3)
    place = np.stack(np.unravel_index(cell, (parts.count,) * 3), 1)
    edge = parts.edge[part] / parts.count
    return CellBoxes(parts.of[part], parts.corner[part] + place * edge[:, None], edge, PART)


def _chosen(parts: CellBoxes, which: np.ndarray) -> CellBoxes:
    return CellBoxes(parts.of[which], parts.corner[which], parts.edge[which], parts.count)


def _cells_at(estimates: Estimates, parts: CellBoxes, looked: Looked, lit: np.ndarray) -> tuple[np.ndarray, ...]:
    """The first four arrays of `EmissiveCells` for the cells `lit` of `parts`."""
    part, cell = np.divmod(lit, parts.count**3)
    corner, edges = estimates.placed(parts)
    place = np.stack(np.unravel_index(cell, (parts.count,) * 3), 1)
    middle = corner[part] + np.einsum("gij,gj->gi", edges[part], (place + 0.5) / parts.count)
    half = np.swapaxes(edges[part], 1, 2) / (2 * parts.count)
    return middle, half, looked.rate.ravel()[lit], looked.strength.ravel()[lit]
