"""Addresses that the host writes and a kernel reads, without a copy that would wait behind those of pages."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...native.structs import to_numpy


class AddressRing:
    """Addresses of pages on their way to the device: written by the host where a kernel reads them, several steps
    ahead.
    """

    def __init__(self, count: int, device: wp.Device, steps: int = 4):
        self._cuda = device.is_cuda
        self._turn = 0
        self._host = [
            wp.zeros(count, dtype=wp.uint64, device="cpu", pinned=self._cuda) for _ in range(steps if self._cuda else 1)
        ]
        # the device reads pinned memory at the same address
        self._device = self._host
        if self._cuda:
            self._device = [
                wp.array(ptr=each.ptr, dtype=wp.uint64, shape=each.shape, device=device) for each in self._host
            ]
        self._read: list[wp.Event | None] = [None] * len(self._host)

    def put(self, addresses: np.ndarray) -> wp.array:
        """`addresses` as the device sees them."""
        self._turn = (self._turn + 1) % len(self._host)
        if self._read[self._turn] is not None:
            wp.synchronize_event(self._read[self._turn])
        to_numpy(self._host[self._turn])[:] = addresses
        return self._device[self._turn]

    def was_read(self) -> None:
        """The kernel that reads what was put last is launched."""
        if self._cuda:
            self._read[self._turn] = self._device[self._turn].device.stream.record_event()
