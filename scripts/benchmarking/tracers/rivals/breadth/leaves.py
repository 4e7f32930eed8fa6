"""The kernel in which rays of packets meet what the packets' bounds met in leaves."""

from __future__ import annotations

import functools

import warp as wp

from benchmarking.tracers.rivals.breadth.flat import FlatTree
from benchmarking.tracers.rivals.breadth.frusta import Items, Slabs, moved_ray
from benchmarking.tracers.rivals.native_stage import FOLDER
from raybatch_addon.core.bvh.intersect import EDGE_TINY
from raybatch_addon.core.bvh.traverse.identify import name_of
from raybatch_addon.core.bvh.tree import Tree as DeviceTree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native.build import native_source
from raybatch_addon.core.rays import Rays


@wp.func_native(native_source("traverse/triangle.h", "meet_one.h", beside=FOLDER, EDGE_TINY=EDGE_TINY))
def meet_triangle(o: wp.vec3, d: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3: ...


@wp.func
def box_entered(low: wp.vec3, high: wp.vec3, s: Slabs, limit: float) -> bool:
    """Whether the ray meets the box before `limit`."""
    enter = float(0.0)
    leave = limit
    for k in range(3):
        near = (low[k] - s.before[k]) * s.inverse[k]
        far = (high[k] - s.behind[k]) * s.inverse[k]
        if s.inverse[k] < 0.0:
            near = (high[k] - s.before[k]) * s.inverse[k]
            far = (low[k] - s.behind[k]) * s.inverse[k]
        enter = wp.max(enter, near)
        leave = wp.min(leave, far)
    return enter <= leave


@wp.struct
class Work:
    """Rays in the order of packets, and what their packets met; of the packets from `packet_from` on."""

    slots: wp.array(dtype=int)
    packet: wp.array(dtype=int)  # of each ray, counted from 1
    packet_from: int
    ray_from: int
    item_first: wp.array(dtype=int)  # by packet, less `packet_from`, and behind the last
    leaf_first: wp.array(dtype=int)  # by item, and behind the last
    leaf_key: wp.array(dtype=wp.int64)  # see `Found`
    leaf: wp.array(dtype=int)


@wp.struct
class Nearest:
    """The closest hit so far, or the limit."""

    t: float
    instance: int
    primitive: int
    uv: wp.vec2


@functools.cache
def leaves_kernel(any_hit: bool) -> wp.Kernel:
    """Kernel (flat, tree, rays, items, work): one ray a thread. Leaves of a packet in a tree come in the order of the
    distances at which its bounds enter, so a ray is done with the tree at the first that is beyond its closest hit."""

    @wp.kernel(**KERNEL_OPTIONS)
    def test_leaves(flat: FlatTree, tree: DeviceTree, rays: Rays, items: Items, work: Work):
        i = wp.tid() + work.ray_from
        slot = work.slots[i]
        packet = work.packet[i] - 1 - work.packet_from
        best = Nearest()
        best.t = wp.where(rays.t_max[slot] > 0.0, rays.t_max[slot], 0.0)
        best.instance = -1
        best.primitive = -1
        for item in range(work.item_first[packet], work.item_first[packet + 1]):
            entry = items.entry[item]
            seen = bool(True)
            if rays.visibility.shape[0] != 0 and tree.entry_visibility[entry] & rays.visibility[slot] == 0:
                seen = False
            moved = moved_ray(tree, entry, rays.origin[slot], rays.direction[slot])
            j = work.leaf_first[item]
            end = work.leaf_first[item + 1]
            if not seen or not moved.slabs.sound:
                j = end
            triangles = tree.entry_triangle[entry] * flat.group
            while j < end:
                child = work.leaf[j]
                if wp.cast(wp.uint32(work.leaf_key[j] & wp.int64(0xFFFFFFFF)), float) > best.t:
                    j = end
                elif box_entered(flat.low[child], flat.high[child], moved.slabs, best.t):
                    first = triangles + flat.first[child]
                    for k in range(first, first + flat.count[child]):
                        face = flat.face[k]
                        if face >= 0:
                            met = meet_triangle(moved.origin, moved.direction, flat.a[k], flat.b[k], flat.c[k])
                            if wp.static(any_hit):
                                if met[0] > 0.0 and met[0] < best.t:
                                    best.instance = 0
                            elif met[0] > 0.0 and met[0] <= best.t:
                                who = name_of(tree, entry, face)
                                nearer = met[0] < best.t
                                if met[0] == best.t and best.instance >= 0:
                                    nearer = who[0] < best.instance or (
                                        who[0] == best.instance and who[1] < best.primitive
                                    )
                                if nearer:
                                    best.t = met[0]
                                    best.instance = who[0]
                                    best.primitive = who[1]
                                    best.uv = wp.vec2(met[1], met[2])
                if wp.static(any_hit):
                    if best.instance >= 0:
                        best.t = -1.0
                        j = end
                j = j + 1
        rays.hit_instance[slot] = best.instance
        if wp.static(not any_hit):
            rays.hit_t[slot] = best.t
            rays.hit_primitive[slot] = best.primitive
            rays.hit_uv[slot] = best.uv

    return test_leaves


@wp.kernel(**KERNEL_OPTIONS)
def firsts_kernel(keys: wp.array(dtype=wp.int64), count: int, firsts: wp.array(dtype=int)):
    """`firsts[k]`: the first of the sorted `keys` whose upper half is not below k, found by halving."""
    k = wp.int64(wp.tid()) << wp.int64(32)
    low = int(0)
    high = count
    while low < high:
        middle = (low + high) / 2
        if keys[middle] < k:
            low = middle + 1
        else:
            high = middle
    firsts[wp.tid()] = low


@wp.kernel(**KERNEL_OPTIONS)
def items_kernel(keys: wp.array(dtype=wp.int64), entries: wp.array(dtype=int), items: Items):
    """Items of the packets and entries that the top level gave, in the order of packets."""
    i = wp.tid()
    items.packet[i] = int(keys[i] >> wp.int64(32))
    items.entry[i] = entries[i]
