"""Traversal of quantised trees that are cut into treelets: the tasks of batched tracing, for CUDA (and, one ray at a
time, for CPUs).

The same warps, steps and arithmetic as in `cuda.py`, on three levels: the top level over entries, the nodes of
a mesh above its treelets, and treelets, whose blocks lie anywhere. Rays that ask for the closest hit and for any hit
are mixed. A ray that comes to a treelet that it may not enter stops once no triangle waits, and leaves its *trail*:
which child it is in, level by level (Laine 2010, "Restart trail for stackless BVH traversal"). It goes on from the root
along the trail: at each node what comes after its way is put on the stack, if it is still met before the closest hit so
far.

A treelet's root is always there. Rays visit it before they stop, and do not stop if none of its children is met.

The top level has four ways (`TopLevelTraversal`). NAIVE and INTERLOCKED let each lane go its own way. SHORT_SEGMENT and
LONG_HAUL (section 6.1 of the thesis) make all lanes of a warp that visit a node in a turn visit the same one. What the
thesis leaves open is chosen so:

- Where rays part at an inner node, and which child comes first where their octants differ: each ray keeps the order of
  its own octant, so that it comes to the same treelets, from near to far, as alone. The warp elects, of the nodes that
  its rays want next, the one furthest down, and of those the one that most of them want. So it goes through what its
  rays want depth first, and rays that parted meet again. Other elections (most rays first, nearest to the root first,
  first those that are on the way down their trails) made warps read more nodes (docs/studies/top-level.md).
- A ray that does not want the node *sulks*: its lane waits, and does not test boxes that it cannot meet. It is carried
  along for nothing, but its own place in its own order stays exact.
- A bucket is met where a ray enters: one whose box is met, but none of whose root's children, is passed.
- SHORT_SEGMENT: when a ray enters a treelet, the segment of the whole warp ends. Others of its rays wait in the exit
  queue of that treelet, which they need not have come to: their trail ends where they are, with a mark
  (`together/cut.h`), and they go on from there. To move them on to the treelet itself, as the thesis has it, would pass
  over what comes before it in their own order. Rays on the way down a trail keep that trail.
- LONG_HAUL: a ray that enters a treelet is replaced at once, by the next of the batch. Batches have the rays of a queue
  side by side, so that the next one left the same treelet, or the one behind it. It starts at the root, as any, and the
  warp comes to it when it is through with the branch it is in.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import warp as wp

from ...native.build import native_source
from ...rays import DeviceRayList, Rays
from ..tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Tree, Treelets
from .counts import TraceCounts
from .cuda import NODE_HEADERS, STACK_MESH, lane_headers, quantised_defines
from .motion import motion_headers
from .options import VisitOptions
from .task import task_defines


def quantised_visit_source(options: VisitOptions) -> str:
    """The body of the native function for `options`."""
    if options.takes_together or options.replaces_at_once:
        options = replace(options, refill=1 if options.replaces_at_once else 32)
    levels = 2 * STACK_MESH if options.instancing else STACK_MESH  # of trees that the stack is made for
    loop, defines = ("traverse/quantised/loop.h",), {}
    if options.in_turns:
        cut = ("traverse/quantised/together/cut.h",) if options.writes_queues else ()
        loop = ("traverse/quantised/together/warp.h", *cut, "traverse/quantised/together/loop.h")
        defines = {
            "LANES": options.lanes,
            "NEW": NEW,
            "ELECTS": options.top_level.elects,
            "SHORT_SEGMENTS": options.writes_queues,
        }
    rays = "traverse/quantised/visit_rays.h"
    return native_source(
        *motion_headers(options),
        *NODE_HEADERS,
        "traverse/quantised/visit_lane.h",
        *lane_headers(options),
        *(("traverse/quantised/tiers_names.h", rays, "traverse/quantised/tiers.h") if options.tiers else (rays,)),
        "traverse/quantised/visit_steps.h",
        *loop,
        "traverse/quantised/visit_end.h",
        EVERY_TRIANGLE=False,
        DONE=DONE,
        TRAIL_SIZE=levels + 1,
        TRAIL_LEVELS=TRAIL_LEVELS,
        **task_defines(options.task),
        **quantised_defines(options),
        **defines,
    )


@functools.cache
def quantised_visit_function(options: VisitOptions) -> wp.Function:
    """Native function (tree, treelets, progress, rays, listed, cursor, thread, counts).

    Does the task for the rays of `listed`, which wait at `listed.locations`, and writes there which location they came
    to. Rays that are done have their hits as `trace_function` writes them; others what `TopProgress` says. `t_max` of a
    closest-hit ray is read when it is `NEW`, and may be the same memory as `hit_t`. All threads of all warps call it,
    with their numbers. `cursor[0]` is 0 before. What `TREELET` visits must be there. With counters also writes
    `counts`.
    """

    @wp.func_native(quantised_visit_source(options))
    def visit(
        tree: Tree,
        treelets: Treelets,
        progress: TopProgress,
        rays: Rays,
        listed: DeviceRayList,
        cursor: wp.array(dtype=int),
        thread: int,
        counts: TraceCounts,
    ): ...

    return visit
