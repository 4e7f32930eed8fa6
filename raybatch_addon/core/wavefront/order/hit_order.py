"""The order in which hits are shaded where triangles lie in host memory: that of their triangles.

A CUDA device reads host memory through pages of addresses, of which it remembers few: hits that lie anywhere in a few
gigabytes are read at 24 million a second, and those in the order of their triangles at 390 (H200, 4 million hits, 36
bytes each). A key of 16 bits is enough for that, as it takes only half the passes of a whole one. What a path adds to
the film does not depend on its place in a list.
"""

from __future__ import annotations

from collections.abc import Iterator

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...measure.timing import NoTimer, StageTimer
from ...rays import RayList, Rays
from ...scene.geometry import Geometry

KEY_BITS = 16
# Hits that are sorted at a time, so that sorting takes no more memory however many paths are alive
SORTED_MAX = 1 << 22
# Two keys and two values
_BYTES_PER_HIT = 16


@wp.struct
class HitPart:
    """A part of a list of hits, to be sorted."""

    first: int  # place of its first hit in the list
    shift: int  # bits of a triangle's number that its key leaves out
    count: wp.array(dtype=int)  # hits in it, shape [1]
    keys: wp.array(dtype=wp.uint32)
    slots: wp.array(dtype=int)


@wp.kernel(**KERNEL_OPTIONS)
def hit_key_kernel(
    geometry: Geometry, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), part: HitPart
):
    """Keys and slots of the hits at `part.first` and behind it among the first `count[0]` of `slots`. What lies behind
    these gets the largest key, and stays behind them as the sort is stable. One thread for each place of the part."""
    i = wp.tid()
    place = part.first + i
    if i == 0:
        part.count[0] = wp.max(0, count[0] - place)
    key = wp.uint32(wp.static((1 << KEY_BITS) - 1))
    slot = int(0)
    if place < count[0]:
        slot = slots[place]
        mesh = geometry.instance_mesh[rays.hit_instance[slot]]
        key = wp.uint32((geometry.mesh_triangle_first[mesh] + rays.hit_primitive[slot]) >> part.shift)
    part.keys[i] = key
    part.slots[i] = slot


def hit_order_bytes(path_count: int) -> int:
    """Device memory of a `HitOrder` [bytes]."""
    return min(path_count, SORTED_MAX) * _BYTES_PER_HIT


class HitOrder:
    """Sorts lists of hits; holds the scratch of one worker."""

    def __init__(
        self, path_count: int, geometry: Geometry, device: wp.Device, timer: StageTimer | NoTimer, capacity: int = 0
    ):
        """For `path_count` paths in `geometry`, which holds the corners of every triangle. `capacity`: hits sorted at
        once (0: chosen here)."""
        self._device, self._geometry, self._timer = device, geometry, timer
        self._capacity = capacity = min(path_count, capacity or SORTED_MAX)
        part = self._part = HitPart()
        part.shift = max(0, (geometry.positions.size // 3).bit_length() - KEY_BITS)
        with wp.ScopedDevice(device):
            part.count = wp.zeros(1, dtype=int)
            part.keys = wp.zeros(2 * capacity, dtype=wp.uint32)
            part.slots = wp.zeros(2 * capacity, dtype=int)

    def parts(self, rays: Rays, hits: RayList) -> Iterator[RayList]:
        """The paths of `hits` in lists that follow their triangles, each valid until the next is asked for."""
        part = self._part
        for first in range(0, hits.bound, self._capacity):
            bound = min(self._capacity, hits.bound - first)
            part.first = first
            with self._timer.stage("sort"):
                inputs = [self._geometry, rays, hits.slots, hits.count, part]
                wp.launch(hit_key_kernel, bound, inputs, device=self._device)
                wp.utils.radix_sort_pairs(part.keys, part.slots, bound, 0, KEY_BITS)
            yield RayList(part.slots, part.count, bound)
