"""Sorted lists hold the same slots, in the order of keys that a NumPy twin computes."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.rays import RayList, Rays
from raybatch_addon.core.wavefront.order.ray_sort import RaySorter, sort_bytes_per_ray, sort_kernel
from tests.support.under_test import DEVICE

F = np.float32
LOW, HIGH = (-1.0, -2.0, 0.5), (3.0, 2.0, 1.5)


def rays_of(origins, directions) -> Rays:
    rays = Rays()
    rays.origin = wp.array(np.asarray(origins, F), dtype=wp.vec3, device=DEVICE)
    rays.direction = wp.array(np.asarray(directions, F), dtype=wp.vec3, device=DEVICE)
    return rays


def list_of(slots, count=None) -> RayList:
    slots = np.asarray(slots, np.int32)
    count = len(slots) if count is None else count
    return RayList(wp.array(slots, device=DEVICE), wp.array([count], dtype=int, device=DEVICE), len(slots))


def cells_of(values, cells):
    with np.errstate(invalid="ignore", over="ignore"):
        return np.nan_to_num(np.clip(F(cells) * values.astype(F), F(0), F(cells - 1)), nan=0.0).astype(np.uint32)


def interleaved(columns, bits):
    key = np.zeros(len(columns[0]), np.uint32)
    for bit in range(bits):
        for axis, column in enumerate(columns):
            key |= ((column >> np.uint32(bit)) & np.uint32(1)) << np.uint32(len(columns) * bit + axis)
    return key


def twin_keys(origins, directions, low, high):
    """The keys by NumPy in float32, uint32 [n]."""
    o, d = np.asarray(origins, F), np.asarray(directions, F)
    extent = np.asarray(high, np.float64) - np.asarray(low, np.float64)
    scale = np.divide(1.0, extent, out=np.zeros(3), where=extent > 1e-30).astype(F)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        p = (o - np.asarray(low, F)) * scale
    code = interleaved([cells_of(p[:, axis], 512) for axis in range(3)], 9)
    octant = ((d < 0) * np.array([1, 2, 4])).sum(1).astype(np.uint32)
    return octant << np.uint32(27) | code


def random_rays(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(LOW, HIGH, (n, 3)), rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-20, 20, (n, 1))


def check(origins, directions, slots, low=LOW, high=HIGH, count=None):
    rays, listed = rays_of(origins, directions), list_of(slots, count)
    count = len(slots) if count is None else count
    result = RaySorter(len(slots), wp.get_device(DEVICE), low, high).sort(rays, listed)
    assert result.count is listed.count and result.bound == listed.bound
    assert np.array_equal(listed.slots.numpy(), slots), "the list that was given is as it was"
    keys = twin_keys(np.asarray(origins)[slots[:count]], np.asarray(directions)[slots[:count]], low, high)
    assert np.array_equal(result.slots.numpy()[:count], np.asarray(slots)[:count][np.argsort(keys, kind="stable")])


@pytest.mark.parametrize("n", [1, 2, 5000])
def test_slots_are_in_the_order_of_the_keys(n):
    slots = np.random.default_rng(1).permutation(2 * n)[:n]
    check(*random_rays(2 * n, n), slots)


@pytest.mark.parametrize("count", [0, 1, 700])
def test_only_the_rays_of_the_list_are_sorted(count):
    check(*random_rays(1000, 3), np.arange(1000)[::-1], count=count)


@pytest.mark.parametrize(
    "high",
    [(3.0, 2.0, 0.5), (-1.0, -2.0, 1.5), LOW, (-1.0 + 1e-40, -2.0, 0.5), (3e38, 3e38, 3e38)],
    ids=["flat", "line", "point", "tiny", "vast"],
)
def test_boxes_without_extent(high):
    check(*random_rays(500, 5), np.arange(500), high=high)


def test_odd_rays_have_a_place():
    special = [0.0, -0.0, 1.0, -1.0, 1e-38, -1e38, np.inf, -np.inf, np.nan]
    grid = np.stack(np.meshgrid(special, special, special), -1).reshape(-1, 3)
    check(grid, np.roll(grid, 100, axis=0), np.arange(len(grid)))


def test_equal_rays_keep_their_order():
    check(np.zeros((100, 3)), np.ones((100, 3)), np.random.default_rng(6).permutation(100))


def test_a_sorter_is_used_again_for_lists_of_other_lengths():
    origins, directions = random_rays(900, 7)
    rays, sorter = rays_of(origins, directions), RaySorter(900, wp.get_device(DEVICE), LOW, HIGH)
    for n in (900, 10, 500):
        result = sorter.sort(rays, list_of(np.arange(n)))
        keys = twin_keys(origins[:n], directions[:n], LOW, HIGH)
        assert np.array_equal(result.slots.numpy()[:n], np.argsort(keys, kind="stable"))


def test_one_kernel_serves_all_sorters():
    device = wp.get_device(DEVICE)
    assert sort_kernel(device) is sort_kernel(device)
    assert sort_bytes_per_ray(device.is_cuda) in (16, 20)
