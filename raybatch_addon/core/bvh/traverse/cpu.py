"""Traversal of trees of the layout BOXES on a CPU: closest hit and any hit.

A ray visits wide nodes (Wald, Benthin and Boulos 2008, "Getting rid of packets") from near to far: eight boxes or eight
triangles at a time. One ray alone leaves most of the processor idle: each step waits for the one before, for memory,
and for branches that cannot be foretold (how many children are met, leaf or node, hit or miss). So one thread carries
several rays, and each round takes one step with every one of them, in loops over lists of rays that want the same: to
visit a node, to test a leaf, or to find something on their stack. Which list a ray comes on next is decided without
branches; the node or leaf that it visits next is asked for ahead, and is in the cache when its turn comes. Lists are
made one round before they are read, so that their lengths are known long before the processor has to know when a loop
ends.

A ray's steps are the same whatever other rays are carried with it.
"""

from __future__ import annotations

import functools

import warp as wp

from ...native.build import native_source
from ...rays import DeviceRayList, Rays
from ...scene.segments import SEGMENT_DEFINES
from ..build.binary import DEPTH_MAX
from ..intersect import EDGE_TINY
from ..margin import DIRECTION_LEAST, SLAB_MARGIN
from ..node import BOXES_DEFINES
from ..tree import Tree
from .counts import TraceCounts
from .motion import motion_defines, motion_headers
from .options import TraceOptions, TraversalOptions

# Levels of a wide tree are no more than those of the binary tree; each leaves up to seven children waiting. Below them
# is the end of the stack, above them room for the eight words of a store.
_STACK_MESH = 8 + DEPTH_MAX * 7 + 16
_STACK_ALL = _STACK_MESH + DEPTH_MAX * 7 + 16

RAY_HEADERS = (
    "math/vectors.h",
    "math/transform.h",
    "traverse/identify.h",
    "traverse/top_level.h",
    "traverse/boxes/ray.h",
    "traverse/boxes/step.h",
    "traverse/boxes/triangles.h",
)
"""What rays in whole trees and in cut ones have in common."""

_SEGMENT_HEADERS = (
    *RAY_HEADERS[:-1],
    "traverse/segments/boxes_names.h",
    RAY_HEADERS[-1],
    "traverse/segments/root.h",
    "traverse/segments/meet.h",
    "traverse/segments/boxes.h",
)


def ray_headers(options: TraversalOptions) -> tuple[str, ...]:
    """`RAY_HEADERS`, with motion and segments of curves where there are some."""
    return (*motion_headers(options), *(_SEGMENT_HEADERS if options.curves else RAY_HEADERS))


def segment_defines(options: TraversalOptions) -> dict[str, int]:
    """Macros of the headers of segments; none without."""
    return SEGMENT_DEFINES if options.curves else {}


def boxes_defines(options: TraversalOptions) -> dict[str, bool | int | float]:
    """Macros of `RAY_HEADERS`, and of loops over rays."""
    return BOXES_DEFINES | {
        "TWO_LEVEL": options.instancing,
        "COUNTERS": options.counters,
        "CARRIED": options.interleave,
        "STACK": _STACK_ALL if options.instancing else _STACK_MESH,
        "DIRECTION_LEAST": DIRECTION_LEAST,
        "SLAB_MARGIN": SLAB_MARGIN,
        "EDGE_TINY": EDGE_TINY,
        **motion_defines(options),
        **segment_defines(options),
    }


def traversal_source(options: TraceOptions) -> str:
    """The body of the native function for `options`."""
    loop = "traverse/boxes/trace_many.h" if options.interleave > 1 else "traverse/boxes/trace_one.h"
    headers = (*ray_headers(options), "traverse/boxes/trace.h", loop)
    return native_source(*headers, device="cpu", TREELETS=False, ANY_HIT=options.any_hit, **boxes_defines(options))


@functools.cache
def make_cpu_traversal(options: TraceOptions) -> wp.Function:
    """Native function (tree, rays, listed, first, end, counts).

    Traces the rays `listed.slots[first:end]`, and writes their hits: the distance [m], the instance (-1 for nothing),
    the primitive and the weights of its second and third corner; of any hit only `hit_instance`: 0, or -1 for nothing.
    One thread runs it for all of them; on CUDA it does nothing. With counters it also writes `counts`: nodes visited,
    boxes of children that there are, triangles that there are.
    """

    @wp.func_native(traversal_source(options))
    def trace(tree: Tree, rays: Rays, listed: DeviceRayList, first: int, end: int, counts: TraceCounts): ...

    return trace
