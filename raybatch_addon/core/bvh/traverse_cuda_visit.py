"""Traversal of quantised trees that are cut into treelets: the tasks of batched tracing, for CUDA (and, one ray at a time, for CPUs).

The same warps, steps and arithmetic as in `traverse_cuda.py`, on three levels: the top level over entries, the nodes of a mesh above its
treelets, and treelets, which lie anywhere. Rays that ask for the closest hit and for any hit are mixed. A ray that comes to a treelet
that it may not enter stops once no triangle waits, and leaves its *trail*: which child it is in, level by level (Laine 2010, "Restart trail
for stackless BVH traversal"). It goes on from the root along the trail: at each node what comes after its way is put on the
stack, if it is still met before the closest hit so far.

A treelet's root is always there. Rays visit it before they stop, and do not where none of its children is met.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from string import Template

import warp as wp

from .intersect import TRIANGLE_TEXT
from .trace_counts import TraceCounts
from .traverse_cuda import COUNTING, LOOP_TEXT, STACK_ALL, STACK_MESH, loop_pieces
from .traverse_cuda_text import DEVICE_TEXT, IDENTIFY_TEXT, MAKE_RAY_TEXT, NODE_TEXT, RAY_TEXT, TEST_TEXT
from .traverse_cuda_visit_text import VISIT_RAY_TEXT, VISIT_STATE_TEXT, VISIT_STEP_TEXT
from .tree import DONE, TRAIL_LEVELS, TopProgress, Tree, Treelets
from .visit_task import VisitTask

_TASKS = (VisitTask.TOP, VisitTask.TREELET, VisitTask.GO_ON)


@dataclass(frozen=True)
class VisitOptions:
    """What a visit is compiled for."""

    task: VisitTask
    instancing: bool  # a top level over many entries, instead of one entry in world space
    counters: bool = False  # count steps (`TraceCounts`)
    refill: int = 8  # lanes that must wait before a warp takes new rays, 1..32
    single_lane: bool = False  # one ray at a time: the first of a single warp's lanes alone takes rays

    def __post_init__(self) -> None:
        if not 1 <= self.refill <= 32:
            raise ValueError("refill is 1..32")


_PIECES = {
    "go_to_top": "nodes = resident_nodes + 5ull * (unsigned)tree.top_node;",
    "go_to_entry": "nodes = resident_nodes + 5ull * (unsigned)tree.entry_node.data[entry]; "
    "triangles = resident_triangles + 3ull * (unsigned)tree.entry_triangle.data[entry];",
    "in_top": "!(state & IN_MESH)",
    "in_mesh": "(state & IN_MESH)",
    "make_ray": "if (state & TURNED) { make_ray(); state ^= TURNED; }",
    "any_hit": "slot >= any_first",
    "end_any_hit": "treelet = -1; state = STOPPED;",
    # a treelet's root waits until no triangle does: its own are elsewhere
    "turn": "if (node != NONE && (in_mesh && !(state & AT_ROOT) ? later.y : leaf.y) == 0u) visit(); if (in_mesh && leaf.y) test();",
}

# Where kernels with counters have more, or something else, than `COUNTING`
_VISIT_COUNTING = {
    "count_begin": """visits = boxes = tests = entered = 0;
        if (place < 0) {
            counts.node_steps.data[slot] = counts.box_tests.data[slot] = counts.triangle_tests.data[slot] = 0;
            counts.treelet_visits.data[slot] = counts.queued.data[slot] = 0;
        }""",
    "count_ray": """counts.node_steps.data[slot] += visits; counts.box_tests.data[slot] += boxes; counts.triangle_tests.data[slot] += tests;
        counts.treelet_visits.data[slot] += entered; counts.queued.data[slot] += treelet >= 0 ? 1 : 0;""",
    "count_treelet": "++entered;",
}

_END_TEXT = """
    #if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step >>= 1) visit_count += __shfl_xor_sync(ALL_LANES, visit_count, step);
    if (lanes_below() == 0u && visit_count) atomicAdd((unsigned long long*)progress.visits.data, (unsigned long long)visit_count);
    #else
    progress.visits.data[0] += visit_count;
    #endif
