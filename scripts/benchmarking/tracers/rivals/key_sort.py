"""Sorts lists of rays by one of several keys: on the CPU by the engine's own radix sort, with longer digits; on CUDA by
Warp's.
"""

from __future__ import annotations

import dataclasses
import enum
import functools

import numpy as np
import warp as wp

from benchmarking.tracers.rivals.native_stage import FOLDER
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native.build import native_source
from raybatch_addon.core.rays import RayList, Rays

KEY_BITS = 32
_DIGIT_BITS = 11  # three digits


class Key(enum.IntEnum):
    """What rays are sorted by."""

    ORIGIN = 0  # Morton code of the origin, 10 bits an axis
    ORIGIN_DIRECTION = 1  # origin, 6 bits an axis, above the direction, 14 bits
    DIRECTION_ORIGIN = 2  # the same parts, the direction above
    TWO_POINT = 3  # origin and an end that is guessed, 5 bits an axis, interleaved
    HIT_POINT = 4  # Morton code of a hit, 10 bits an axis


@wp.struct
class KeyRule:
    """How keys are made."""

    key: int
    low: wp.vec3  # of the scene's box [m]
    high: wp.vec3
    scale: wp.vec3  # 1 / extent, and 0 along an axis without extent [1/m]
    reach: float  # how far from the origin the end of TWO_POINT is guessed to be [m]
    limit: wp.array(dtype=float)  # t_max by ray slot
    hit: wp.array(dtype=int)  # of HIT_POINT, by ray slot: -1 for none
    hit_t: wp.array(dtype=float)


def _source(header: str, device: str = "", **defines: int) -> str:
    keys = {key.name: int(key) for key in Key}
    return native_source("keys.h", header, device=device, beside=FOLDER, **defines, **keys)


@functools.cache
def key_kernel() -> wp.Kernel:
    """Kernel (origin, direction, rule, slots, count, keys, values) for CUDA, as `order.ray_sort.key_kernel`."""

    @wp.func_native(_source("sort/slot_key.h"))
    def rival_key(
        rays_origin: wp.array(dtype=wp.vec3), rays_direction: wp.array(dtype=wp.vec3), rule: KeyRule, slot: int
    ) -> wp.uint32: ...

    @wp.kernel(**KERNEL_OPTIONS)
    def rival_keys(
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        rule: KeyRule,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        keys: wp.array(dtype=wp.uint32),
        values: wp.array(dtype=int),
    ):
        i = wp.tid()
        slot = slots[i]
        key = wp.uint32(0xFFFFFFFF)
        if i < count[0]:
            key = rival_key(origin, direction, rule, slot)
        keys[i] = key
        values[i] = slot

    return rival_keys


@functools.cache
def host_sort_kernel() -> wp.Kernel:
    """Kernel (origin, direction, rule, slots, count, entries, result) for the CPU, as `order.ray_sort.
    host_sort_kernel`."""

    @wp.func_native(_source("sort/host_sort.h", "cpu", DIGIT_BITS=_DIGIT_BITS))
    def sort(
        rays_origin: wp.array(dtype=wp.vec3),
        rays_direction: wp.array(dtype=wp.vec3),
        rule: KeyRule,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
        result: wp.array(dtype=int),
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def sort_by_key(
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        rule: KeyRule,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
        result: wp.array(dtype=int),
    ):
        sort(origin, direction, rule, slots, count, entries, result)

    return sort_by_key


def key_sort_kernel(device: wp.Device) -> wp.Kernel:
    """The kernel that a `KeySorter` launches on `device`."""
    return key_kernel() if device.is_cuda else host_sort_kernel()


Corner = tuple[float, ...]


class KeySorter:
    """Sorts lists of ray slots; holds the scratch of one thread."""

    def __init__(self, capacity: int, device: wp.Device, key: Key, box: tuple[Corner, Corner], reach: float = 0.0):
        """For lists of exactly `capacity` rays in a scene of this `box` [m]; `reach`: see `KeyRule` [m]."""
        self._device, self._capacity, self._kernel = device, capacity, key_sort_kernel(device)
        low, high = np.asarray(box, np.float64)
        self.rule = KeyRule()
        self.rule.key, self.rule.reach = int(key), reach
        self.rule.low, self.rule.high = wp.vec3(*low.tolist()), wp.vec3(*high.tolist())
        scale = np.divide(1.0, high - low, out=np.zeros(3), where=high - low > 1e-30)
        self.rule.scale = wp.vec3(*scale.tolist())
        self._keys = wp.empty(2 * capacity, dtype=wp.uint32 if device.is_cuda else wp.uint64, device=device)
        self._sorted = wp.empty(2 * capacity if device.is_cuda else capacity, dtype=int, device=device)

    def sort(self, rays: Rays, listed: RayList) -> RayList:
        """`listed` in the order of keys, equal ones in its own; valid until the next call."""
        self.rule.limit = rays.t_max
        inputs = [rays.origin, rays.direction, self.rule, listed.slots, listed.count, self._keys, self._sorted]
        wp.launch(self._kernel, self._capacity if self._device.is_cuda else 1, inputs, device=self._device)
        if self._device.is_cuda:
            wp.utils.radix_sort_pairs(self._keys, self._sorted, self._capacity, 0, KEY_BITS)
        return dataclasses.replace(listed, slots=self._sorted)
