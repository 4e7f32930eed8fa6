"""Probabilities of a world's texels."""

import numpy as np
import warp as wp

from raybatch_addon.core.shading.lights.world import WorldLight, build_world_table, sampled_world
from tests.support.under_test import DEVICE


def probabilities(light):
    """Probabilities of the texels of a row, given the row: [height, width]."""
    table = build_world_table(light.astype(np.float32), DEVICE)
    first = table.first.numpy()[light.shape[0] :].reshape(light.shape).astype(np.float64)
    return np.diff(first, axis=1, append=2.0**32) / 2.0**32


def test_texels_around_a_sun_are_not_forgotten():
    light = np.zeros((16, 32))
    light[5, 0] = 1.0
    chosen = probabilities(light)
    assert chosen[5, 0] > 0.85
    # its neighbours, also across the seam, get a twentieth of its share
    assert np.allclose(chosen[5, [1, 31]] / chosen[5, 0], 0.05, rtol=0.1)
    assert chosen[5, 2:31].max() < 1e-3 * chosen[5, 1]
    assert np.allclose(chosen[4, [0, 1, 31]], 1 / 3, rtol=0.01)


def test_an_even_world_is_sampled_evenly():
    assert np.allclose(probabilities(np.ones((8, 16))), 1 / 16)


def test_beside_rays_only_what_is_brighter_than_the_mean_is_aimed_at():
    """And only that competes with other emitters; all that light may come from keeps a probability."""
    light = np.full((16, 32), 2.0, np.float32)
    light[4, 6:8] = 50.0
    row = np.cos(np.arange(17) * np.pi / 16)
    mean = float((light.mean(1) * (row[:-1] - row[1:]) / 2).sum())
    excess = np.maximum(light - np.float32(mean), 0)
    found = sampled_world(WorldLight(light), wp.get_device(DEVICE), beside_rays=True)
    np.testing.assert_allclose(
        found.irradiance, sampled_world(WorldLight(excess), wp.get_device(DEVICE)).irradiance, rtol=1e-4, atol=1e-6
    )
    rows = np.diff(found.table.first.numpy()[:16].astype(np.float64), append=2.0**32)
    assert rows[4] > 0.8 * 2**32


def test_an_even_world_beside_rays_leaves_other_emitters_alone():
    found = sampled_world(WorldLight(np.full((8, 16), 3.0, np.float32)), wp.get_device(DEVICE), beside_rays=True)
    assert np.abs(found.irradiance).max() < 1e-5
