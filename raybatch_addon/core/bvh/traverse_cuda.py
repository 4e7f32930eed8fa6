"""Traversal of quantised trees: closest hit and any hit, for CUDA (and, one ray at a time, for CPUs).

The nodes are those of Ylitie, Karras and Laine 2017 ("Efficient incoherent ray traversal on GPUs through compressed
wide BVHs"). Warps are persistent: a lane whose ray is done takes the next one from the list as soon as enough lanes
wait for that (Aila and Laine 2009, "Understanding the efficiency of ray traversal on GPUs"). In each turn of the loop
a lane tests one triangle and visits one node; a second group of triangles may wait, so that lanes with many triangles
do not hold up the others. Which lane takes which ray, and when, changes nothing: a ray's closest hit is the lexicographic
minimum of (t, instance, primitive) over all triangles, whatever the order of visits.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from string import Template

import warp as wp

from .intersect import TRIANGLE_TEXT
from .trace_counts import TraceCounts
from .traverse_cuda_text import DEVICE_TEXT, LANE_TEXT, NODE_TEXT, RAY_TEXT
from .tree import Tree

BLOCK_SIZE = 128
"""Threads of a block; `wp.launch` is told so with every launch."""

# Levels of a mesh tree and of the top level: each has at most one group of nodes on the stack, the top level one of entries too
STACK_MESH, STACK_ALL = 64, 129


@dataclass(frozen=True)
class TraceOptions:
    """What a traversal is compiled for."""

    any_hit: bool  # whether anything is hit, instead of the closest hit
    instancing: bool  # a top level over many entries, instead of one entry in world space
    counters: bool = False  # count steps (`TraceCounts`)
    refill: int = 8  # lanes that must wait before a warp takes new rays, 1..32; 0: plainly, one thread a ray
    leaf_groups: int = 2  # groups of triangles that may wait while nodes are visited, 1 or 2
    every_triangle: bool = False  # test all waiting triangles in each turn, instead of one
    single_lane: bool = False  # one ray at a time: the first of a single warp's lanes alone takes rays (`refill` is not 0)

    def __post_init__(self) -> None:
        if not (0 <= self.refill <= 32 and self.leaf_groups in (1, 2)):
            raise ValueError("refill is 0..32, leaf_groups 1 or 2")
        if self.single_lane and not self.refill:
            raise ValueError("a single lane takes rays from the list: refill must not be 0")


LOOP_TEXT = """
    const int ray_count = count.data[0];
    bool more = true;  // the list has rays that no lane has taken
    auto is_alive = [&]() -> bool { return node != NONE || leaf.y != 0u; };
    for (;;) {
        if (REFILL > 0) {
            const unsigned idle = ballot(!is_alive());
            const int wanted = $wanted;
            if (idle == ALL_LANES || (more && wanted >= REFILL)) {
                if (!is_alive() && slot >= 0) finish();
                if (!more) break;
                int first = 0;
    #if defined(__CUDA_ARCH__)
                if (lanes_below() == 0u) first = atomicAdd(cursor.data, wanted);
                first = __shfl_sync(ALL_LANES, first, 0);
    #else
                first = cursor.data[0];
                cursor.data[0] += wanted;
    #endif
                const int mine = first + bit_count(idle & lanes_below());
                if (!is_alive() && mine < $mine_end) take($mine);
                more = first + wanted < ray_count;
            }
        } else if (!is_alive()) {
            if (slot >= 0) { finish(); break; }
            if (thread >= ray_count) break;
            take($thread);
        }
        $count_turn
        if (TWO_LEVEL && is_alive()) {
            if ($in_top && leaf.y) enter();
            $make_ray
        }
        const bool in_mesh = !TWO_LEVEL || $in_mesh;
        $turn
        if (node == NONE) choose();
    }
    $count_end
