// How rays begin, end, and enter instances in whole trees of the layout BOXES.

auto reset = [&](Ray& ray, int slot) INLINE {
    // the hit will be written there: slots of sorted rays are anywhere
    __builtin_prefetch(&rays.hit_instance.data[slot], 1);
    if (!ANY_HIT) {
        __builtin_prefetch(&rays.hit_t.data[slot], 1);
        __builtin_prefetch(&rays.hit_primitive.data[slot], 1);
        __builtin_prefetch(&rays.hit_uv.data[slot], 1);
    }
    ray.slot = slot;
    const float limit = rays.t_max.data[slot];
    ray.best = limit > 0.0f ? limit : 0.0f;  // also for NaN, with which the loop would not end
    ray.face = -1;
    ray.v = ray.w = 0.0f;
    ray.top = 8;
#if COUNTERS
    ray.node_steps = ray.box_tests = ray.triangle_tests = 0;
#endif
};
// At the root; whether the ray can be traced
auto begin = [&](Ray& ray, int slot) INLINE -> bool {
    reset(ray, slot);
    return TWO_LEVEL ? set_top(ray) : set_entry(ray, 0);
};
auto finish = [&](Ray& ray) INLINE {
    const int slot = ray.slot;
#if COUNTERS
    counts.node_steps.data[slot] = ray.node_steps;
    counts.box_tests.data[slot] = ray.box_tests;
    counts.triangle_tests.data[slot] = ray.triangle_tests;
#endif
    if (ANY_HIT) {
        rays.hit_instance.data[slot] = ray.face < 0 ? -1 : 0;
        return;
    }
    int instance = -1, primitive = -1;
    if (ray.face >= 0) identify(TWO_LEVEL ? ray.hit_entry : 0, ray.face, instance, primitive);
    rays.hit_t.data[slot] = ray.best;
    rays.hit_instance.data[slot] = instance;
    rays.hit_primitive.data[slot] = primitive;
    rays.hit_uv.data[slot] = wp::vec_t<2, float>(ray.v, ray.w);
};
// A leaf of the top level was just taken from the stack: into its first entry, the others wait. Whether there is
// anything to see.
auto enter_tree = [&](Ray& ray) INLINE -> bool {
    const int code = ~ray.child, entry = tree.top_entry.data[code >> 3];
    if (code & 7) {
        ray.waiting[ray.top] = ~(code + 7);  // one further, one less
        ray.distance[ray.top++] = 0.0f;      // an only child was never given one
    }
    if (rays.visibility.shape[0] != 0 && !(tree.entry_visibility.data[entry] & rays.visibility.data[ray.slot]))
        return false;
    if (!set_entry(ray, entry)) {
        to_top(ray);
        return false;
    }
    ray.waiting[ray.top] = LEAVE;
    ray.distance[ray.top++] = __builtin_nanf("");
    return true;
};
if (empty) {
    Ray ray;
    for (int i = first; i < end; ++i) {
        reset(ray, listed.slots.data[i]);
        finish(ray);
    }
    return;
}
