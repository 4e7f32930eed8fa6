"""Packed triangles: the same bits again, in a third of the bytes."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.node import QUANTISED_TRIANGLE, Layout, triangle_faces
from raybatch_addon.core.bvh.pages.encode import HEADER_WORDS, PAGE_KERNELS, encode_triangles, expand_page
from raybatch_addon.core.bvh.pages.store import page_buffer
from tests.support import wide_trees
from tests.twins.page_decoder import decode_triangles


def packed(positions, triangles, offset=0) -> tuple[np.ndarray, np.ndarray]:
    """Words of the triangles in the order of a tree, whose faces are counted from `offset`, and the same packed."""
    mesh = wide_trees.wide(positions, triangles, Layout.QUANTISED)
    faces = triangle_faces(Layout.QUANTISED, mesh.triangles)
    corners = triangles[faces]
    faces += offset
    return mesh.triangles, encode_triangles(mesh.triangles, corners, positions)


def expanded(words: np.ndarray, count: int, device) -> np.ndarray:
    source = page_buffer(words.nbytes)
    source.numpy()[:] = words.view(np.uint8)
    target = wp.full(48 * count + 64, 77, dtype=wp.uint8, device=device)
    expand_page(source if device == "cpu" else source.to(device), target, 0, 0, count)
    out = target.numpy()
    assert (out[48 * count :] == 77).all()
    return out[: 48 * count]


MESHES = {
    "sphere": wide_trees.sphere(40),
    "soup": wide_trees.soup(1000),
    "one": wide_trees.soup(1),
    "63": wide_trees.soup(63),
    "64": wide_trees.soup(64),
    "129": wide_trees.soup(129),
}


@pytest.mark.parametrize("offset", [0, 2**31 - 100_000])
@pytest.mark.parametrize("name", MESHES)
def test_triangles_come_back_bit_for_bit(name, offset, device):
    words, data = packed(*MESHES[name], offset)
    assert np.array_equal(decode_triangles(data).view(np.uint32), words.view(np.uint32))
    assert np.array_equal(expanded(data, len(words), device), words.reshape(-1).view(np.uint8))


def test_faces_that_are_far_apart(device):
    words, data = packed(*wide_trees.sphere(20))
    faces = triangle_faces(Layout.QUANTISED, words)
    corners = wide_trees.sphere(20)[1][faces]
    for spread in (2**24 - 1, 2**24, 2**31 - 1):
        faces[:] = np.random.default_rng(1).integers(0, spread, len(faces), endpoint=True)
        faces[1:3] = 0, spread
        data = encode_triangles(words, corners, wide_trees.sphere(20)[0])
        assert data[2] == (spread >= 2**24)
        assert np.array_equal(decode_triangles(data).view(np.uint32), words.view(np.uint32))
        assert np.array_equal(expanded(data, len(words), device), words.reshape(-1).view(np.uint8))


def test_no_bit_is_lost_of_zeros_and_tiny_numbers(device):
    positions = np.float32([[0.0, -0.0, 1e-45], [-1e-45, 1e38, -1e38], [3e-39, -0.0, 0.0]])
    words = np.zeros((1, 12), np.float32)
    fields = words.view(QUANTISED_TRIANGLE)[:, 0]
    fields["a"], fields["b"], fields["c"], fields["face"] = *positions, 2**31 - 1
    data = encode_triangles(words, np.int32([[0, 1, 2]]), positions)
    assert np.array_equal(decode_triangles(data).view(np.uint32), words.view(np.uint32))
    assert np.array_equal(expanded(data, 1, device), words.reshape(-1).view(np.uint8))


def test_a_closed_mesh_takes_a_third_and_a_soup_no_more_than_before():
    words, data = packed(*wide_trees.sphere(100))
    assert data[1] == 7 and data.nbytes < 16 * len(words)
    words, data = packed(*wide_trees.soup(2000))
    assert data[1] == 6 and data.nbytes < 44 * len(words)


def test_nothing_is_packed_too():
    data = encode_triangles(np.zeros((0, 12), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32))
    assert len(data) == HEADER_WORDS and decode_triangles(data).shape == (0, 12)


def test_kernels_are_listed():
    assert len(PAGE_KERNELS) == 1
