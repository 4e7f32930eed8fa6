"""Kernels over lists, called as functions for a list of one entry."""

import numpy as np
import warp as wp

from raybatch_addon.core.device.codegen.single import function_of
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS


@wp.kernel(**KERNEL_OPTIONS)
def square_listed(
    values: wp.array(dtype=float),
    slots: wp.array(dtype=int),
    count: wp.array(dtype=int),
    squares: wp.array(dtype=float),
):
    i = wp.tid()
    if i >= count[0]:
        return
    squares[slots[i]] = values[slots[i]] * values[slots[i]]


square_one = function_of(square_listed)


@wp.kernel(**KERNEL_OPTIONS)
def square_rows(
    values: wp.array(dtype=float),
    rows: wp.array2d(dtype=int),
    counts: wp.array2d(dtype=int),
    squares: wp.array(dtype=float),
):
    """Each thread has a list of its own, of an entry or none."""
    square_one(values, rows[wp.tid()], counts[wp.tid()], squares)


def test_the_function_does_what_the_kernel_does_for_an_entry(device):
    values = wp.array(np.arange(1, 9, dtype=np.float32), device=device)
    rows = np.array([[5], [0], [7], [2]], np.int32)

    def squares(kernel, threads, listed, counts):
        found = wp.zeros(8, dtype=float, device=device)
        lists = [wp.array(each, dtype=int, device=device) for each in (listed, counts)]
        wp.launch(kernel, threads, [values, *lists, found], device=device)
        return found.numpy()

    expected = np.zeros(8, np.float32)
    expected[[5, 0, 2]] = [36, 1, 9]
    # the third list is empty: its thread does nothing
    assert np.array_equal(squares(square_rows, 4, rows, np.array([[1], [1], [0], [1]], np.int32)), expected)
    # the kernel that it was made of still takes a whole list
    assert np.array_equal(squares(square_listed, 4, rows[[0, 1, 3, 2], 0], np.array([3], np.int32)), expected)
    assert function_of(square_listed) is square_one
