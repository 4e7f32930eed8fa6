// How rays begin, stop at a treelet, and go on behind it, in trees of the layout BOXES that are cut into treelets.

constexpr int BACK = LEAVE + 1;  // on the stack: the ray goes back from a treelet to the resident nodes of its mesh
// Six child slots, a byte each, to and from a word of a trail
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
    ray.any = slot >= listed.any_first;
    ray.top = 8;
    ray.face = -1;
    ray.face_before = -2;
    ray.hit_entry = ray.entry_before = 0;
    ray.v = ray.w = 0.0f;
    ray.trail_code = -8;
    if (fresh || ray.any) {
        const float limit = rays.t_max.data[slot];
        ray.best = limit > 0.0f ? limit : 0.0f;  // also for NaN, with which the loop would not end
    } else {
        ray.best = rays.hit_t.data[slot];
        ray.face = ray.face_before = rays.hit_primitive.data[slot];
        ray.hit_entry = ray.entry_before = rays.hit_instance.data[slot];
    }
#if COUNTERS
    ray.node_steps = ray.box_tests = ray.triangle_tests = ray.entered = 0;
    ray.counts_begin = fresh;
#endif
};
// The ray's task is done, and it waits at `out`: DONE, or a treelet whose root has this trail code
auto stop = [&](Ray& ray, int out, int trail_code) INLINE {
    const int slot = ray.slot;
#if COUNTERS
    auto add = [&](int* sum, int more) { *sum = (ray.counts_begin ? 0 : *sum) + more; };
    add(&counts.node_steps.data[slot], ray.node_steps);
    add(&counts.box_tests.data[slot], ray.box_tests);
    add(&counts.triangle_tests.data[slot], ray.triangle_tests);
    add(&counts.treelet_visits.data[slot], ray.entered);
    add(&counts.queued.data[slot], out >= 0 ? 1 : 0);
#endif
    listed.locations.data[ray.index] = out;
    if (KEEPS_TRAIL && out >= 0) {
        if (TWO_LEVEL) progress.entry.data[slot] = ray.entry;
        const int levels = (trail_code >> 3) + 1;
        for (int k = 0; TRAIL_LEVELS * k < levels; ++k)
            *trail_word(k, slot) = packed(ray.path + PATH_FIRST + TRAIL_LEVELS * k);
    }
    if (ray.any) {
        if (out == DONE) rays.hit_instance.data[slot] = ray.face < 0 ? -1 : 0;
        return;
    }
    const bool changed = ray.face != ray.face_before || (TWO_LEVEL && ray.hit_entry != ray.entry_before);
    if (!changed && out != DONE) return;
    int instance = -1, primitive = ray.face;
    if (ray.face >= 0) {
        instance = TWO_LEVEL ? ray.hit_entry : 0;
        if (out == DONE) identify(instance, ray.face, instance, primitive);
    }
    rays.hit_instance.data[slot] = instance;
    rays.hit_primitive.data[slot] = primitive;
    if (!changed) return;
    rays.hit_t.data[slot] = ray.best;
    rays.hit_uv.data[slot] = wp::vec_t<2, float>(ray.v, ray.w);
};
// At the root of the mesh tree of `entry`; whether the ray can be traced
auto set_mesh = [&](Ray& ray, int entry) INLINE -> bool {
    const bool sound = set_entry(ray, entry);
    if (!TWO_LEVEL) {
        ray.nodes = ONLY_NODES;
        ray.triangles = ONLY_TRIANGLES;
    }
    return sound;
};
// Back to the resident nodes of the mesh
auto to_mesh = [&](Ray& ray) INLINE {
    ray.nodes = TWO_LEVEL ? NODES + NODE * tree.entry_node.data[ray.entry] : ONLY_NODES;
    ray.triangles = TWO_LEVEL ? TRIANGLES + GROUP * tree.entry_triangle.data[ray.entry] : ONLY_TRIANGLES;
#if MOTION
    set_between(ray, tree.entry_deform.data[ray.entry]);
#endif
};
// Into the blocks of a treelet
auto to_treelet = [&](Ray& ray, int treelet) INLINE {
    ray.nodes = (const char*)treelets.nodes.data[treelet];
    ray.triangles = (const char*)treelets.triangles.data[treelet];
#if MOTION
    set_between(ray, treelets.deform.data[treelet]);
#endif
    ray.treelet = treelet;
    ray.treelet_trail_code = ray.trail_code;
    if (ray.triangles) {
        ++visits;
#if COUNTERS
        ++ray.entered;
#endif
    }
};
// The treelet that the mesh tree of `entry` is as a whole, or -1
auto whole_treelet = [&](int entry) INLINE -> int { return treelets.of_node.data[tree.entry_node.data[entry]]; };
auto is_absent = [&](int treelet) INLINE -> bool { return treelets.nodes.data[treelet] == 0; };
auto push = [&](Ray& ray, int child, float distance) INLINE {
    ray.waiting[ray.top] = child;
    ray.trail_codes[ray.top] = ray.trail_code;
    ray.distance[ray.top++] = distance;
};
if (empty) {
    Ray ray;
    for (int i = first; i < end; ++i) {
        if (listed.locations.data[i] == DONE) continue;
        load(ray, i, listed.slots.data[i], listed.locations.data[i] == NEW);
        stop(ray, DONE, -8);
    }
    return;
}
