"""Traversal of trees of the layout BOXES on a CPU: closest hit and any hit.

A ray visits wide nodes (Wald, Benthin and Boulos 2008, "Getting rid of packets") from near to far: eight boxes or eight
triangles at a time. One ray alone leaves most of the processor idle: each step waits for the one before, for memory, and
for branches that cannot be foretold (how many children are met, leaf or node, hit or miss). So one thread carries several
rays, and each round takes one step with every one of them, in loops over lists of rays that want the same: to visit a node, to test
a leaf, or to find something on their stack. Who comes on which list next is decided without branches; where a ray goes
next is asked for ahead, and is in the cache when its turn comes. Lists are made one round before they are read, so
that their lengths are known long before the processor has to know when a loop ends.

A ray's steps are the same whatever other rays are carried with it.
"""

from __future__ import annotations

import functools

import warp as wp

from .trace_counts import TraceCounts
from .traverse_cpu_text import WHOLE_TREE_TEXT, filled
from .tree import Tree
from .vector_text import INLINE, VECTOR_TEXT

INTERLEAVE = 16
"""Rays that one thread carries at a time."""

# One ray after another
_PLAIN_TEXT = """
    Ray ray;
    clear_stack(ray);
    for (int i = first; i < end; ++i) {
        for (int child = begin(ray, slots.data[i]) ? 0 : END; child != END;) {
            ray.child = child;
            ray.at = address(ray, child);
            if (child >= 0) {
                Floats enter;
                const unsigned met = meet(ray, ray.at, enter);
                const int* children = (const int*)(ray.at + 192);
                if (met != 0u) {
                    for (unsigned rest = met; rest; rest &= rest - 1u) ask_for(address(ray, children[__builtin_ctz(rest)]));
                    if ((met & (met - 1u)) == 0u) {
                        child = children[__builtin_ctz(met)];
                    } else {
                        ray.top += put_off(ray, ray.at, enter, met) - 1;
                        child = ray.waiting[ray.top];
                    }
                    continue;
                }
            } else if (child == LEAVE) {
                to_top(ray);
            } else if (!TWO_LEVEL || ray.entry >= 0) {
                test_leaf(ray);
            } else if (enter_tree(ray)) {
                child = 0;
                continue;
            }
            do --ray.top; while (ray.distance[ray.top] > ray.best);
            child = ray.waiting[ray.top];
        }
        finish(ray);
    }
"""

_INTERLEAVED_TEXT = """
    // Rays by what they do next: visit a node, test a leaf, look for something on the stack, enter a tree of the top level
    struct Lists { Ray *nodes[RAYS], *leaves[RAYS], *pops[RAYS], *entries[RAYS]; };
    Ray rays[RAYS];
    Lists lists[2];
    Lists *now = lists, *then = lists + 1;  // of this round and of the next one
    long long node_count = 0, leaf_count = 0, pop_count = 0, entry_count = 0;  // of the next one
    int taken = first;  // rays that have begun, of all
    auto take = [&](Ray& ray) INLINE {
        if (taken >= end) return;
        const int ahead = taken + RAYS;
        if (ahead < end) {
            const int slot = slots.data[ahead];
            __builtin_prefetch(&origin.data[slot]);
            __builtin_prefetch(&direction.data[slot]);
            __builtin_prefetch(&t_max.data[slot]);
            if (TWO_LEVEL) __builtin_prefetch(&visibility.data[slot]);
        }
        if (begin(ray, slots.data[taken++])) then->nodes[node_count++] = &ray;
        else then->pops[pop_count++] = &ray;  // finds the end
    };
    // `child` is next if `good` is 1. Every list gets the ray at its end, but only one end moves on.
    auto go = [&](Ray& ray, int child, long long good) INLINE {
        const char* p = address(ray, child);
        ask_for(p);
        ray.child = child;
        ray.at = p;
        const long long leaf = (long long)((unsigned)child >> 31) & good;
        const long long entry = TWO_LEVEL ? leaf & (long long)((unsigned)ray.entry >> 31) : 0;
        then->nodes[node_count] = &ray;
        node_count += good ^ leaf;
        then->leaves[leaf_count] = &ray;
        leaf_count += leaf ^ entry;
        then->pops[pop_count] = &ray;
        pop_count += 1 ^ good;
        if (TWO_LEVEL) {
            then->entries[entry_count] = &ray;
            entry_count += entry;
        }
    };
    // the highest on the stack is next, unless it is an end or beyond the closest hit
    auto go_on = [&](Ray& ray) INLINE {
        const int child = ray.waiting[ray.top - 1];
        const long long good = ray.distance[ray.top - 1] <= ray.best;
        ray.top -= good;
        go(ray, child, good);
    };
    for (int k = 0; k < RAYS; ++k) {
        clear_stack(rays[k]);
        take(rays[k]);
    }
    while (node_count + leaf_count + pop_count + entry_count) {
        const long long nodes = node_count, leaves = leaf_count, pops = pop_count, entries = entry_count;
        Lists* const next = now;
        now = then;
        then = next;
        node_count = leaf_count = pop_count = entry_count = 0;
        for (long long i = 0; i < nodes; ++i) {
            Ray& ray = *now->nodes[i];
            Floats enter;
            const unsigned met = meet(ray, ray.at, enter);
            ray.top += put_off(ray, ray.at, enter, met);
            go_on(ray);
        }
        for (long long i = 0; i < leaves; ++i) {
            Ray& ray = *now->leaves[i];
            test_leaf(ray);
            go_on(ray);
        }
        for (long long i = 0; TWO_LEVEL && i < entries; ++i) {
            Ray& ray = *now->entries[i];
            if (enter_tree(ray)) then->nodes[node_count++] = &ray; else go_on(ray);
        }
        for (long long i = 0; i < pops; ++i) {
            Ray& ray = *now->pops[i];
            const int child = pop(ray);
            if (__builtin_expect(child == END, 0)) {
                finish(ray);
                take(ray);
            } else if (TWO_LEVEL && child == LEAVE) {
                to_top(ray);
                go_on(ray);
            } else {
                go(ray, child, 1);
            }
        }
    }
"""

