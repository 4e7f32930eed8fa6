"""Bounds of the cells of a volume: how far what was found in an octant reaches, standing still and moving, and which
of them are of the extinction alone.
"""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Frame, Volume
from raybatch_addon.core.wavefront.volumes import upload
from raybatch_addon.core.wavefront.volumes.bounds import CELL_POINTS, CELLS_MOST, Bounded, find_bounds
from raybatch_addon.core.wavefront.volumes.kernels import launch_bound
from raybatch_addon.core.wavefront.volumes.table import EXTINCTION, FLIGHTS, VolumeData
from tests.renders.volumes.boundaries.test_boundaries import moved
from tests.renders.volumes.test_bounds import absorbing
from tests.renders.volumes.test_volumes import assert_mean, filled, in_box, medium, picture
from tests.support import scenes

MARGIN = 1.1  # of bounds above what was found


def bounds_of(found: np.ndarray) -> np.ndarray:
    """The bounds of a cube for what `found` says, [x, y, z, 2, 2, 2, 2]; shape [x, y, z, 2]."""

    def launch(volumes: VolumeData, _: int) -> None:
        volumes.asked.found.assign(found.reshape(-1, 2).astype(np.float32))

    cube = Bounded(-1, 0, np.array([[0.0] * 3, [float(CELLS_MOST)] * 3]), np.eye(3, 4))
    made = find_bounds(VolumeData(), [cube], launch, wp.get_device("cpu"))
    assert made is not None
    return made.bounds.numpy().reshape(CELLS_MOST, CELLS_MOST, CELLS_MOST, 2)


def test_what_is_in_an_octant_counts_half_a_cell_around():
    """Against all octants that touch a cell, one by one."""
    rng = np.random.default_rng(5)
    shape = (CELLS_MOST,) * 3 + (2, 2, 2, 2)
    found = np.where(rng.random(shape) < 0.02, rng.random(shape), 0.0)
    found[..., FLIGHTS] = np.maximum(found[..., FLIGHTS], found[..., EXTINCTION])
    found[:, :, :, :, :, 1] = found[:, :, :, :, :, 0]  # what is found in an octant the next one tells of
    fine = np.moveaxis(found, (3, 4, 5), (1, 3, 5)).reshape((2 * CELLS_MOST,) * 3 + (2,))
    bounds = bounds_of(found)
    for cell in rng.integers(0, CELLS_MOST, (200, 3)).tolist() + [[0, 0, 0], [CELLS_MOST - 1] * 3]:
        around = tuple(slice(max(2 * i - 1, 0), 2 * i + 3) for i in cell)
        expected = MARGIN * fine[around].reshape(-1, 2).max(0)
        np.testing.assert_allclose(bounds[tuple(cell)], expected, rtol=1e-6)


@pytest.mark.parametrize("share", [1e-3, 1e-4])
def test_clouds_of_small_parts_are_bounded_as_far_around_as_others_are_found(share):
    """Points that were not asked are hardly ever denser than the bounds; where nothing is, the bounds stay at 0."""
    rng, half = np.random.default_rng(3), CELLS_MOST // 2
    shape = (CELLS_MOST,) * 3 + (2, 2, 2)

    def drawn():
        found = np.where(rng.random(shape) < share, rng.uniform(0.5, 1.0, shape), 0.0)
        found[half:] = 0.0
        return found

    bounds = bounds_of(np.repeat(drawn()[..., None], 2, -1))[..., EXTINCTION]
    others = drawn()
    above = np.maximum(others - bounds[..., None, None, None], 0.0).sum() / others.sum()
    assert above < 0.01
    assert bounds[-1].max() == 0.0 or share < 1e-3


def test_one_small_part_is_not_bounded_elsewhere():
    found = np.zeros((CELLS_MOST,) * 3 + (2, 2, 2, 2))
    found[5, 6, 7, 0, 1, 0] = 3.0
    bounds = bounds_of(found)[..., EXTINCTION]
    assert bounds[5, 6, 7] == pytest.approx(MARGIN * 3.0) and np.count_nonzero(bounds) == 8


