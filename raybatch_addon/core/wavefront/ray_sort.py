"""Sorts a list of rays by where they start and where they point, so that neighbours in the list visit the same nodes.

A ray's key packs the octant of its direction and the Morton code of its origin within the scene's box (Morton 1966; the use for
rays: Garanzha and Loop 2010; a comparison of keys: Meister et al. 2020). The rays stay where they are; their slots are sorted. The
sort is a stable radix sort, so rays of equal keys keep their order: Warp's own (CUB) on CUDA, and on the CPU one of three digits,
because Warp's is three times slower there. Sorting never changes a film: a ray's hit does not depend on its place in a list.
"""

from __future__ import annotations

import dataclasses
import functools
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernel import KERNEL_OPTIONS
from .rays import Rays

if TYPE_CHECKING:
    from .tracer import SlotList

KEY_BITS = 30


class SortKey(Enum):
    """What the 30 bits of a key are, the most significant first."""

    OCTANT_ORIGIN = "octant, then the Morton code of 512 cells an axis"
    ORIGIN_OCTANT = "Morton code of 32 cells an axis, octant, the rest of the code of 512 cells"
    ORIGIN_DIRECTION = "Morton code in five dimensions: origin and octahedral direction, 64 cells an axis"


# Cells of the origin an axis; NaN and what lies outside the box go to the cells at its border.
_CELLS = r"""
    auto cell = [](float x, float cells) -> unsigned int {
        x *= cells;
        x = x > 0.0f ? x : 0.0f;
        return (unsigned int)(int)(x < cells - 1.0f ? x : cells - 1.0f);
    };
    auto spread = [](unsigned int x) -> unsigned int {
        x = (x | (x << 16)) & 0x030000ffu;
        x = (x | (x << 8)) & 0x0300f00fu;
        x = (x | (x << 4)) & 0x030c30c3u;
        return (x | (x << 2)) & 0x09249249u;
    };
    auto ray_key = [&](int slot) -> unsigned int {
        const wp::vec3 o = rays_origin.data[slot], d = rays_direction.data[slot];
        const float px = (o[0] - low[0]) * scale[0], py = (o[1] - low[1]) * scale[1], pz = (o[2] - low[2]) * scale[2];
        KEY
    };
"""
_OCTANT = r"""
        const unsigned int octant = (d[0] < 0.0f ? 1u : 0u) | (d[1] < 0.0f ? 2u : 0u) | (d[2] < 0.0f ? 4u : 0u);
        const unsigned int code = spread(cell(px, 512.0f)) | spread(cell(py, 512.0f)) << 1 | spread(cell(pz, 512.0f)) << 2;
"""
_KEYS = {
    SortKey.OCTANT_ORIGIN: _OCTANT + "return octant << 27 | code;",
    SortKey.ORIGIN_OCTANT: _OCTANT + "return (code >> 12) << 15 | octant << 12 | (code & 0xfffu);",
    SortKey.ORIGIN_DIRECTION: r"""
        const float length = fabsf(d[0]) + fabsf(d[1]) + fabsf(d[2]);
        float u = d[0] / length, v = d[1] / length;
        if (d[2] < 0.0f) {
            const float folded = (1.0f - fabsf(v)) * (u < 0.0f ? -1.0f : 1.0f);
            v = (1.0f - fabsf(u)) * (v < 0.0f ? -1.0f : 1.0f);
            u = folded;
        }
        const unsigned int cells[5] = {
            cell(0.5f * u + 0.5f, 64.0f), cell(0.5f * v + 0.5f, 64.0f), cell(px, 64.0f), cell(py, 64.0f), cell(pz, 64.0f)
        };
        unsigned int key = 0;
        for (int bit = 0; bit < 6; ++bit)
            for (int axis = 0; axis < 5; ++axis)
                key |= (cells[axis] >> bit & 1u) << (5 * bit + axis);
        return key;
    """,
}

# Counting of all three digits at once, then three stable scatters; a key and its slot travel as one 64-bit entry.
_SORT = r"""
    const int n = count.data[0], digits = 1024;
    unsigned long long* from = (unsigned long long*)entries.data;
    unsigned long long* to = from + entries.shape[0] / 2;
    int first[3][digits] = {};
    for (int i = 0; i < n; ++i) {
        const unsigned int key = ray_key(slots.data[i]);
        from[i] = (unsigned long long)key << 32 | (unsigned int)slots.data[i];
        for (int k = 0; k < 3; ++k) ++first[k][key >> (10 * k) & (digits - 1)];
    }
    for (int k = 0; k < 3; ++k) {
        int sum = 0;
        for (int digit = 0; digit < digits; ++digit) {
            const int found = first[k][digit];
            first[k][digit] = sum;
            sum += found;
        }
    }
    for (int k = 0; k < 2; ++k) {
        for (int i = 0; i < n; ++i) to[first[k][from[i] >> (32 + 10 * k) & (digits - 1)]++] = from[i];
        unsigned long long* swapped = from;
        from = to;
        to = swapped;
    }
    for (int i = 0; i < n; ++i) result.data[first[2][from[i] >> 52 & (digits - 1)]++] = (int)(unsigned int)from[i];
"""