_EMPTY_TEXT = """
    if (empty) {
        Ray ray;
        for (int i = first; i < end; ++i) {
            reset(ray, slots.data[i]);
            finish(ray);
        }
        return;
    }
"""

# Lines that are there with counters alone
COUNTING = {
    "COUNTS_OF_RAY": "int node_steps, box_tests, triangle_tests;",
    "BEGIN_COUNTS": "ray.node_steps = ray.box_tests = ray.triangle_tests = 0;",
    "END_COUNTS": "counts.node_steps.data[slot] = ray.node_steps; counts.box_tests.data[slot] = ray.box_tests; "
    "counts.triangle_tests.data[slot] = ray.triangle_tests;",
    "COUNT_NODE": "++ray.node_steps; ray.box_tests += 8 - __builtin_popcount(negative(*(const Ints*)(p + 192) == all_ints(0x7fffffff)));",
    "COUNT_GROUP": "ray.triangle_tests += __builtin_popcount(there);",
}


def counting(counters: bool) -> dict[str, str]:
    """The lines of `COUNTING`, or none."""
    return {name: lines if counters else "" for name, lines in COUNTING.items()}


def traversal_text(any_hit: bool, instancing: bool, interleave: int, counters: bool) -> str:
    """The body of the native function."""
    constants = f"""
    constexpr bool ANY_HIT = {str(any_hit).lower()}, TWO_LEVEL = {str(instancing).lower()};
    constexpr int RAYS = {interleave};
    """
    text = constants + VECTOR_TEXT + WHOLE_TREE_TEXT + _EMPTY_TEXT + (_INTERLEAVED_TEXT if interleave > 1 else _PLAIN_TEXT)
    text = filled(text, counting(counters) | {"INLINE": INLINE})
    return f"\n#if !defined(__CUDA_ARCH__)\n{text}\n#endif\n"


@functools.cache
def make_cpu_traversal(any_hit: bool, instancing: bool, interleave: int = INTERLEAVE, counters: bool = False) -> wp.Function:
    """Native function (tree, origin, direction, t_max, visibility, hit_t, hit_instance, hit_primitive, hit_uv, slots, first, end), with
    counters also `counts` at the end.

    Traces the rays `slots[first:end]` of the arrays, which are those of `Rays`, and writes their hits: the distance [m], the instance
    (-1 for nothing), the primitive and the weights of its second and third corner; of any hit only `hit_instance`: 0, or -1
    for nothing. One thread runs it for all of them; on CUDA it does nothing.

    Args:
        any_hit: whether anything before `t_max` is asked for, instead of the closest hit.
        instancing: the tree has a top level; else one entry, in world space, that every ray sees.
        interleave: rays that are carried at a time, 1 to 64. The hits are the same.
        counters: also write `counts` (`TraceCounts`): nodes visited, boxes of children that there are, triangles that there are.
    """
    text = traversal_text(any_hit, instancing, interleave, counters)
    if counters:

        @wp.func_native(text)
        def trace_counted(
            tree: Tree,
            origin: wp.array(dtype=wp.vec3),
            direction: wp.array(dtype=wp.vec3),
            t_max: wp.array(dtype=float),
            visibility: wp.array(dtype=int),
            hit_t: wp.array(dtype=float),
            hit_instance: wp.array(dtype=int),
            hit_primitive: wp.array(dtype=int),
            hit_uv: wp.array(dtype=wp.vec2),
            slots: wp.array(dtype=int),
            first: int,
            end: int,
            counts: TraceCounts,
        ): ...

        return trace_counted

    @wp.func_native(text)
    def trace(
        tree: Tree,
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
        visibility: wp.array(dtype=int),
        hit_t: wp.array(dtype=float),
        hit_instance: wp.array(dtype=int),
        hit_primitive: wp.array(dtype=int),
        hit_uv: wp.array(dtype=wp.vec2),
        slots: wp.array(dtype=int),
        first: int,
        end: int,
    ): ...

    return trace
