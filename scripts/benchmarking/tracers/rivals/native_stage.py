"""Native kernels of rivals that carry packets or streams of rays through the engine's own tree of the layout BOXES."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.tracers.interface import Tree
from benchmarking.tracers.stages import SceneTrees, StageTracer
from raybatch_addon.core.bvh.build.binary import DEPTH_MAX
from raybatch_addon.core.bvh.intersect import EDGE_TINY
from raybatch_addon.core.bvh.margin import DIRECTION_LEAST, SLAB_MARGIN
from raybatch_addon.core.bvh.node import BOXES_DEFINES, WIDTH, Layout, decode_children
from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.bvh.tree import Tree as DeviceTree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native.build import native_source
from raybatch_addon.core.rays import DeviceRayList, RayList, Rays, fill_list

FOLDER = Path(__file__).parent / "native"
LEVELS = DEPTH_MAX + 1  # nodes on a way from the root to a leaf, at most
RAY_BYTES = 128
_RAY_HEADERS = (
    "math/vectors.h",
    "math/transform.h",
    "traverse/identify.h",
    "rays.h",
    "traverse/boxes/triangles.h",
    "entries.h",
)


@dataclass(frozen=True)
class Traversal:
    """How a packet or stream goes through one tree: its headers, and the memory that they need."""

    headers: tuple[str, ...]
    ray_bytes: int  # for each ray, in each tree
    level_bytes: int  # for each ray, at each level of a tree
    spare_bytes: int  # at each level, whatever the rays
    ordered: bool = False  # reads children's orders by octant

    def tree_bytes(self, size: int) -> int:
        """Memory of streams of `size` rays in one tree, a multiple of 64."""
        return -(-(self.ray_bytes * size + LEVELS * (self.level_bytes * size + self.spare_bytes) + 4096) // 64) * 64


_PACKET = {"ray_bytes": 48, "level_bytes": 0, "spare_bytes": 0}
RANGED = Traversal(("packet.h", "ranged.h"), **_PACKET)
PARTITION = Traversal(("packet.h", "partition.h"), **_PACKET)
FILTER = Traversal(("filter.h",), ray_bytes=2, level_bytes=16, spare_bytes=8 * 37 * 2)
REORDERED = Traversal(("alone.h", "reordered_streams.h"), ray_bytes=10, level_bytes=27 * 8, spare_bytes=27 * 9 * 8)
ORDERED = Traversal(
    ("alone.h", "ordered_streams.h"), ray_bytes=2, level_bytes=80, spare_bytes=8 * 37 * 2 + 64, ordered=True
)


@wp.struct
class Scratch:
    """What a traversal works in, and with what parameters."""

    memory: wp.array(dtype=wp.uint8)
    size: int  # rays of a packet or stream
    alone: int  # so many rays or fewer go on one by one
    tree_bytes: wp.int64  # memory of one tree
    orders: wp.array(dtype=wp.uint32)  # by node and octant: the children in order, four bits each
    totals: wp.array(dtype=wp.int64)  # nodes visited by packets or streams, and by their rays or blocks of rays


@functools.cache
def rival_kernel(traversal: Traversal, any_hit: bool, instancing: bool) -> wp.Kernel:
    """Kernel (tree, rays, listed, scratch), one thread on the CPU: trace the rays of `listed`, as `boxes_kernel`."""
    source = native_source(
        *_RAY_HEADERS,
        *traversal.headers,
        "streams.h",
        device="cpu",
        beside=FOLDER,
        **BOXES_DEFINES,
        TREELETS=False,
        COUNTERS=False,
        MOTION=False,
        ANY_HIT=any_hit,
        TWO_LEVEL=instancing,
        DIRECTION_LEAST=DIRECTION_LEAST,
        SLAB_MARGIN=SLAB_MARGIN,
        EDGE_TINY=EDGE_TINY,
        LEVELS=LEVELS,
        STACK=(WIDTH - 1) * LEVELS + 16,
    )

    @wp.func_native(source)
    def trace(tree: DeviceTree, rays: Rays, listed: DeviceRayList, first: int, end: int, scratch: Scratch): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_together(tree: DeviceTree, rays: Rays, listed: DeviceRayList, scratch: Scratch):
        trace(tree, rays, listed, 0, listed.count[0], scratch)

    return trace_together


class RivalStage:
    """Traces lists of rays, `size` at a time together (`TraceStage`); has memory of its own, so one a thread."""

    def __init__(self, traversal: Traversal, any_hit: bool, instancing: bool, size: int, alone: int = 0):
        self._kernel = rival_kernel(traversal, any_hit, instancing)
        self.kernels = (self._kernel,)
        self._traversal, self._size, self._alone, self._trees = traversal, size, alone, 2 if instancing else 1
        self._listed = DeviceRayList()
        self._scratch: Scratch | None = None

    def prepare(self, orders: wp.array | None) -> None:
        """Have memory, before anything is timed."""
        scratch = Scratch()
        tree_bytes = self._traversal.tree_bytes(self._size)
        size = 64 + 2 * RAY_BYTES * self._size + self._trees * tree_bytes
        scratch.memory = wp.empty(size, dtype=wp.uint8, device="cpu")
        scratch.size, scratch.alone, scratch.tree_bytes = self._size, self._alone, tree_bytes
        if orders is not None:
            scratch.orders = orders
        scratch.totals = wp.zeros(2, dtype=wp.int64, device="cpu")
        self._scratch = scratch

    def launch(self, tree: DeviceTree, rays: Rays, listed: RayList, counts: TraceCounts | None) -> None:
        """Trace the rays of `listed`; nothing is written to `counts`."""
        fill_list(self._listed, listed)
        self._scratch.totals.zero_()
        wp.launch(self._kernel, 1, [tree, rays, self._listed, self._scratch], device="cpu")

    def totals(self) -> tuple[int, int]:
        """Of the last launch: nodes visited, and rays (of packets: blocks of rays) that met them."""
        nodes, steps = self._scratch.totals.numpy().tolist()
        return nodes, steps


class PacketTracer(StageTracer):
    """Packets or streams of rays in the tree of `off`, one kernel launch a thread."""

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, traversal: Traversal, **parameters: int):
        """`parameters`: `size`, rays of a packet or stream, and `alone`, so many rays or fewer go on one by one."""
        super().__init__(name, trees, device, "OFF")
        self._traversal, self._parameters = traversal, parameters
        self._orders: wp.array | None = None

    def build(self, scene: BenchmarkScene) -> Tree:
        reported = super().build(scene)
        if self._traversal.ordered:
            orders = octant_orders(self._built.nodes.numpy())
            self._orders = wp.array(orders.reshape(-1), dtype=wp.uint32, device="cpu")
        return reported

    def _stage(self, any_hit: bool, counters: bool = False) -> RivalStage:
        return RivalStage(self._traversal, any_hit, self._instancing, **self._parameters)

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        super().load(rays, thread_count)
        for part in self._parts:
            part.stage.prepare(self._orders)

    def work(self) -> dict[str, Any]:
        nodes, steps = np.sum([part.stage.totals() for part in self._parts], 0).tolist()
        count = len(self._rays.t_max)
        return super().work() | {"nodes_read": round(nodes / count, 3), "node_steps": round(steps / count, 3)}


def octant_orders(nodes: np.ndarray) -> np.ndarray:
    """The children of each node of BOXES from near to far, by octant (bit k: a direction is negative along axis k), by
    their boxes' middles along the diagonal of the octant: uint32 with a child every four bits, shape [n, 8].

    `nodes` are words, float32, in whatever shape; behind the last node there may be others, that mean nothing.
    """
    words = Layout.BOXES.node_words
    children = decode_children(Layout.BOXES, nodes.reshape(-1)[: nodes.size // words * words].reshape(-1, words))
    there = np.isfinite(children.low).all(2)
    low, high = (np.where(there[..., None], corner, 0.0) for corner in (children.low, children.high))
    middle = low / 2 + high / 2
    orders = np.zeros((len(middle), 8), np.uint32)
    for octant in range(8):
        towards = np.array([-1.0 if octant >> k & 1 else 1.0 for k in range(3)])
        with np.errstate(over="ignore", invalid="ignore"):  # of what is no node
            far = np.where(there, middle @ towards, np.inf)
        slots = np.argsort(far, 1, kind="stable").astype(np.uint32)
        orders[:, octant] = (slots << (4 * np.arange(WIDTH, dtype=np.uint32))).sum(1, dtype=np.uint32)
    return orders
