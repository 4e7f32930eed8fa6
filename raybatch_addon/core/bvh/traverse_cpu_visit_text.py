"""Native text for rays in cut trees of the layout BOXES: how a ray begins, stops at a treelet, and goes on behind it.

`traverse_cpu_visit.py` puts these parts together with those of `traverse_cpu_text.py`.
"""

from __future__ import annotations

from .tree import DONE, NEW, TRAIL_LEVELS
from .treelets import TREELET_CHILD

# What kernels of cut trees put in place of these words
WORDS = {
    "NODES_OF_RAY": "ray.nodes",
    "TRIANGLES_OF_RAY": "ray.triangles",
    "NODE_OF_CHILD": "(child & NODE_BITS)",
    "KEEP_PLACES": " if (PLACES) *(LooseInts*)(ray.places + ray.top) = (key & 7) + all_ints((ray.place & ~7) + 8);",
    "ASKS_ANY": "ray.any",
}

RAY_FIELDS = """
        bool any;              // asks whether anything is hit
        int index;             // in the batch
        int face_before, entry_before;  // the closest hit as it was read; no triangle has the number -2
        // A place is level * 8 + slot of a child in the resident node that holds it, levels from the root on; -8 is the root's
        int place;             // of the child taken last
        int treelet, treelet_place;  // that the ray is in
        unsigned char path[PATH_FIRST + 192];  // slot taken at each level, from PATH_FIRST on; what the root writes is before
        alignas(64) int places[PLACES ? STACK : 16];  // of waiting children
"""

COUNTING = {
    "COUNTS_OF_RAY": "int node_steps, box_tests, triangle_tests, entered; bool counts_begin;",
    "BEGIN_COUNTS": "ray.node_steps = ray.box_tests = ray.triangle_tests = ray.entered = 0; ray.counts_begin = fresh;",
    "END_COUNTS": """
        auto add = [&](int* sum, int more) { *sum = (ray.counts_begin ? 0 : *sum) + more; };
        add(&counts.node_steps.data[slot], ray.node_steps); add(&counts.box_tests.data[slot], ray.box_tests);
        add(&counts.triangle_tests.data[slot], ray.triangle_tests); add(&counts.treelet_visits.data[slot], ray.entered);
        add(&counts.queued.data[slot], out >= 0 ? 1 : 0);""",
    "COUNT_ENTERED": "++ray.entered;",
    "COUNT_WAITING": "++counts.queued.data[slot];",
}
"""Lines that are there with counters alone, as far as they differ from those of whole trees."""

CONSTANTS_TEXT = f"""
    constexpr int NEW = {NEW}, DONE = {DONE}, TREELET_CHILD = {TREELET_CHILD:#x}, TRAIL_LEVELS = {TRAIL_LEVELS}, PATH_FIRST = 8;
    constexpr int TOP = 0, TREELET = 1, GO_ON = 2;
    constexpr bool PLACES = TASK != TREELET;  // whether rays must know where in the top level they are
    constexpr int NODE_BITS = PLACES ? ~TREELET_CHILD : -1;
"""

