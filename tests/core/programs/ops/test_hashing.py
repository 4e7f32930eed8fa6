"""Hashes against the published algorithms."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.ops.textures import hashing
from tests.support.under_test import DEVICE
from tests.twins.hash_reference import jenkins, pcg

VALUES = [0.0, -0.0, 1.0, -1.0, 0.5, 3.25, -7.75, 1e7, -1e7, 1e30, float("inf"), float("-inf")]
CELLS = [0, 1, -1, 2, -3, 7, 10**7, -(10**7), 2**31 - 1, -(2**31)]


@wp.kernel(**KERNEL_OPTIONS)
def hash_numbers(points: wp.array(dtype=wp.vec4), out: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    p = points[i]
    out[i] = wp.vec4(
        hashing.hash_1_to_1(p[0]),
        hashing.hash_2_to_1(p[0], p[1]),
        hashing.hash_3_to_1(p[0], p[1], p[2]),
        hashing.hash_4_to_1(p[0], p[1], p[2], p[3]),
    )


@wp.kernel(**KERNEL_OPTIONS)
def hash_cells(cells: wp.array(dtype=wp.vec4i), out: wp.array2d(dtype=float)):
    i = wp.tid()
    c = cells[i]
    two = hashing.cell_to_vec2(c[0], c[1])
    three = hashing.cell_to_vec3(c[0], c[1], c[2])
    four = hashing.cell_to_vec4(c[0], c[1], c[2], c[3])
    for k in range(2):
        out[i, k] = two[k]
    for k in range(3):
        out[i, 2 + k] = three[k]
    for k in range(4):
        out[i, 5 + k] = four[k]


def test_hashes_of_numbers_are_lookup3_over_their_bits():
    rng = np.random.default_rng(1)
    points = np.array([rng.choice(VALUES, 4) for _ in range(200)], dtype=np.float32)
    out = wp.zeros(len(points), dtype=wp.vec4, device=DEVICE)
    wp.launch(hash_numbers, len(points), [wp.array(points, dtype=wp.vec4, device=DEVICE), out], device=DEVICE)
    for point, found in zip(points, out.numpy(), strict=True):
        words = [int(word) for word in point.view(np.uint32)]
        for count in range(1, 5):
            assert found[count - 1] == np.float32(jenkins(words[:count])) * np.float32(2.0**-32)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_hashes_of_cells_are_pcg_over_signed_words(count):
    rng = np.random.default_rng(2)
    cells = np.array([rng.choice(CELLS, 4) for _ in range(200)], dtype=np.int32)
    out = wp.zeros((len(cells), 9), dtype=float, device=DEVICE)
    wp.launch(hash_cells, len(cells), [wp.array(cells, dtype=wp.vec4i, device=DEVICE), out], device=DEVICE)
    first = {2: 0, 3: 2, 4: 5}[count]
    for cell, found in zip(cells, out.numpy(), strict=True):
        assert np.allclose(found[first : first + count], pcg(cell[:count]), rtol=0, atol=1e-7)
