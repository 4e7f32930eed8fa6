"""Traversal of quantised trees: closest hit and any hit, for CUDA (and, one ray at a time, for CPUs).

The nodes are those of Ylitie, Karras and Laine 2017 ("Efficient incoherent ray traversal on GPUs through compressed
wide BVHs"). Warps are persistent: a lane whose ray is done takes the next one from the list as soon as enough lanes
wait for that (Aila and Laine 2009, "Understanding the efficiency of ray traversal on GPUs"). In each turn of the loop
a lane tests one triangle and visits one node; a second group of triangles may wait, so that lanes with many triangles
do not hold up the others. Which lane takes which ray, and when, changes nothing: a ray's closest hit is the
lexicographic minimum of (t, instance, primitive) over all triangles, whatever the order of visits.
"""

from __future__ import annotations

import functools

import warp as wp

from ...native.build import native_source
from ...rays import DeviceRayList, Rays
from ...settings.device import TRACE_BLOCK_SIZE
from ..intersect import EDGE_TINY
from ..margin import DIRECTION_LEAST, SLAB_MARGIN
from ..node import QUANTISED_DEFINES
from ..tree import Tree
from .counts import TraceCounts
from .cpu import segment_defines
from .motion import motion_defines, motion_headers
from .options import TraceOptions, TraversalOptions

# Levels of a mesh tree and of the top level: each has at most one group of nodes on the stack, the top level one of
# entries too
STACK_MESH, STACK_ALL = 64, 129


NODE_HEADERS = (
    "math/transform.h",
    "traverse/identify.h",
    "traverse/top_level.h",
    "traverse/triangle.h",
    "traverse/quantised/device.h",
    "traverse/quantised/ray.h",
    "traverse/quantised/node.h",
)
"""What stands before the header that says what a lane holds."""

LANE_HEADERS = (
    "traverse/quantised/counters.h",
    "traverse/quantised/mesh_ray.h",
    "traverse/quantised/write_hit.h",
    "traverse/quantised/test.h",
)
"""What stands behind it, and before a lane's own steps and the loop."""

_SEGMENT_HEADERS = (
    *LANE_HEADERS[:-1],
    "traverse/segments/quantised_names.h",
    LANE_HEADERS[-1],
    "traverse/segments/root.h",
    "traverse/segments/meet.h",
    "traverse/segments/quantised_meet.h",
    LANE_HEADERS[-1],
    "traverse/segments/quantised.h",
)


def lane_headers(options: TraversalOptions) -> tuple[str, ...]:
    """`LANE_HEADERS`, with segments of curves where there are some."""
    return _SEGMENT_HEADERS if options.curves else LANE_HEADERS


def quantised_defines(options: TraversalOptions) -> dict[str, bool | int | float]:
    """Macros of the headers that whole trees and cut ones have in common."""
    return QUANTISED_DEFINES | {
        "TWO_LEVEL": options.instancing,
        "COUNTERS": options.counters,
        "REFILL": 32 if options.single_lane else options.refill,
        "SINGLE_LANE": options.single_lane,
        "STACK_SIZE": STACK_ALL if options.instancing else STACK_MESH,
        "DIRECTION_LEAST": DIRECTION_LEAST,
        "SLAB_MARGIN": SLAB_MARGIN,
        "EDGE_TINY": EDGE_TINY,
        **motion_defines(options),
        **segment_defines(options),
    }


def trace_source(options: TraceOptions) -> str:
    """The body of the native function for `options`."""
    return native_source(
        *motion_headers(options),
        *NODE_HEADERS,
        "traverse/quantised/lane.h",
        *lane_headers(options),
        "traverse/quantised/trace.h",
        "traverse/quantised/loop.h",
        ANY_HIT=options.any_hit,
        LEAF_GROUPS=options.leaf_groups,
        EVERY_TRIANGLE=options.every_triangle,
        **quantised_defines(options),
    )


@functools.cache
def trace_function(options: TraceOptions) -> wp.Function:
    """Native function (tree, rays, listed, cursor, thread, counts).

    Traces the rays of `listed`, and writes their hits. Of any hit only `hit_instance` is written: 0, or -1 for nothing.
    All threads of all warps call it, with their numbers. `cursor[0]` is 0 before. With counters also writes `counts`.
    """

    @wp.func_native(trace_source(options))
    def trace(
        tree: Tree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), thread: int, counts: TraceCounts
    ): ...

    return trace


def thread_count(ray_bound: int, options: TraceOptions, device: wp.Device, blocks: int = 16) -> int:
    """Threads to launch for at most `ray_bound` rays: `blocks` persistent blocks a multiprocessor, or one thread a ray.

    On a CPU one thread traces all rays.
    """
    if not options.refill:
        return ray_bound
    if not device.is_cuda:
        return 1
    return persistent_count(ray_bound, device, TRACE_BLOCK_SIZE, blocks)


def persistent_count(ray_bound: int, device: wp.Device, block_size: int, blocks: int = 16) -> int:
    """Threads of persistent warps on CUDA for at most `ray_bound` rays: as many as in `blocks` blocks of
    `TRACE_BLOCK_SIZE` a multiprocessor.
    """
    needed = -(-ray_bound // block_size)
    return min(needed, -(-device.sm_count * blocks * TRACE_BLOCK_SIZE // block_size)) * block_size
