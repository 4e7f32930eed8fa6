"""Large arrays of the host by threads: the same as without, whatever the slices."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device import bulk
from raybatch_addon.core.device.bulk import (
    add_rows,
    column_bounds,
    copy_rows,
    digest_of,
    in_slices,
    kinds_of,
    take_rows,
)
from raybatch_addon.core.device.locked import OWN_PAGES_LEAST, locked_empty, locked_view, shape_of
from tests.support.under_test import DEVICE


@pytest.mark.parametrize("rows", [1, 7, 10_000])
@pytest.mark.parametrize("count", [0, 1, 100, 1001])
def test_rows_are_those_of_numpy(count, rows, monkeypatch):
    monkeypatch.setattr(bulk, "_SLICE_ROWS", rows)
    rng = np.random.default_rng(count)
    source, indices = rng.random((50, 3), np.float32), rng.integers(0, 50, count)
    out = np.empty((count, 3), np.float32)
    take_rows(source, indices, out)
    assert np.array_equal(out, source[indices])
    numbers, sums = rng.integers(0, 100, (count, 3), np.int32), np.empty((count, 3), np.int32)
    add_rows(numbers, 2**31 - 200, sums)
    assert np.array_equal(sums, numbers + np.int32(2**31 - 200))
    copy_rows(numbers.astype(np.int64), sums)
    assert np.array_equal(sums, numbers)


def test_what_a_slice_raises_is_raised():
    def work(part: slice) -> None:
        if part.start == 30:
            raise KeyError("here")

    with pytest.raises(KeyError, match="here"):
        in_slices(100, work, 10)


def test_digests_are_of_contents(monkeypatch):
    a, b = np.arange(1000, dtype=np.int32), np.arange(1000, dtype=np.float32)
    digests = {
        digest_of(*each)
        for each in (
            [[a], "x"],
            [[b], "x"],
            [[a], "y"],
            [[a[::2]], "x"],
            [[a[:500], a[500:]], "x"],
            [[a.reshape(10, 100)], "x"],
        )
    }
    assert len(digests) == 6 and digest_of([a.copy()], "x") in digests
    monkeypatch.setattr(bulk, "_SLICE_BYTES", 100)
    changed = a.copy()
    changed[700] += 1
    assert digest_of([a], "x") != digest_of([changed], "x")
    assert digest_of([a], "x") == digest_of([a.copy()], "x")


@pytest.mark.parametrize("count", [1, 63, 64, 65, 130, 5001])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_bounds_of_columns_are_those_of_numpy(count, shape, monkeypatch):
    monkeypatch.setattr(bulk, "_SLICE_ROWS", 1000)
    rows = np.random.default_rng(count).normal(size=(count, *shape)).astype(np.float32)
    for each in (rows, (1000 * rows).astype(np.int32), rows[::-1]):
        low, high = column_bounds(each)
        assert np.array_equal(low, each.min(0)) and np.array_equal(high, each.max(0))
    rows[count // 2] = np.nan
    assert all(np.isnan(each).all() for each in column_bounds(rows))


@pytest.mark.skipif(DEVICE == "cpu", reason="memory is locked for a CUDA device")
@pytest.mark.parametrize("size", [1, 100_000, 30_000_001])
def test_locked_memory_is_read_and_written_by_the_device(size):
    device = wp.get_device(DEVICE)
    values = np.random.default_rng(0).integers(0, 256, size, np.uint8)
    memory = locked_empty(size, wp.uint8)
    assert memory.ptr % 4096 == 0 and memory.pinned and memory.device.is_cpu
    memory.numpy()[:] = values
    there = memory.to(device)
    wp.synchronize_device(device)  # the copy reads the memory meanwhile
    memory.zero_()
    wp.copy(memory, there)
    wp.synchronize_device(device)
    assert np.array_equal(memory.numpy(), values)


def test_what_is_locked_has_the_shape_of_its_elements():
    assert shape_of(np.zeros((5, 3), np.float32), wp.vec3) == (5,)
    assert shape_of(np.zeros((5, 3), np.int32), wp.vec3i) == (5,)
    assert shape_of(np.zeros((5, 7), np.uint8), wp.uint8) == (5, 7), "rows of a picture"


@pytest.mark.skipif(DEVICE == "cpu", reason="memory is locked for a CUDA device")
def test_arrays_of_the_host_are_read_by_the_device_where_they_lie():
    device = wp.get_device(DEVICE)
    assert locked_view(np.zeros((1000, 3), np.float32), wp.vec3, device) is None, "it shares pages with others"
    values = np.random.default_rng(0).random((OWN_PAGES_LEAST // 12 + 1, 3), np.float32)
    for _ in range(2):  # the first lock was given back
        there = locked_view(values, wp.vec3, device)
        assert there.shape == (len(values),), "as fields of structs take it"
        copied = wp.empty_like(there)
        wp.copy(copied, there)
        assert np.array_equal(copied.numpy(), values)
        second = locked_view(values, wp.vec3, device)  # as for another device
        del there
        copied.zero_()
        wp.copy(copied, second)
        assert np.array_equal(copied.numpy(), values)
        del second


@pytest.mark.parametrize("seed", range(5))
def test_kinds_come_in_the_order_in_which_they_are_met(seed):
    rng = np.random.default_rng(seed)
    numbers = rng.integers(-5, rng.integers(-4, 30), int(rng.integers(0, 60)))
    rows: dict[int, int] = {}
    expected = [rows.setdefault(each, len(rows)) for each in numbers.tolist()]
    first, kind = kinds_of(numbers)
    assert kind.tolist() == expected and kind.dtype == np.int32
    assert numbers[first].tolist() == list(rows)
