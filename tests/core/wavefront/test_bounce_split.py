"""Lists by bounce hold every ray once, in order; the kernels of either device are compared with NumPy."""

import numpy as np
import pytest
import warp as wp
from under_test import DEVICE

from raybatch_addon.core.wavefront.bounce_split import SPLIT_CLASSES, BounceSplit, SplitLists, split_flag_kernel, split_scatter_kernel
from raybatch_addon.core.wavefront.tracer import NO_SLOTS, SlotList

PATHS = 500


def case(count, bound, shadow):
    rng = np.random.default_rng(count)
    bounce = rng.integers(0, 6, PATHS).astype(np.int32)
    slots = (rng.permutation(PATHS)[:bound] + PATHS * shadow).astype(np.int32)
    group = np.clip(bounce[slots[:count] % PATHS], 1, 3)
    return bounce, slots, [slots[:count][group == k] for k in (1, 2, 3)]


@pytest.mark.parametrize("shadow", [False, True])
@pytest.mark.parametrize("count, bound", [(0, 1), (1, 1), (0, 300), (200, 300), (300, 300)])
def test_every_ray_is_in_its_list(count, bound, shadow):
    bounce, slots, expected = case(count, bound, shadow)
    counts = wp.full(7, 99, dtype=int, device=DEVICE)
    split = BounceSplit(PATHS, counts, 2)
    listed = SlotList(wp.array(slots, device=DEVICE), wp.array([count], dtype=int, device=DEVICE), bound)
    for _ in range(2):
        lists = split.split(listed, wp.array(bounce, device=DEVICE))
    assert len(lists) == len(SPLIT_CLASSES)
    assert counts.numpy().tolist() == [99, 99, *map(len, expected), 99, 99]
    for found, wanted in zip(lists, expected):
        assert found.bound == bound and found.count.numpy()[0] == len(wanted)
        assert np.array_equal(found.slots.numpy()[: len(wanted)], wanted)


def test_nothing_is_split_into_nothing():
    split = BounceSplit(PATHS, wp.zeros(3, dtype=int, device=DEVICE), 0)
    assert all(each.bound == 0 for each in split.split(NO_SLOTS, wp.zeros(PATHS, dtype=int, device=DEVICE)))


@pytest.mark.parametrize("count, bound", [(0, 300), (200, 300), (300, 300)])
def test_the_kernels_of_the_gpu_do_the_same(count, bound):
    bounce, slots, expected = case(count, bound, False)
    lists = SplitLists()
    lists.slots, lists.counts, lists.place = wp.zeros((3, PATHS), dtype=int, device=DEVICE), wp.zeros(3, dtype=int, device=DEVICE), 0
    flags, offsets = (wp.zeros(bound, dtype=wp.int64, device=DEVICE) for _ in range(2))
    inputs = [wp.array(bounce, device=DEVICE), wp.array(slots, device=DEVICE), wp.array([count], dtype=int, device=DEVICE), flags]
    wp.launch(split_flag_kernel, bound, inputs, device=DEVICE)
    wp.utils.array_scan(flags, offsets, inclusive=False)
    wp.launch(split_scatter_kernel, bound, [*inputs, offsets, lists], device=DEVICE)
    assert lists.counts.numpy().tolist() == list(map(len, expected))
    for k, wanted in enumerate(expected):
        assert np.array_equal(lists.slots.numpy()[k, : len(wanted)], wanted)
