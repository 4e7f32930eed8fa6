"""Traversal of cut trees of the layout BOXES on a CPU: through the top level, through one treelet, or through all that
is there.

Rays are interleaved as in `cpu.py`, whose steps they take; closest-hit and any-hit rays are mixed. A ray that stops at
a treelet leaves nothing but its trail and the closest hit so far (`TopProgress`). To go on it descends again from the
root along its trail (Laine 2010, "Restart trail for stackless BVH traversal", here for wide nodes): at each level the
node is tested again, children that come before the one that the ray was in are dropped, those behind it wait.
"""

from __future__ import annotations

import functools

import warp as wp

from ...native.build import native_source
from ...rays import DeviceRayList, Rays
from ..tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Tree, Treelets
from ..treelets.links import TREELET_CHILD
from .counts import TraceCounts
from .cpu import boxes_defines, ray_headers
from .options import VisitOptions
from .task import task_defines


def boxes_visit_source(options: VisitOptions) -> str:
    """The body of the native function for `options`."""
    moves = "traverse/boxes/visit_moves.h"
    return native_source(
        *ray_headers(options),
        "traverse/boxes/visit.h",
        *(("traverse/boxes/tiers_names.h", moves, "traverse/boxes/tiers.h") if options.tiers else (moves,)),
        "traverse/boxes/visit_many.h",
        device="cpu",
        TREELETS=True,
        TOGETHER=options.takes_together,
        NEW=NEW,
        DONE=DONE,
        TREELET_CHILD=TREELET_CHILD,
        TRAIL_LEVELS=TRAIL_LEVELS,
        **task_defines(options.task),
        **boxes_defines(options),
    )


@functools.cache
def visit_function(options: VisitOptions) -> wp.Function:
    """Native function (tree, treelets, progress, rays, listed, first, end, counts).

    Does the task for the rays `listed.slots[first:end]`, which wait at `listed.locations[first:end]`, and writes there
    which location they came to. Rays that are done have their hits as `make_cpu_traversal` writes them; others what
    `TopProgress` says. `t_max` of a closest-hit ray is read when it is `NEW`, and may be the same memory as `hit_t`.
    What `TREELET` visits must be there. One thread runs it for all of them; on CUDA it does nothing. With counters it
    also writes `counts`, from 0 for rays that are `NEW`.
    """

    @wp.func_native(boxes_visit_source(options))
    def visit(
        tree: Tree,
        treelets: Treelets,
        progress: TopProgress,
        rays: Rays,
        listed: DeviceRayList,
        first: int,
        end: int,
        counts: TraceCounts,
    ): ...

    return visit
