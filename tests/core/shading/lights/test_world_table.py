"""Probabilities of a world's texels."""

import numpy as np

from raybatch_addon.core.shading.lights.world import build_world_table
from tests.support.under_test import DEVICE


def probabilities(light):
    """Probabilities of the texels of a row, given the row: [height, width]."""
    table = build_world_table(light.astype(np.float32), DEVICE)
    first = table.texel_first.numpy().reshape(light.shape).astype(np.float64)
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
