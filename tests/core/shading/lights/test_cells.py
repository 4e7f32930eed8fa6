"""Points in cells of volumes: their density, at any size and however a cell is sheared, and the cell of a point."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.devices import load_module
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.lights.cells.cells import cell_pdf, sample_cell
from raybatch_addon.core.shading.lights.emitters import EmissiveCells
from raybatch_addon.core.shading.lights.table import LightTable, upload_lights
from raybatch_addon.core.wavefront.volumes.emission.cells import find_cells
from raybatch_addon.core.wavefront.volumes.emission.weigh import cell_at
from raybatch_addon.core.wavefront.volumes.table import VolumeData
from tests.core.shading.lights.light_probe import COUNT, scene_of
from tests.renders.volumes.test_volumes import filled, medium
from tests.support import scenes, under_test

DEVICE = wp.get_device(under_test.DEVICE)

SHEAR = np.array([[0.5, 0.2, 0.0], [0.1, 0.4, -0.3], [0.0, 0.3, 0.6]])
TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
# nearly flat, along no axis
FLAT = SHEAR @ TURN @ np.diag([1.0, 1.0, 1e-6]) @ TURN.T
AWAY = np.array([0.7, -1.1, 2.0])


@wp.kernel(**KERNEL_OPTIONS)
def sample_kernel(table: LightTable, position: wp.vec3, ways: wp.array(dtype=wp.vec3), pdf: wp.array(dtype=wp.vec2)):
    i = wp.tid()
    r = wp.rand_init(7, i)
    s = sample_cell(table.lights[0], position, wp.randf(r), wp.vec2(wp.randf(r), wp.randf(r)))
    ways[i] = s.distance * s.direction
    pdf[i] = wp.vec2(s.pdf, cell_pdf(table.lights[0], ways[i]))


@wp.kernel(**KERNEL_OPTIONS)
def cell_kernel(volumes: VolumeData, points: wp.array(dtype=wp.vec3), found: wp.array(dtype=int)):
    i = wp.tid()
    found[i] = cell_at(volumes, 0, points[i])


def sampled(half: np.ndarray, middle: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of a cell, as ways from 0 [m], float64, shape [COUNT, 3], and their densities by both functions."""
    cells = EmissiveCells(middle[None], half[None], np.array([rate]), np.ones(1), np.zeros(1, np.int32))
    table = upload_lights(scene_of(), DEVICE, cells=cells).table
    ways = wp.zeros(COUNT, dtype=wp.vec3, device=DEVICE)
    pdf = wp.zeros(COUNT, dtype=wp.vec2, device=DEVICE)
    load_module(sample_kernel, DEVICE)
    wp.launch(sample_kernel, COUNT, [table, wp.vec3(0.0), ways, pdf], device=DEVICE)
    return ways.numpy().astype(np.float64), pdf.numpy().astype(np.float64)


@pytest.mark.parametrize("half", [SHEAR, FLAT], ids=["sheared", "flat"])
@pytest.mark.parametrize("size", [1e-16, 1e-15, 1.0, 2e14, 1e16])
def test_the_density_of_a_point_is_that_of_its_cell(size, half):
    """By solid angle it is the squared distance over rate and volume: in float64 the same."""
    half, middle, rate = size * half, size * AWAY, 3.0 / size
    ways, pdf = sampled(half, middle, rate)
    expected = (ways**2).sum(1) / (rate * 8 * abs(np.linalg.det(half)))
    np.testing.assert_allclose(pdf, np.stack([expected] * 2, 1), rtol=2e-6)
    at = np.linalg.solve(half.T, (ways - middle).T).T
    if np.linalg.cond(half) < 100:  # else the rounding of a point is wider than the cell
        assert np.abs(at).max() < 1 + 1e-5
        counts = np.histogramdd(at, [np.linspace(-1, 1, 5)] * 3)[0]
        mean = COUNT / counts.size
        assert ((counts - mean) ** 2).sum() / mean < counts.size + 5 * np.sqrt(2 * counts.size)


def test_densities_add_up_to_the_light_of_the_cell():
    """The mean of one over the density, at a rate of 1, is the integral of the inverse squared distance over the cell,
    by quadrature.
    """
    _, pdf = sampled(SHEAR, AWAY, 1.0)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    local = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), -1).reshape(-1, 3)
    weight = np.einsum("i,j,k", weights, weights, weights).ravel() * abs(np.linalg.det(SHEAR))
    expected = (weight / ((AWAY + local @ SHEAR) ** 2).sum(1)).sum()
    values = 1 / pdf[:, 0]
    assert abs(values.mean() - expected) < 5 * values.std() / np.sqrt(COUNT)
    assert values.std() / np.sqrt(COUNT) < 0.01 * expected


@pytest.mark.parametrize("far, size", [(0.0, 0.9), (1e4, 0.9), (1e6, 0.9), (0.0, 2e14), (0.0, 1e-15)])
def test_a_point_is_in_the_cell_that_is_found(far, size):
    """Also where coordinates are as coarse as a part of a cell: no rounding of a product takes it to another."""
    placing = scenes.translation(far, -0.7 * far, 0.3 * far)
    placing[:, :3] = TURN
    scene = scenes.scene([(scenes.box("box", size), placing, filled(medium(emission=1.0)))])
    volumes = VolumeData()
    volumes.volume_count, volumes.world = 1, -1
    found = find_cells(volumes, scene, np.zeros(1, np.int32), lambda asked, count: None, DEVICE)
    assert found is not None and len(found.cells) == 16**3
    volumes.lights = found.upload(0, DEVICE)
    local = np.random.default_rng(3).uniform(-size / 2, size / 2, (1 << 14, 3))
    points = (local @ TURN.T.astype(np.float32) + placing[:, 3]).astype(np.float32)
    cells = wp.zeros(len(points), dtype=int, device=DEVICE)
    load_module(cell_kernel, DEVICE)
    asked = [volumes, wp.array(points, dtype=wp.vec3, device=DEVICE), cells]
    wp.launch(cell_kernel, len(points), asked, device=DEVICE)
    half = found.cells.half[0]
    at = np.linalg.solve(2 * half.T, (points - found.cells.middle[0]).T).T + 0.5
    # those beyond the faces, to the rounding of a coordinate, are in the outermost cells
    clear = (np.abs(at - np.round(at)) > 1e-4).all(1)
    expected = np.clip(np.floor(at), 0, 15).astype(int) @ (256, 16, 1)
    assert clear.mean() > 0.9
    assert np.array_equal(cells.numpy()[clear], expected[clear])