"""


def visit_text(options: VisitOptions) -> str:
    """The body of the native function for `options`."""
    refill = 32 if options.single_lane else options.refill
    constants = f"""
    constexpr bool TWO_LEVEL = {str(options.instancing).lower()};
    constexpr int TOP = 0, TREELET = 1, GO_ON = 2, TASK = {_TASKS.index(options.task)};
    constexpr int REFILL = {refill}, DONE = {DONE};
    """
    parts = (
        constants, TRIANGLE_TEXT, DEVICE_TEXT, RAY_TEXT, NODE_TEXT, VISIT_STATE_TEXT, IDENTIFY_TEXT, MAKE_RAY_TEXT, VISIT_RAY_TEXT,
        TEST_TEXT, VISIT_STEP_TEXT, LOOP_TEXT, _END_TEXT,
    )  # fmt: skip
    counting = COUNTING | _VISIT_COUNTING
    counting["counters"] += " int entered = 0;"
    pieces = {name: piece if options.counters else "" for name, piece in counting.items()}
    pieces |= loop_pieces(options.single_lane, "mine", "thread")
    levels = 2 * STACK_MESH if options.instancing else STACK_MESH  # of trees that the stack is made for
    sizes = {"stack_size": STACK_ALL if options.instancing else STACK_MESH, "trail_size": levels + 1, "trail_levels": TRAIL_LEVELS}
    return Template("".join(parts)).substitute(**sizes, **pieces, **_PIECES)


@functools.cache
def quantised_visit_function(options: VisitOptions) -> wp.Function:
    """Native function (tree, treelets, progress, origin, direction, t_max, visibility, hit_t, hit_instance, hit_primitive, hit_uv, slots,
    where, count, cursor, any_first, thread), with counters also `counts` at the end.

    Does the task for the rays `slots[0 : count[0]]` of the arrays, which are those of `Rays`, that wait at `where[0 : count[0]]`, and
    writes there where they came to. Rays in slots from `any_first` on ask for any hit. Rays that are done have their hits as
    `trace_function` writes them; others what `TopProgress` says. `t_max` of a closest-hit ray is read when it is `NEW`, and may be
    the same memory as `hit_t`. All threads of all warps call it, with their numbers. `cursor[0]` is 0 before. What `TREELET` visits
    must be there.
    """
    text = visit_text(options)
    if options.counters:

        @wp.func_native(text)
        def visit_counted(
            tree: Tree,
            treelets: Treelets,
            progress: TopProgress,
            origin: wp.array(dtype=wp.vec3),
            direction: wp.array(dtype=wp.vec3),
            t_max: wp.array(dtype=float),
            visibility: wp.array(dtype=int),
            hit_t: wp.array(dtype=float),
            hit_instance: wp.array(dtype=int),
            hit_primitive: wp.array(dtype=int),
            hit_uv: wp.array(dtype=wp.vec2),
            slots: wp.array(dtype=int),
            where: wp.array(dtype=int),
            count: wp.array(dtype=int),
            cursor: wp.array(dtype=int),
            any_first: int,
            thread: int,
            counts: TraceCounts,
        ): ...

        return visit_counted

    @wp.func_native(text)
    def visit(
        tree: Tree,
        treelets: Treelets,
        progress: TopProgress,
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
        visibility: wp.array(dtype=int),
        hit_t: wp.array(dtype=float),
        hit_instance: wp.array(dtype=int),
        hit_primitive: wp.array(dtype=int),
        hit_uv: wp.array(dtype=wp.vec2),
        slots: wp.array(dtype=int),
        where: wp.array(dtype=int),
        count: wp.array(dtype=int),
        cursor: wp.array(dtype=int),
        any_first: int,
        thread: int,
    ): ...

    return visit