@wp.struct
class SortBox:
    """The box within which origins are told apart."""

    low: wp.vec3  # [m]
    scale: wp.vec3  # 1 / extent, and 0 along an axis without extent [1/m]


@functools.cache
def key_kernel(key: SortKey) -> wp.Kernel:
    """Kernel (rays, box, slots, count, keys, values) for CUDA: keys of the first `count[0]` of `slots`, and the largest key for
    the others, so that they stay behind; `values` is a copy of `slots`."""
    text = _CELLS.replace("KEY", _KEYS[key]) + "return ray_key(slot);"

    @wp.func_native(text)
    def ray_key(
        rays_origin: wp.array(dtype=wp.vec3), rays_direction: wp.array(dtype=wp.vec3), low: wp.vec3, scale: wp.vec3, slot: int
    ) -> wp.uint32: ...

    @wp.kernel(**KERNEL_OPTIONS)
    def sort_keys(
        rays: Rays, box: SortBox, slots: wp.array(dtype=int), count: wp.array(dtype=int),
        keys: wp.array(dtype=wp.uint32), values: wp.array(dtype=int),
    ):  # fmt: skip
        i = wp.tid()
        slot = slots[i]
        key = wp.uint32(0xFFFFFFFF)
        if i < count[0]:
            key = ray_key(rays.origin, rays.direction, box.low, box.scale, slot)
        keys[i] = key
        values[i] = slot

    return sort_keys


@functools.cache
def host_sort_kernel(key: SortKey) -> wp.Kernel:
    """Kernel (rays, box, slots, count, entries, result) for the CPU, launched once for a whole list: `result` holds the first
    `count[0]` of `slots`, sorted. `entries` is scratch of two entries a ray."""
    text = "#if !defined(__CUDA_ARCH__)\n" + _CELLS.replace("KEY", _KEYS[key]) + _SORT + "#endif\n"

    @wp.func_native(text)
    def sort(
        rays_origin: wp.array(dtype=wp.vec3), rays_direction: wp.array(dtype=wp.vec3), low: wp.vec3, scale: wp.vec3,
        slots: wp.array(dtype=int), count: wp.array(dtype=int), entries: wp.array(dtype=wp.uint64), result: wp.array(dtype=int),
    ): ...  # fmt: skip

    @wp.kernel(**KERNEL_OPTIONS)
    def sort_on_host(
        rays: Rays, box: SortBox, slots: wp.array(dtype=int), count: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64), result: wp.array(dtype=int),
    ):  # fmt: skip
        sort(rays.origin, rays.direction, box.low, box.scale, slots, count, entries, result)

    return sort_on_host


def sort_kernel(device: wp.Device, key: SortKey = SortKey.OCTANT_ORIGIN) -> wp.Kernel:
    """The kernel that a `RaySorter` launches on `device`."""
    return key_kernel(key) if device.is_cuda else host_sort_kernel(key)


def sort_bytes_per_ray(is_cuda: bool) -> int:
    """Scratch of a `RaySorter` for each ray of its capacity [bytes]."""
    return 2 * 4 + 2 * 4 if is_cuda else 2 * 8 + 4


class RaySorter:
    """Sorts lists of ray slots; holds the scratch of one worker."""

    def __init__(
        self, capacity: int, device: wp.Device, low: tuple[float, float, float], high: tuple[float, float, float],
        key: SortKey = SortKey.OCTANT_ORIGIN, digit_bits: int = KEY_BITS,
    ):  # fmt: skip
        """Scratch for lists of at most `capacity` rays in the box `low` to `high` [m].

        `digit_bits` is how many leading bits of the key CUDA sorts by: it takes a pass for every eight.
        """
        self._device, self._capacity = device, capacity
        self._first_bit = KEY_BITS - digit_bits
        self._kernel = sort_kernel(device, key)
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

    def parts(self, listed: SlotList) -> list[SlotList]:
        """`listed`, whose length is exactly `bound`, in parts that are short enough to be sorted."""
        if listed.bound <= self._capacity:
            return [listed]
        parts = []
        for first in range(0, listed.bound, self._capacity):
            length = min(self._capacity, listed.bound - first)
            count = wp.full(1, length, dtype=int, device=self._device)
            parts.append(dataclasses.replace(listed, slots=listed.slots[first : first + length], count=count, bound=length))
        return parts

    def sort(self, rays: Rays, listed: SlotList) -> SlotList:
        """`listed` in sorted order, valid until the next call. `listed` itself stays as it is."""
        inputs = [rays, self._box, listed.slots, listed.count, self._keys, self._sorted]
        wp.launch(self._kernel, listed.bound if self._device.is_cuda else 1, inputs, device=self._device)
        if self._device.is_cuda:
            wp.utils.radix_sort_pairs(self._keys, self._sorted, listed.bound, self._first_bit, KEY_BITS)
        return dataclasses.replace(listed, slots=self._sorted)
