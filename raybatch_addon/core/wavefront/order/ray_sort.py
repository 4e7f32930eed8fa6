"""Sorts a list of rays by where they start and where they point, so that neighbours in the list visit the same nodes.

A ray's key packs the octant of its direction and the Morton code of its origin within the scene's box (Morton 1966; the
use for rays: Garanzha and Loop 2010; a comparison of keys: Meister et al. 2020). The rays stay where they are; their
slots are sorted. The sort is a stable radix sort, so rays of equal keys keep their order: Warp's own (CUB) on CUDA, and
on the CPU one of three digits, because Warp's is three times slower there. Sorting never changes a film: a ray's hit
does not depend on its position in a list.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...native.build import native_source
from ...rays import RayList, Rays

KEY_BITS = 30
"""Three of the octant, and nine of the cell along each axis."""
_DIGIT_BITS = KEY_BITS // 3


@wp.struct
class SortBox:
    """The box whose cells distinguish origins."""

    low: wp.vec3  # [m]
    scale: wp.vec3  # 1 / extent, and 0 along an axis without extent [1/m]


@functools.cache
def key_kernel() -> wp.Kernel:
    """Kernel (rays, box, slots, count, keys, values) for CUDA: keys of the first `count[0]` of `slots`, and the largest
    key for the others, so that they stay behind; `values` is a copy of `slots`."""

    @wp.func_native(native_source("sort/key.h", "sort/slot_key.h", KEY_BITS=KEY_BITS))
    def ray_key(
        rays_origin: wp.array(dtype=wp.vec3),
        rays_direction: wp.array(dtype=wp.vec3),
        low: wp.vec3,
        scale: wp.vec3,
        slot: int,
    ) -> wp.uint32: ...

    @wp.kernel(**KERNEL_OPTIONS)
    def sort_keys(
        rays: Rays,
        box: SortBox,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        keys: wp.array(dtype=wp.uint32),
        values: wp.array(dtype=int),
    ):
        i = wp.tid()
        slot = slots[i]
        key = wp.uint32(0xFFFFFFFF)
        if i < count[0]:
            key = ray_key(rays.origin, rays.direction, box.low, box.scale, slot)
        keys[i] = key
        values[i] = slot

    return sort_keys


@functools.cache
def host_sort_kernel() -> wp.Kernel:
    """Kernel (rays, box, slots, count, entries, result) for the CPU, launched once for a whole list: `result` holds the
    first `count[0]` of `slots`, sorted. `entries` is scratch of two entries a ray."""

    @wp.func_native(
        native_source("sort/key.h", "sort/host_sort.h", device="cpu", KEY_BITS=KEY_BITS, DIGIT_BITS=_DIGIT_BITS)
    )
    def sort(
        rays_origin: wp.array(dtype=wp.vec3),
        rays_direction: wp.array(dtype=wp.vec3),
        low: wp.vec3,
        scale: wp.vec3,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
        result: wp.array(dtype=int),
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def sort_on_host(
        rays: Rays,
        box: SortBox,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
        result: wp.array(dtype=int),
    ):
        sort(rays.origin, rays.direction, box.low, box.scale, slots, count, entries, result)

    return sort_on_host


def sort_kernel(device: wp.Device) -> wp.Kernel:
    """The kernel that a `RaySorter` launches on `device`."""
    return key_kernel() if device.is_cuda else host_sort_kernel()


def sort_bytes_per_ray(is_cuda: bool) -> int:
    """Scratch of a `RaySorter` for each ray of its capacity [bytes]."""
    return 2 * 4 + 2 * 4 if is_cuda else 2 * 8 + 4


class RaySorter:
    """Sorts lists of ray slots; holds the scratch of one worker."""

    def __init__(
        self, capacity: int, device: wp.Device, low: tuple[float, float, float], high: tuple[float, float, float]
    ):
        """Scratch for lists of at most `capacity` rays in the box `low` to `high` [m]."""
        self._device, self._capacity = device, capacity
        self._kernel = sort_kernel(device)
        extent = np.asarray(high, np.float64) - np.asarray(low, np.float64)
        scale = np.divide(1.0, extent, out=np.zeros(3), where=extent > 1e-30)
        self._box = SortBox()
        self._box.low, self._box.scale = wp.vec3(*map(float, low)), wp.vec3(*scale.tolist())
        if device.is_cuda:
            self._keys = wp.empty(2 * capacity, dtype=wp.uint32, device=device)
            self._sorted = wp.empty(2 * capacity, dtype=int, device=device)
        else:
            self._keys = wp.empty(2 * capacity, dtype=wp.uint64, device=device)
            self._sorted = wp.empty(capacity, dtype=int, device=device)

    def parts(self, listed: RayList) -> list[RayList]:
        """`listed`, whose length is exactly `bound`, in parts that are short enough to be sorted."""
        if listed.bound <= self._capacity:
            return [listed]
        parts = []
        for first in range(0, listed.bound, self._capacity):
            length = min(self._capacity, listed.bound - first)
            count = wp.full(1, length, dtype=int, device=self._device)
            parts.append(
                dataclasses.replace(listed, slots=listed.slots[first : first + length], count=count, bound=length)
            )
        return parts

    def sort(self, rays: Rays, listed: RayList) -> RayList:
        """`listed` in sorted order, valid until the next call. `listed` itself stays as it is."""
        inputs = [rays, self._box, listed.slots, listed.count, self._keys, self._sorted]
        wp.launch(self._kernel, listed.bound if self._device.is_cuda else 1, inputs, device=self._device)
        if self._device.is_cuda:
            wp.utils.radix_sort_pairs(self._keys, self._sorted, listed.bound, 0, KEY_BITS)
        return dataclasses.replace(listed, slots=self._sorted)
