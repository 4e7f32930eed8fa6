"""The tracer that sorts rays to packets and takes their frusta through the tree level by level."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import seconds_of, slices
from benchmarking.tracers.interface import Hits, MeasuredTracer, Timing, Tree
from benchmarking.tracers.rivals.breadth import frusta, leaves, packets
from benchmarking.tracers.rivals.breadth.flat import flat_tree
from benchmarking.tracers.stages import SceneTrees, slot_list, upload_rays
from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.device.devices import load_kernels

PAIRS_MAX = 1 << 22  # packets at nodes of one level, or in leaves, at a time
KERNELS = (
    packets.hash_kernel,
    packets.heads_kernel,
    packets.cuts_kernel,
    packets.starts_kernel,
    packets.runs_kernel,
    packets.lengths_kernel,
    packets.places_kernel,
    packets.spread_kernel,
    frusta.bounds_kernel,
    frusta.count_kernel,
    frusta.emit_kernel,
    leaves.firsts_kernel,
    leaves.items_kernel,
)


class TooManyError(Exception):
    """So many packets at a time meet too much."""


@dataclass
class _Packets:
    """Rays in the order of their hashes, as packets."""

    slots: wp.array
    first: wp.array  # where each packet begins, and the last ends
    number: wp.array  # of each ray's packet, from 1


@dataclass
class _Met:
    """What items met in leaves, sorted by item and distance."""

    keys: wp.array
    what: wp.array
    count: int


class BreadthFirstTracer(MeasuredTracer):
    """Garanzha and Loop 2010, "Fast ray sorting and breadth-first packet traversal for GPU ray tracing".

    Rays are hashed by origin and direction; runs of equal hashes are packed to one entry each, the entries sorted by
    radix, and unpacked; equal hashes, up to a size, make a packet. The frusta of packets meet the tree level by level:
    each level is counted, scanned and written. What a packet met in leaves is sorted, and its rays meet that from near
    to far.

    The hash here is a cell of the direction, on an unfolded octahedron, above the Morton code of a cell of the origin.
    A frustum is the interval of its rays' origins and of their inverse directions, not four planes: it holds for any
    rays, with the margins of ours. The tree is ours, spelled out so that one kernel reads either layout; their tree was
    binary, with one set of leaves. Leaves are sorted by the distance at which the bounds enter; theirs came from the
    order of traversal. With instances the top level is gone through first, and a packet has bounds in each tree that
    it comes to. So many packets go together as fit `PAIRS_MAX`. One launch a step, on any device.
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, rays: int, origin: int, direction: int):
        """`rays` of a packet at most; bits of a coordinate of `origin` and `direction` in the hash."""
        self.name = name
        self._trees, self._device, self._size = trees, device, rays
        self._bits = (origin, direction)
        self._layout = layout_for(device)

    def build(self, scene: BenchmarkScene) -> Tree:
        built = self._trees.get(scene, "OFF")
        start = time.perf_counter()
        self._tree, self._instancing = built.tree, scene.instancing
        self._flat = flat_tree(built.tree, self._layout, scene.instancing, self._device)
        seconds = time.perf_counter() - start
        low, high = np.asarray(scene.box())
        self._rule = packets.HashRule()
        self._rule.low = wp.vec3(*low.tolist())
        self._rule.scale = wp.vec3(*np.divide(1, high - low, out=np.zeros(3), where=high - low > 1e-30).tolist())
        self._rule.origin_bits, self._rule.direction_bits = self._bits
        self._top_node = built.tree.top_node
        self._mesh_nodes = built.tree.entry_node.numpy()
        load_kernels(
            [*KERNELS, *(leaves.leaves_kernel(any_hit) for any_hit in (False, True))], self._device, lambda *_: None
        )
        return Tree(built.reported.build_seconds + seconds, built.reported.bytes)

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        self._any_hit, self._rays = rays.type.shadow, upload_rays(rays, self._device)
        self._parts = [slot_list(part, self._device).slots for part in slices(len(rays), thread_count)]

    def trace(self) -> Timing:
        sorted_parts: dict[int, _Packets] = {}

        def sort(k: int) -> None:
            sorted_parts[k] = self._sort(self._parts[k])

        numbers = range(len(self._parts))
        sort_seconds = seconds_of([lambda k=k: sort(k) for k in numbers], self._device)
        seconds = seconds_of([lambda k=k: self._trace(sorted_parts[k]) for k in numbers], self._device)
        return Timing(sort_seconds + seconds, sort_seconds)

    def hits(self) -> Hits:
        hit = self._rays.hit_instance.numpy() >= 0
        return Hits(hit, None if self._any_hit else self._rays.hit_t.numpy())

    # --- packets

    def _launch(self, kernel: wp.Kernel, count: int, *inputs: Any) -> None:
        wp.launch(kernel, count, list(inputs), device=self._device)

    def _ints(self, count: int) -> wp.array:
        return wp.empty(count, dtype=int, device=self._device)

    def _scanned(self, values: wp.array) -> int:
        """The sum of `values`, each of which becomes the sum up to it."""
        wp.utils.array_scan(values, values, inclusive=True)
        return int(values[len(values) - 1 : len(values)].numpy()[0])

    def _runs(self, heads: wp.array) -> wp.array:
        """Where runs begin, and the last one ends; `heads`, 1 where one begins, become the runs' numbers from 1."""
        starts = self._ints(self._scanned(heads) + 1)
        self._launch(packets.starts_kernel, len(heads), heads, starts)
        return starts

    def _sort(self, slots: wp.array) -> _Packets:
        n, device = len(slots), self._device
        keys = wp.empty(n, dtype=wp.uint32, device=device)
        self._launch(packets.hash_kernel, n, self._rays, self._rule, slots, keys)
        number = self._ints(n)
        self._launch(packets.heads_kernel, n, keys, number)
        starts = self._runs(number)
        count = len(starts) - 1
        run_keys, runs = wp.empty(2 * count, dtype=wp.uint32, device=device), self._ints(2 * count)
        self._launch(packets.runs_kernel, count, keys, starts, run_keys, runs)
        wp.utils.radix_sort_pairs(run_keys, runs, count)
        offsets, places = self._ints(count), self._ints(count)
        self._launch(packets.lengths_kernel, count, runs, starts, offsets)
        wp.utils.array_scan(offsets, offsets, inclusive=False)
        self._launch(packets.places_kernel, count, runs, offsets, places)
        result = packets.Sorted()
        result.slots, result.keys = self._ints(n), wp.empty(n, dtype=wp.uint32, device=device)
        self._launch(packets.spread_kernel, n, slots, keys, number, starts, places, result)
        self._launch(packets.heads_kernel, n, result.keys, number)
        run_starts = self._runs(number)
        packet = self._ints(n)
        self._launch(packets.cuts_kernel, n, number, run_starts, self._size, packet)
        return _Packets(result.slots, self._runs(packet), packet)

    # --- traversal

    def _trace(self, sorted_rays: _Packets) -> None:
        count = len(sorted_rays.first) - 1
        firsts = sorted_rays.first.numpy()
        begin, step = 0, count
        while begin < count:
            end = min(count, begin + step)
            try:
                self._trace_packets(sorted_rays, begin, end, int(firsts[begin]), int(firsts[end]))
            except TooManyError:
                step = max(1, (end - begin) // 4)
                continue
            begin = end

    def _trace_packets(self, sorted_rays: _Packets, begin: int, end: int, ray_from: int, ray_end: int) -> None:
        n, single = end - begin, end - begin == 1
        first = sorted_rays.first[begin : end + 1]
        if self._instancing:
            items = self._items(wp.array(np.arange(n), dtype=int, device=self._device), wp.full(n, -1, dtype=int))
            self._launch(frusta.bounds_kernel, n, self._tree, self._rays, sorted_rays.slots, first, items)
            top = wp.full(n, self._top_node, dtype=int, device=self._device)
            met = self._descend(items, top, True, single)
            items = self._items(self._ints(met.count), self._ints(met.count))
            self._launch(leaves.items_kernel, met.count, met.keys, met.what, items)
            item_first = self._firsts(met, n)
            entries = items.entry.numpy()
            roots = wp.array(self._mesh_nodes[entries], dtype=int, device=self._device)
        else:
            items = self._items(wp.array(np.arange(n), dtype=int, device=self._device), wp.zeros(n, dtype=int))
            item_first = wp.array(np.arange(n + 1), dtype=int, device=self._device)
            roots = wp.full(n, int(self._mesh_nodes[0]), dtype=int, device=self._device)
        count = len(items.packet)
        self._launch(frusta.bounds_kernel, count, self._tree, self._rays, sorted_rays.slots, first, items)
        met = self._descend(items, roots, False, single)
        work = leaves.Work()
        work.slots, work.packet = sorted_rays.slots, sorted_rays.number
        work.packet_from, work.ray_from = begin, ray_from
        work.item_first, work.leaf_first = item_first, self._firsts(met, count)
        work.leaf_key, work.leaf = met.keys, met.what
        kernel = leaves.leaves_kernel(self._any_hit)
        self._launch(kernel, ray_end - ray_from, self._flat, self._tree, self._rays, items, work)

    def _items(self, packet: wp.array, entry: wp.array) -> Any:
        items = frusta.Items()
        items.packet, items.entry = packet, entry.to(self._device)
        items.bounds = wp.empty(len(packet), dtype=frusta.Bounds, device=self._device)
        return items

    def _firsts(self, met: _Met, count: int) -> wp.array:
        """Where what each of `count` items met begins, and the last ends."""
        firsts = self._ints(count + 1)
        self._launch(leaves.firsts_kernel, count + 1, met.keys, met.count, firsts)
        return firsts

    def _descend(self, items: Any, roots: wp.array, top: bool, unbounded: bool) -> _Met:
        """What `items` meet in leaves of the trees whose `roots` they begin at; raises `TooManyError`."""
        device, n = self._device, len(roots)
        frontier = self._frontier(n)
        frontier.item = wp.array(np.arange(n), dtype=int, device=device)
        frontier.node = frontier.base = roots
        parts, total = [], 0
        while n:
            self._launch(frusta.count_kernel, n, self._flat, items, frontier, top)
            inner, found = self._scanned(frontier.inner), self._scanned(frontier.leaves)
            total += found
            if max(inner, total) > PAIRS_MAX and not unbounded:
                raise TooManyError
            deeper, part = self._frontier(inner), frusta.Found()
            part.key, part.what = wp.empty(found, dtype=wp.int64, device=device), self._ints(found)
            self._launch(frusta.emit_kernel, n, self._flat, self._tree, items, frontier, top, deeper, part)
            parts.append(part)
            frontier, n = deeper, inner
        keys, what = wp.empty(2 * total, dtype=wp.int64, device=device), self._ints(2 * total)
        at = 0
        for part in parts:
            if len(part.what):
                wp.copy(keys, part.key, dest_offset=at, count=len(part.what))
                wp.copy(what, part.what, dest_offset=at, count=len(part.what))
                at += len(part.what)
        if total:
            wp.utils.radix_sort_pairs(keys, what, total)
        return _Met(keys, what, total)

    def _frontier(self, count: int) -> Any:
        frontier = frusta.Frontier()
        for name in ("item", "node", "base", "inner", "leaves"):
            setattr(frontier, name, self._ints(count))
        return frontier
