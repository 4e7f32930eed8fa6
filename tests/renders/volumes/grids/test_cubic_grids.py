"""Grids that programs read by splines, against its basis in NumPy."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Grid, Scene, Volume
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import color
from tests.stability.volume_scenes import boxed

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

COUNT = 8  # voxels along an edge of the cube of 2 m
SHIFT = 3.2  # of the grid beside the cube's, so that the ray goes between voxels [voxels]


def basis(x: np.ndarray) -> np.ndarray:
    """The uniform cubic B-spline."""
    far = np.abs(x)
    return np.where(far < 1, 2 / 3 - far**2 + far**3 / 2, np.clip(2 - far, 0, None) ** 3 / 6)


def numbers(width: int) -> np.ndarray:
    shape = (COUNT, COUNT, COUNT, *([3] if width == 3 else []))
    return freeze(np.random.default_rng(7).random(shape, np.float32) * 3)


def scene_of(values: np.ndarray, op: str) -> Scene:
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value(op, 0, 0.0)[0])
    scene = boxed(Volume(program=builder.finish()))
    to_index = np.column_stack([np.eye(3) * COUNT / 2, [SHIFT, SHIFT, COUNT / 2 - 0.5]])
    mesh = dataclasses.replace(scene.meshes[0], grids=(Grid("density", values, to_index),))
    return dataclasses.replace(scene, meshes=(mesh, *scene.meshes[1:]), attributes=(("GRID", "density"),))


def passed(values: np.ndarray) -> np.ndarray:
    """What comes through the middle of the cube along z, by channel."""
    z = np.linspace(-1, 1, 2001) * COUNT / 2 + COUNT / 2 - 0.5
    voxels = np.arange(COUNT)
    across = basis(SHIFT - voxels)
    along = basis(z[:, None] - voxels)
    density = np.einsum("x,y,tz,xyz...->t...", across, across, along, values.astype(float))
    depth = np.trapezoid(density, np.linspace(-1, 1, len(z)), axis=0)
    return np.exp(-np.broadcast_to(depth if depth.ndim else depth[None], 3))


@pytest.mark.parametrize("width", [1, 3])
def test_what_comes_through_is_that_of_the_spline(session, width):
    values, settings = numbers(width), RenderSettings(sample_count=2048, bounce_max=0)
    film = session.render(scene_of(values, "volume_attribute_cubic"), settings)
    found, expected = color(film), passed(values)
    error = found.std((0, 1)) / np.sqrt(found[..., 0].size)
    assert np.all(np.abs(found.mean((0, 1)) - expected) < 5 * error + 1e-4)
    linear = color(session.render(scene_of(values, "volume_attribute"), settings)).mean((0, 1))
    assert np.any(np.abs(linear - expected) > 10 * error)  # it is another function
    counts = film.statistics["volumes"]
    assert counts["collisions"] > 0 == counts["exceeded"]


def test_a_voxel_counts_two_voxels_far(session):
    """And its bounds are those of all that."""
    values = np.zeros((COUNT,) * 3, np.float32)
    values[4, 4, 4] = 200.0
    film = session.render(
        scene_of(freeze(values), "volume_attribute_cubic"), RenderSettings(sample_count=2048, bounce_max=0)
    )
    found = color(film)
    error = found.std((0, 1)) / np.sqrt(found[..., 0].size)
    assert np.all(np.abs(found.mean((0, 1)) - passed(values)) < 5 * error + 1e-4)
    assert film.statistics["volumes"]["density_missing"] < 1e-3
