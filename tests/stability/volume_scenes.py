"""Scenes with a volume that cases and tests share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Frame, Grid, Scene, Volume
from tests.renders.volumes.test_volumes import filled
from tests.support import scenes


def boxed(volume: Volume, size: float = 2.0, eye=(0.0, 0.0, -4.0), target=(0.0, 0.0, 0.0)) -> Scene:
    """A cube of `volume` in a white world, seen through a narrow window."""
    view = scenes.camera(eye=eye, target=target, up=(0, 1, 0), half_width=1e-6)
    return scenes.scene(
        [(scenes.box(size=size), scenes.IDENTITY, filled(volume))], world=1.0, view=view, frame=Frame(8, 8)
    )


def in_grid(count: int, parts: tuple[tuple[int, int, float], ...]) -> tuple[Scene, float]:
    """A cube of 2 m with a grid of `count` voxels along each axis, and what comes through. `parts`: where a cube of
    voxels begins on the ray, how many it has along each axis, and its density [1/m].
    """
    values = np.zeros((count,) * 3, np.float32)
    step, middle, depth = 2.0 / count, count // 2, 0.0
    for first, length, density in parts:
        values[middle - length : middle + length, middle - length : middle + length, first : first + length] = density
        depth += length * step * density
    return _with_grid(Grid("density", values, _cube_indices(count))), math.exp(-depth)


def in_tiles(count: int, parts: tuple[tuple[int, int, float], ...], others: int) -> tuple[Scene, float]:
    """The same with a grid of tiles, `parts` being multiples of 8 voxels, and `others` beside the ray, at random."""
    middle, depth = count // 2, 0.0
    corners, values = [], []
    for first, length, density in parts:
        places = [(x, y, z) for x in (-8, 0) for y in (-8, 0) for z in range(first, first + length, 8)]
        corners += [(middle + x, middle + y, z) for x, y, z in places]
        values += [np.full((8, 8, 8), density, np.float32)] * len(places)
        depth += length * 2.0 / count * density
    random = np.random.default_rng(3)
    beside = np.unique(random.integers(0, count // 8, (others, 3)), axis=0) * 8
    beside = beside[np.abs(beside[:, :2] - middle).max(1) > 16]
    tiles = random.random((len(beside), 8, 8, 8), np.float32)
    corners = np.concatenate([np.array(corners), beside]).astype(np.int32)
    grid = Grid("density", np.concatenate([np.array(values), tiles]), _cube_indices(count), corners)
    return _with_grid(grid), math.exp(-depth)


def _cube_indices(count: int) -> np.ndarray:
    """Object space of a cube of 2 m to indices of `count` voxels along each axis."""
    return np.column_stack([np.eye(3) * count / 2, np.full(3, count / 2 - 0.5)])


def _with_grid(grid: Grid) -> Scene:
    """A cube of 2 m that absorbs what `grid` says."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("splat", builder.value("volume_attribute", 0, 0.0)[1]))
    scene = boxed(Volume(program=builder.finish()))
    mesh = replace(scene.meshes[0], grids=(grid,))
    return replace(scene, meshes=(mesh, *scene.meshes[1:]), attributes=(("GRID", "density"),))