@pytest.mark.usefixtures("general_kernels")
@pytest.mark.parametrize("moves", [False, True])
def test_what_is_found_at_one_time_counts_in_the_whole_cell(session, monkeypatch, moves):
    """Each octant of what moves is asked at one time, when another part of the world may be there."""
    found = []

    def spy(features, volumes, count, device):
        launch_bound(features, volumes, count, device)
        found.append(volumes.asked.found.numpy().reshape(-1, CELL_POINTS, 2))

    monkeypatch.setattr(upload, "launch_bound", spy)
    scene = in_box(absorbing(lambda builder: builder.value("separate_xyz", builder.value("position", 0))[0]))
    if moves:
        scene = moved(scene, [(0, 0, 0), (0, 0, 0.5)])
    picture(session, scene)
    differ = (found[0] != found[0][:, :1]).any((1, 2))
    assert len(differ) == CELLS_MOST**3 and differ.any() == (not moves)


@pytest.mark.usefixtures("general_kernels")
def test_what_stays_in_the_world_while_its_volume_moves(session):
    """A layer of the world, thinner than half a cell, in a cube that stands still, goes on by one cell, and stands
    still again. The layer is always in the lower half of a cell: what is asked there is asked in the first half of
    the time, so that its second cell is known by its first alone.
    """
    sigma, cell = 1.5, 2.0 / CELLS_MOST

    def density(builder):
        x = builder.value("separate_xyz", builder.value("position", 0))[0]
        near = builder.value("math", int(MathOperation.COMPARE), False, x, 0.0, 0.2 * cell)
        return builder.value("math", int(MathOperation.MULTIPLY), False, near, sigma, 0.0)

    view = scenes.camera(eye=(0, -4, 0), target=(0, 0, 0), half_width=0.001)
    places = [-0.25 * cell] * (CELL_POINTS // 2) + [-1.25 * cell] * (CELL_POINTS // 2)
    scene = moved(in_box(absorbing(density), view), [(x, 0, 0) for x in places])
    # 2 m of the layer at all times
    assert_mean(session, scene, np.full(3, np.exp(-2 * sigma)), sample_count=256)


@pytest.mark.usefixtures("general_kernels")
def test_shadow_rays_ask_nothing_where_there_is_only_emission(session, monkeypatch):
    """A volume between a floor and the sun emits, and is dense for shadow rays, of which its bounds are not told: that
    shadow rays lose no light there shows that none of them has asked its program.
    """

    def emitting(density):
        builder = ProgramBuilder()
        is_shadow = builder.value("light_path")[1]
        for_shadows = builder.value("math", int(MathOperation.MULTIPLY), False, is_shadow, density, 0.0)
        builder.closure("volume_absorption", builder.value("splat", for_shadows))
        builder.closure("emission", (1e-3,) * 3)
        return Volume(program=builder.finish())

    def floor_below(density):
        floor = scenes.plane(size=4), scenes.translation(0, 0, -1.5), scenes.diffuse(0.8)
        boxed = scenes.box(), scenes.IDENTITY, filled(emitting(density))
        view = scenes.camera(eye=(0.03, -6, -1.4), target=(0.03, 0, -1.5), half_width=0.0001)
        made = scenes.scene([boxed, floor], world=0.0, frame=Frame(4, 4), view=view, lights=[scenes.sun(1.0)])
        return dataclasses.replace(made, lights=(*made.lights, *in_box(medium(1.0)).lights[1:]))

    once = dict(sample_count=4, bounce_max=0)
    clear, told = (picture(session, floor_below(density), **once) for density in (0.0, 2.0))
    monkeypatch.setattr(upload, "RAYS", 1)
    untold = picture(session, floor_below(3.0), **once)  # of another density, so that its bounds are found anew
    assert told.mean() < 0.5 * clear.mean()
    np.testing.assert_array_equal(untold, clear)