STATE_TEXT = """
    constexpr int BACK = LEAVE + 1;  // on the stack: the ray goes back from a treelet to the resident nodes of its mesh
    // Six slots, a byte each, to and from a word of a trail
    auto packed = [](const unsigned char* slots) INLINE -> unsigned {
    #if defined(__BMI2__)
        unsigned long long bytes;
        __builtin_memcpy(&bytes, slots, 8);
        return (unsigned)__builtin_ia32_pext_di(bytes, 0x1f1f1f1f1f1full);
    #else
        unsigned word = 0;
        for (int k = 0; k < TRAIL_LEVELS; ++k) word |= (unsigned)slots[k] << (5 * k);
        return word;
    #endif
    };
    auto unpack = [](unsigned word, unsigned char* slots) INLINE {
    #if defined(__BMI2__)
        const unsigned long long bytes = __builtin_ia32_pdep_di(word, 0x1f1f1f1f1f1full);
        __builtin_memcpy(slots, &bytes, 8);
    #else
        for (int k = 0; k < TRAIL_LEVELS; ++k) slots[k] = word >> (5 * k) & 31;
    #endif
    };
    auto trail_word = [&](int word, int slot) INLINE -> unsigned* {
        return (unsigned*)((char*)progress.trail.data + (long long)word * progress.trail.strides[0]) + slot;
    };
    long long visits = 0;  // to treelets whose triangles are there

    // What is asked of the ray, and what it has met so far
    auto load = [&](Ray& ray, int index, int slot, bool fresh) INLINE {
        ray.index = index;
        ray.slot = slot;
        ray.any = slot >= any_first;
        ray.top = 8;
        ray.face = -1;
        ray.face_before = -2;
        ray.hit_entry = ray.entry_before = 0;
        ray.v = ray.w = 0.0f;
        ray.place = -8;
        if (fresh || ray.any) {
            const float limit = t_max.data[slot];
            ray.best = limit > 0.0f ? limit : 0.0f;  // also where it is NaN, which would not end
        } else {
            ray.best = hit_t.data[slot];
            ray.face = ray.face_before = hit_primitive.data[slot];
            ray.hit_entry = ray.entry_before = hit_instance.data[slot];
        }
        BEGIN_COUNTS
    };
    // The ray's task is done, and it waits at `out`, a treelet whose root has this place, or is DONE
    auto stop = [&](Ray& ray, int out, int place) INLINE {
        const int slot = ray.slot;
        END_COUNTS
        where.data[ray.index] = out;
        if (PLACES && out >= 0) {
            if (TWO_LEVEL) progress.entry.data[slot] = ray.entry;
            const int levels = (place >> 3) + 1;
            for (int k = 0; TRAIL_LEVELS * k < levels; ++k) *trail_word(k, slot) = packed(ray.path + PATH_FIRST + TRAIL_LEVELS * k);
        }
        if (ray.any) {
            if (out == DONE) hit_instance.data[slot] = ray.face < 0 ? -1 : 0;
            return;
        }
        const bool changed = ray.face != ray.face_before || (TWO_LEVEL && ray.hit_entry != ray.entry_before);
        if (!changed && out != DONE) return;
        int instance = -1, primitive = ray.face;
        if (ray.face >= 0) {
            instance = TWO_LEVEL ? ray.hit_entry : 0;
            if (out == DONE) identify(instance, ray.face, instance, primitive);
        }
        hit_instance.data[slot] = instance;
        hit_primitive.data[slot] = primitive;
        if (!changed) return;
        hit_t.data[slot] = ray.best;
        hit_uv.data[slot] = wp::vec_t<2, float>(ray.v, ray.w);
    };
    // At the root of the top level; whether the ray can be traced
    auto set_top = [&](Ray& ray) INLINE -> bool {
        const auto& p = origin.data[ray.slot];
        const auto& v = direction.data[ray.slot];
        const auto& c = tree.top_centre;
        const bool sound = set_slabs(
            ray.top_slabs, FourFloats{p[0], p[1], p[2], 0.0f}, FourFloats{v[0], v[1], v[2], 0.0f}, FourFloats{c[0], c[1], c[2], 0.0f},
            tree.top_margin);
        to_top(ray);
        ray.at = ray.nodes;
        ray.child = 0;
        return sound;
    };
    // At the root of the mesh tree of `entry`
    auto set_mesh = [&](Ray& ray, int entry) INLINE -> bool {
        const bool sound = set_entry(ray, entry);
        if (!TWO_LEVEL) { ray.nodes = ONLY_NODES; ray.triangles = ONLY_TRIANGLES; }
        return sound;
    };
    // Back to the resident nodes of the mesh
    auto to_mesh = [&](Ray& ray) INLINE {
        ray.nodes = TWO_LEVEL ? NODES + 256ll * tree.entry_node.data[ray.entry] : ONLY_NODES;
        ray.triangles = TWO_LEVEL ? TRIANGLES + 320ll * tree.entry_triangle.data[ray.entry] : ONLY_TRIANGLES;
    };
    // Into the blocks of a treelet
    auto to_treelet = [&](Ray& ray, int treelet) INLINE {
        ray.nodes = (const char*)treelets.nodes.data[treelet];
        ray.triangles = (const char*)treelets.triangles.data[treelet];
        ray.treelet = treelet;
        ray.treelet_place = ray.place;
        if (ray.triangles) { ++visits; COUNT_ENTERED }
    };
    // the treelet that the mesh tree of `entry` is as a whole, or -1
    auto whole_treelet = [&](int entry) INLINE -> int { return treelets.of_node.data[tree.entry_node.data[entry]]; };
    auto push = [&](Ray& ray, int child, float distance) INLINE {
        ray.waiting[ray.top] = child;
        ray.places[ray.top] = ray.place;
        ray.distance[ray.top++] = distance;
    };
    auto clear_places = [&](Ray& ray) INLINE {
        clear_stack(ray);
        for (int k = 0; k < 8; ++k) ray.places[k] = -8;
    };
"""

EMPTY_TEXT = """
    if (empty) {
        Ray ray;
        for (int i = first; i < end; ++i) {
            if (where.data[i] == DONE) continue;
            load(ray, i, slots.data[i], where.data[i] == NEW);
            stop(ray, DONE, -8);
        }
        return;
    }
"""
