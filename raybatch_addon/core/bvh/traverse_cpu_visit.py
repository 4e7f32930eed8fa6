"""Traversal of cut trees of the layout BOXES on a CPU: through the top level, through one treelet, or through all that is there.

The rays of a batch are interleaved as in `traverse_cpu.py`, whose steps they take; closest-hit and any-hit rays are mixed. A
ray that stops at a treelet leaves nothing but its trail and the closest hit so far (`TopProgress`). To go on it descends again from
the root along its trail (Laine 2010, "Restart trail for stackless BVH traversal", here for wide nodes): at each level the
node is tested again, children that come before the one that the ray was in are dropped, those behind it wait.
"""

from __future__ import annotations

import functools

import warp as wp

from .trace_counts import TraceCounts
from .traverse_cpu import INTERLEAVE, counting
from .traverse_cpu_text import IDENTIFY_TEXT, POP_TEXT, RAY_TEXT, STEP_TEXT, TO_TOP_TEXT, filled
from .traverse_cpu_visit_loop import LOOP_TEXT
from .traverse_cpu_visit_text import CONSTANTS_TEXT, COUNTING, EMPTY_TEXT, RAY_FIELDS, STATE_TEXT, WORDS
from .tree import TopProgress, Tree, Treelets
from .vector_text import INLINE, VECTOR_TEXT
from .visit_task import VisitTask

_TASKS = (VisitTask.TOP, VisitTask.TREELET, VisitTask.GO_ON)  # in the order of the text's constants


def visit_text(task: VisitTask, instancing: bool, interleave: int, counters: bool, interlocked: bool) -> str:
    """The body of the native function."""
    together = interlocked and task is VisitTask.TOP
    constants = f"""
    constexpr bool TWO_LEVEL = {str(instancing).lower()}, TOGETHER = {str(together).lower()};
    constexpr int RAYS = {interleave}, TASK = {_TASKS.index(task)};
    """
    lines = counting(counters) | {name: line if counters else "" for name, line in COUNTING.items()}
    lines["COUNTS_OF_RAY"] = RAY_FIELDS + lines["COUNTS_OF_RAY"]
    text = constants + CONSTANTS_TEXT + VECTOR_TEXT + RAY_TEXT + TO_TOP_TEXT + IDENTIFY_TEXT + STEP_TEXT + POP_TEXT + STATE_TEXT
    text = filled(text + EMPTY_TEXT + LOOP_TEXT, WORDS | lines | {"INLINE": INLINE})
    return f"\n#if !defined(__CUDA_ARCH__)\n{text}\n#endif\n"


@functools.cache
def visit_function(
    task: VisitTask, instancing: bool, interleave: int = INTERLEAVE, counters: bool = False, interlocked: bool = False
) -> wp.Function:
    """Native function (tree, treelets, progress, origin, direction, t_max, visibility, hit_t, hit_instance, hit_primitive, hit_uv, slots,
    where, first, end, any_first), with counters also `counts` at the end.

    Does the task for the rays `slots[first:end]` of the arrays, which are those of `Rays`, that wait at `where[first:end]`, and writes there
    where they came to. Rays in slots from `any_first` on ask for any hit. Rays that are done have their hits as
    `make_cpu_traversal` writes them; others what `TopProgress` says. `t_max` of a closest-hit ray is read when it is `NEW`, and may be
    the same memory as `hit_t`. What `TREELET` visits must be there. One thread runs it for all of them; on CUDA it does nothing.

    Args:
        instancing: the tree has a top level; else one entry, in world space, that every ray sees.
        interleave: rays that are carried at a time, 1 to 64. The hits are the same.
        counters: also write `counts` (`TraceCounts`), from 0 for rays that are `NEW`.
        interlocked: in TOP, new rays are taken only when all that are carried have stopped.
    """
    text = visit_text(task, instancing, interleave, counters, interlocked)
    if counters:

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
            first: int,
            end: int,
            any_first: int,
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
        first: int,
        end: int,
        any_first: int,
    ): ...

    return visit
