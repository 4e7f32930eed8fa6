"""Chunks of a mesh: every triangle in one, none too large, near each other, the same for any number of threads."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.pages.divide import listed
from raybatch_addon.core.bvh.pages.divide.cells import mesh_from, mesh_triangles
from raybatch_addon.core.bvh.pages.divide.listed import triangles_on
from raybatch_addon.core.bvh.pages.divide.partition import partition_triangles
from tests.support import wide_trees


def divided(positions, triangles, size_max, numbers=None, **more) -> list[np.ndarray]:
    """The chunks that the CPU makes."""
    cpu = wp.get_device("cpu")
    there = triangles_on(cpu, mesh_triangles(positions, triangles, cpu), len(triangles), **more)
    return partition_triangles(there, size_max, numbers)


def check(positions, triangles, size_max) -> list[np.ndarray]:
    chunks = divided(positions, triangles, size_max)
    assert all(
        0 < len(chunk) <= size_max and chunk.dtype == np.int32 and (np.diff(chunk) > 0).all() for chunk in chunks
    )
    assert np.array_equal(np.sort(np.concatenate(chunks)), np.arange(len(triangles)))
    return chunks


def area(positions: np.ndarray, triangles: np.ndarray) -> float:
    corners = positions[triangles].reshape(-1, 3).astype(np.float64)
    x, y, z = corners.max(0) - corners.min(0)
    return x * y + y * z + z * x


def grid(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of cells^2 * 2 equal triangles."""
    x, y = np.meshgrid(np.arange(cells + 1), np.arange(cells + 1), indexing="ij")
    positions = np.stack([x, y, 0 * x], -1).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = (i * (cells + 1) + j).ravel()
    return positions, np.concatenate(
        [np.stack([a, a + cells + 1, a + 1], 1), np.stack([a + 1, a + cells + 1, a + cells + 2], 1)]
    ).astype(np.int32)


@pytest.mark.parametrize(
    "make",
    [lambda: wide_trees.sphere(30), lambda: wide_trees.soup(3000), lambda: wide_trees.needles(2000), lambda: grid(40)],
)
@pytest.mark.parametrize("size_max", [1, 7, 100, 1500, 10_000])
def test_chunks_are_a_partition(make, size_max):
    positions, triangles = make()
    chunks = check(positions, triangles, size_max)
    assert len(chunks) <= 4 * -(-len(triangles) // size_max) + 4 or size_max < 10


def test_chunks_of_a_uniform_grid_hardly_overlap_and_are_well_filled():
    positions, triangles = grid(128)
    chunks = check(positions, triangles, 1024)
    assert sum(area(positions, triangles[chunk]) for chunk in chunks) < 1.1 * area(positions, triangles)
    assert len(triangles) / len(chunks) > 0.6 * 1024


def test_what_is_crowded_is_divided_by_a_finer_grid():
    """Half of all triangles in a millionth of the volume."""
    positions, triangles = grid(60)
    small = positions * np.float32(1e-4)
    both = np.concatenate([positions, small])
    chunks = check(both, np.concatenate([triangles, triangles + len(positions)]), 500)
    inside = [chunk for chunk in chunks if (chunk >= len(triangles)).all()]
    assert sum(map(len, inside)) > 0.9 * len(triangles)
    edges = [
        np.ptp(both[np.concatenate([triangles, triangles + len(positions)])[chunk]].reshape(-1, 3), axis=0).max()
        for chunk in inside
    ]
    assert np.mean(edges) < 3e-3


def test_long_triangles_lie_apart():
    positions, triangles = grid(100)
    long = np.float32([[0, 0, 0.5], [100, 0, 0.5], [0, 100, 0.5], [100, 100, 0.5]])
    both = np.concatenate([triangles, np.int32([[0, 1, 2], [1, 2, 3]]) + len(positions)])
    chunks = check(np.concatenate([positions, long]), both, 1000)
    assert any(np.array_equal(chunk, [len(triangles), len(triangles) + 1]) for chunk in chunks)


def test_all_but_the_long_triangles_may_lie_in_one_cell():
    """A small thing in a large room: its walls set the grid, and lie apart."""
    positions, triangles = wide_trees.soup(3000)
    small = (positions - positions.min(0)) / np.ptp(positions, axis=0) * 0.1 + 0.1
    low, high = (
        np.float32([[-50, -50, -50], [50, -50, -50], [50, 50, -50]]),
        np.float32([[-50, -50, 50], [50, -50, 50], [50, 50, 50]]),
    )
    walls = np.concatenate([np.roll(wall, k, 1) for k in range(3) for wall in (low, high)])
    both = np.concatenate([triangles, len(positions) + np.arange(18, dtype=np.int32).reshape(-1, 3)])
    chunks = check(np.concatenate([small, walls]).astype(np.float32), both, 500)
    assert any(np.array_equal(chunk, len(triangles) + np.arange(6)) for chunk in chunks)


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e-18, 1e17])
def test_triangles_that_cannot_be_distinguished_are_divided_all_the_same(scale):
    positions, triangles = wide_trees.soup(500)
    check((positions * np.float32(scale)).astype(np.float32), triangles, 60)
    check(np.float32([[0, 0, 0], [scale, 0, 0], [0, scale, 0]]), np.zeros((500, 3), np.int32) + np.int32([0, 1, 2]), 60)
    check((positions * np.float32([scale, 0, 1])).astype(np.float32), triangles, 60)


def test_threads_and_slices_make_no_difference(monkeypatch):
    positions, triangles = wide_trees.soup(5000)
    alone = divided(positions, triangles, 300, thread_count=1)
    monkeypatch.setattr(listed, "_SLICE", 128)
    several = divided(positions, triangles, 300, thread_count=5)
    assert len(alone) == len(several) and all(np.array_equal(a, b) for a, b in zip(alone, several))
    assert divided(positions, triangles[:0], 300) == []


@pytest.mark.parametrize(
    "make", [lambda: wide_trees.sphere(30), lambda: wide_trees.soup(3000), lambda: wide_trees.needles(2000)]
)
@pytest.mark.parametrize("slice_size", [1 << 23, 500])
@pytest.mark.parametrize("with_corners", [False, True])
def test_a_gpu_divides_as_the_cpu_does(make, slice_size, with_corners, device, monkeypatch):
    """The same chunks to the last triangle, from indices or corners, whole or in slices, of all or of some."""
    positions, triangles = make()
    monkeypatch.setattr(listed, "_SLICE_CUDA", slice_size)
    device = wp.get_device(device)
    corners = wp.array(positions[triangles.ravel()], dtype=wp.vec3, device=device) if with_corners else None
    there = listed.CudaTriangles(
        device, mesh_triangles(positions, triangles, device, corners), len(triangles), lambda: False
    )
    some = np.flatnonzero(np.random.default_rng(1).random(len(triangles)) < 0.7).astype(np.int32)
    for numbers in (None, some):
        expected = divided(positions, triangles, 100, numbers)
        found = partition_triangles(there, 100, numbers)
        assert len(expected) == len(found) and all(np.array_equal(a, b) for a, b in zip(expected, found))


def test_triangles_of_a_mesh_behind_others():
    positions, triangles = wide_trees.soup(2000)
    cpu = wp.get_device("cpu")
    every = mesh_triangles(positions, triangles, cpu)
    found = partition_triangles(triangles_on(cpu, mesh_from(every, 700), 1300), 100)
    expected = divided(positions, triangles[700:].copy(), 100)
    assert len(expected) == len(found) > 13 and all(np.array_equal(a, b) for a, b in zip(expected, found))
