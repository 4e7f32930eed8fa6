"""The order in which hits are shaded: that of their triangles, or that of what shades them. A sort by a short key takes
a pass or two, and what a path adds to the film does not depend on its place in a list.

By triangles where these lie in host memory: a CUDA device reads it through pages of addresses, of which it remembers
few, so that hits that lie anywhere in a few gigabytes are read at 24 million a second, and those in the order of their
triangles at 390 (H200, 4 million hits, 36 bytes each).

By material where materials run different code: the threads of a warp then run the same (Eisenacher et al. 2013, "Sorted
deferred shading for production path tracing").
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...measure.timing import NoTimer, StageTimer
from ...rays import RayList, Rays
from ...scene.geometry import Geometry
from ...shading.bsdf.materials import MaterialRecord
from ...shading.surface import material_at

# Hits that are sorted at a time, so that sorting takes no more memory however many paths are alive
SORTED_MAX = 1 << 22
# Fewer hits are not worth a sort by material
BINNED_MIN = 1 << 10
# Two keys and two values
_BYTES_PER_HIT = 16


class HitKey(Enum):
    """The key that hits are sorted by; its value is its bits."""

    TRIANGLE = 16
    MATERIAL = 8


@wp.struct
class HitPart:
    """A part of a list of hits, to be sorted."""

    first: int  # index of its first hit in the list
    shift: int  # bits of a triangle's number that its key leaves out
    count: wp.array(dtype=int)  # hits in it, shape [1]
    keys: wp.array(dtype=wp.uint32)
    slots: wp.array(dtype=int)


def _key_kernel(key_of: wp.Function, bits: int) -> wp.Kernel:
    @wp.kernel(**KERNEL_OPTIONS)
    def hit_keys(
        geometry: Geometry,
        records: wp.array(dtype=MaterialRecord),
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        part: HitPart,
    ):
        i = wp.tid()
        index = part.first + i
        if i == 0:
            part.count[0] = wp.max(0, count[0] - index)
        key = wp.uint32(wp.static((1 << bits) - 1))
        slot = int(0)
        if index < count[0]:
            slot = slots[index]
            key = key_of(geometry, records, rays, slot, part.shift)
        part.keys[i] = key
        part.slots[i] = slot

    return hit_keys


@wp.func
def _triangle_key(
    geometry: Geometry, records: wp.array(dtype=MaterialRecord), rays: Rays, slot: int, shift: int
) -> wp.uint32:
    mesh = geometry.instance_mesh[rays.hit_instance[slot]]
    return wp.uint32((geometry.mesh_triangle_first[mesh] + rays.hit_primitive[slot]) >> shift)


@wp.func
def _material_key(
    geometry: Geometry, records: wp.array(dtype=MaterialRecord), rays: Rays, slot: int, shift: int
) -> wp.uint32:
    bin = records[material_at(geometry, rays.hit_instance[slot], rays.hit_primitive[slot])].bin
    return wp.uint32(wp.min(bin, wp.static((1 << HitKey.MATERIAL.value) - 1)))


# Kernels (geometry, records, rays, slots, count, part): keys and slots of the hits at `part.first` and behind it among
# the first `count[0]` of `slots`. What lies behind these gets the largest key, and stays behind them as the sort is
# stable. One thread for each entry of the part.
KEY_KERNELS = {
    HitKey.TRIANGLE: _key_kernel(_triangle_key, HitKey.TRIANGLE.value),
    HitKey.MATERIAL: _key_kernel(_material_key, HitKey.MATERIAL.value),
}


def sorts_materials(hit_sort: str, device: wp.Device) -> bool:
    """Whether hits of different materials are sorted under the setting `hit_sort`."""
    return hit_sort == "ON" or (hit_sort == "AUTO" and device.is_cuda)


def hit_order_bytes(path_count: int) -> int:
    """Device memory of a `HitOrder` [bytes]."""
    return min(path_count, SORTED_MAX) * _BYTES_PER_HIT


class HitOrder:
    """Sorts lists of hits; holds the scratch of one worker."""

    def __init__(
        self,
        path_count: int,
        key: HitKey,
        geometry: Geometry,
        records: wp.array,
        device: wp.Device,
        timer: StageTimer | NoTimer,
        capacity: int = 0,
    ):
        """For `path_count` paths in `geometry`, which holds the corners of every triangle. `records`: of the materials.
        `capacity`: hits sorted at once (0: chosen here)."""
        self._device, self._timer, self._key = device, timer, key
        self._inputs = [geometry, records]
        self._capacity = capacity = min(path_count, capacity or SORTED_MAX)
        part = self._part = HitPart()
        part.shift = max(0, (geometry.positions.size // 3).bit_length() - HitKey.TRIANGLE.value)
        part.count = wp.zeros(1, dtype=int, device=device)
        part.keys = wp.zeros(2 * capacity, dtype=wp.uint32, device=device)
        part.slots = wp.zeros(2 * capacity, dtype=int, device=device)

    def parts(self, rays: Rays, hits: RayList) -> Iterator[RayList]:
        """The paths of `hits` in lists that follow their keys, each valid until the next is asked for."""
        if self._key is HitKey.MATERIAL and hits.bound < BINNED_MIN:
            yield hits
            return
        part = self._part
        for first in range(0, hits.bound, self._capacity):
            bound = min(self._capacity, hits.bound - first)
            part.first = first
            with self._timer.stage("sort"):
                inputs = [*self._inputs, rays, hits.slots, hits.count, part]
                wp.launch(KEY_KERNELS[self._key], bound, inputs, device=self._device)
                wp.utils.radix_sort_pairs(part.keys, part.slots, bound, 0, self._key.value)
            yield RayList(part.slots, part.count, bound)
