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
    to_index = np.column_stack([np.eye(3) / step, np.full(3, 1 / step - 0.5)])
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("splat", builder.value("volume_attribute", 0, 0.0)[1]))
    scene = boxed(Volume(program=builder.finish()))
    mesh = replace(scene.meshes[0], grids=(Grid("density", values, to_index),))
    scene = replace(scene, meshes=(mesh, *scene.meshes[1:]), attributes=(("GRID", "density"),))
    return scene, math.exp(-depth)