"""


def _turn_text(options: TraceOptions) -> str:
    room = "later.y == 0u" if options.leaf_groups == 2 else "leaf.y == 0u"
    test = f"{'while' if options.every_triangle else 'if'} (in_mesh && leaf.y) test();"
    return f"if (node != NONE && (in_mesh ? {room} : leaf.y == 0u)) visit(); {test}"


_TRACE_PIECES = {
    "go_to_top": "first_node = tree.top_node; first_triangle = 0u;",
    "go_to_entry": "first_node = tree.entry_node.data[entry]; first_triangle = tree.entry_triangle.data[entry];",
    "in_top": "entry < 0",
    "in_mesh": "entry >= 0",
    "make_ray": "if (turned) make_ray(); turned = false;",
    "any_hit": "ANY_HIT",
    "end_any_hit": "",
}

# Pieces of counting code, put in for kernels with counters alone
COUNTING = {
    "counters": """int visits = 0, boxes = 0, tests = 0;
    unsigned lanes_busy[3] = {0u, 0u, 0u}, lanes_there[3] = {0u, 0u, 0u};
    // every lane that comes here is busy; one of them counts all lanes of the warp
    auto count_lanes = [&](int what, bool busy) {
    #if defined(__CUDA_ARCH__)
        const unsigned together = __activemask();
        lanes_there[what] += (together & lanes_below()) == 0u ? 32u : 0u;
    #else
        lanes_there[what] += 1u;
    #endif
        lanes_busy[what] += busy ? 1u : 0u;
    };""",
    "count_begin": "visits = boxes = tests = 0;",
    "count_ray": "counts.node_steps.data[slot] = visits; counts.box_tests.data[slot] = boxes; counts.triangle_tests.data[slot] = tests;",
    "count_turn": "count_lanes(0, is_alive());",
    "count_visit": "count_lanes(1, true); ++visits; boxes += bit_count((b.z >> 5) & 0x01010101u) + bit_count((b.w >> 5) & 0x01010101u);",
    "count_test": "count_lanes(2, true); ++tests;",
    "count_end": """for (int k = 0; k < 3; ++k) {
    #if defined(__CUDA_ARCH__)
        atomicAdd((unsigned long long*)counts.lanes.data + 2 * k, (unsigned long long)lanes_busy[k]);
        atomicAdd((unsigned long long*)counts.lanes.data + 2 * k + 1, (unsigned long long)lanes_there[k]);
    #else
        counts.lanes.data[2 * k] += lanes_busy[k];
        counts.lanes.data[2 * k + 1] += lanes_there[k];
    #endif
    }""",
}


def loop_pieces(single_lane: bool, mine: str = "slots.data[mine]", thread: str = "slots.data[thread]") -> dict[str, str]:
    """What `LOOP_TEXT` takes rays by."""
    if not single_lane:
        return {"wanted": "bit_count(idle)", "mine": mine, "mine_end": "ray_count", "thread": thread}
    return {"wanted": "1", "mine": mine, "mine_end": "(thread == 0 ? ray_count : 0)", "thread": thread}


def trace_text(options: TraceOptions) -> str:
    """The body of the native function for `options`."""
    refill = 32 if options.single_lane else options.refill
    constants = f"""
    constexpr bool ANY_HIT = {str(options.any_hit).lower()}, TWO_LEVEL = {str(options.instancing).lower()};
    constexpr int REFILL = {refill};
    """
    text = constants + TRIANGLE_TEXT + DEVICE_TEXT + RAY_TEXT + NODE_TEXT + LANE_TEXT + LOOP_TEXT
    pieces = {name: piece if options.counters else "" for name, piece in COUNTING.items()}
    pieces |= loop_pieces(options.single_lane) | _TRACE_PIECES
    stack_size = STACK_ALL if options.instancing else STACK_MESH
    return Template(text).substitute(stack_size=stack_size, turn=_turn_text(options), **pieces)


@functools.cache
def trace_function(options: TraceOptions) -> wp.Function:
    """Native function (tree, origin, direction, t_max, visibility, hit_t, hit_instance, hit_primitive, hit_uv, slots, count, cursor,
    thread), with counters also `counts` at the end.

    Traces the rays `slots[0 : count[0]]` of the arrays, which are those of `Rays`, and writes their hits. Of any hit only
    `hit_instance` is written: 0, or -1 for nothing. All threads of all warps call it, with their numbers. `cursor[0]` is 0 before.
    """
    text = trace_text(options)
    if options.counters:

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
            count: wp.array(dtype=int),
            cursor: wp.array(dtype=int),
            thread: int,
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
        count: wp.array(dtype=int),
        cursor: wp.array(dtype=int),
        thread: int,
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
    return persistent_count(ray_bound, device, BLOCK_SIZE, blocks)


def persistent_count(ray_bound: int, device: wp.Device, block_size: int, blocks: int = 16) -> int:
    """Threads of persistent warps on CUDA for at most `ray_bound` rays: as many as in `blocks` blocks of `BLOCK_SIZE` a multiprocessor."""
    needed = -(-ray_bound // block_size)
    return min(needed, -(-device.sm_count * blocks * BLOCK_SIZE // block_size)) * block_size
