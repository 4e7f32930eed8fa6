"""Exclusive sums on any device, in two launches of kernels that allocate nothing, so that they may stand in the body of
a captured loop. `wp.utils.array_scan`, which takes scratch memory in each call, may not; path lists use it, because
their launches are not captured.
"""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches

SEGMENTS_MAX = 1024
# Entries of a segment at least
_SEGMENT = 32


@wp.kernel(**KERNEL_OPTIONS)
def segment_sum_kernel(values: wp.array(dtype=int), length: int, sums: wp.array(dtype=int)):
    """`sums` of consecutive segments of `length` entries."""
    segment = wp.tid()
    total = int(0)
    for i in range(segment * length, wp.min((segment + 1) * length, values.shape[0])):
        total += values[i]
    sums[segment] = total


@wp.kernel(**KERNEL_OPTIONS)
def segment_scan_kernel(
    values: wp.array(dtype=int), length: int, sums: wp.array(dtype=int), result: wp.array(dtype=int)
):
    """`result` is the sum of all `values` before an entry; its last entry, behind those, is the sum of all."""
    segment = wp.tid()
    total = int(0)
    for i in range(segment):
        total += sums[i]
    for i in range(segment * length, wp.min((segment + 1) * length, values.shape[0])):
        result[i] = total
        total += values[i]
    if (segment + 1) * length >= values.shape[0] and segment * length < values.shape[0]:
        result[values.shape[0]] = total


class Scan:
    """Sums arrays of int32; holds the scratch."""

    kernels = (segment_sum_kernel, segment_scan_kernel)

    def __init__(self, device: wp.Device):
        self._device = device
        self._launches = RepeatedLaunches(device)
        self._sums = wp.zeros(SEGMENTS_MAX, dtype=int, device=device)

    def launch(self, values: wp.array, result: wp.array) -> None:
        """Exclusive sums of all `values`, at least one, and their total behind; `result` has one entry more."""
        segments = max(1, min(SEGMENTS_MAX if self._device.is_cuda else 64, values.size // _SEGMENT))
        length = -(-values.size // segments)
        self._launches.launch(segment_sum_kernel, segments, values, length, self._sums)
        self._launches.launch(segment_scan_kernel, segments, values, length, self._sums, result)
