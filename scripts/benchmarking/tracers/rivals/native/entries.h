// How rays come into a stream, into the trees of a top level, and out again.

auto finish = [&](const Ray& ray) INLINE {
    const int slot = ray.slot;
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
// Whether the ray in `slot` can be traced; if not it has its result, a miss
auto begin = [&](Ray& ray, int slot) INLINE -> bool {
    const auto& p = rays.origin.data[slot];
    const auto& v = rays.direction.data[slot];
    const float o[3] = {p[0], p[1], p[2]}, d[3] = {v[0], v[1], v[2]}, limit = rays.t_max.data[slot];
    ray.slot = slot;
    ray.best = limit > 0.0f ? limit : 0.0f;  // also for NaN
    ray.face = -1;
    ray.v = ray.w = 0.0f;
    ray.entry = ray.hit_entry = 0;
    bool sound = tree.entry_count > 0;
    if (TWO_LEVEL) {
        sound = sound && set_slabs(ray, o, d, tree.top_centre.c, tree.top_margin);
    } else if (sound) {
        set_shear(ray, o, d);
        sound = set_slabs(ray, o, d, tree.entry_centre.data[0].c, SLAB_MARGIN);
    }
    if (!sound) finish(ray);
    return sound;
};
// The rays `ids` of the top level, `from`, as rays `to` of the tree of `entry`; how many see it and can be traced
auto enter_entry = [&](const Ray* from, const Id* ids, int count, int entry, Ray* to) -> int {
    const bool some_blind = rays.visibility.shape[0] != 0;
    const int seen_by = tree.entry_visibility.data[entry];
    const auto& from_world = tree.entry_from_world.data[entry];
    int n = 0;
    for (int i = 0; i < count; ++i) {
        const Ray& ray = from[ids[i]];
        if (ray.best < 0.0f || (some_blind && !(seen_by & rays.visibility.data[ray.slot]))) continue;
        const auto moved = transformed_point(from_world, rays.origin.data[ray.slot]);
        const auto turned = transformed_vector(from_world, rays.direction.data[ray.slot]);
        const float o[3] = {moved[0], moved[1], moved[2]}, d[3] = {turned[0], turned[1], turned[2]};
        Ray& made = to[n];
        made.slot = ray.slot;
        made.best = ray.best;
        made.face = ray.face;
        made.v = ray.v;
        made.w = ray.w;
        made.hit_entry = ray.hit_entry;
        made.entry = entry;
        made.index = ids[i];
        set_shear(made, o, d);
        n += set_slabs(made, o, d, tree.entry_centre.data[entry].c, SLAB_MARGIN);
    }
    return n;
};
// What they found goes back
auto leave_entry = [&](const Ray* from, int count, Ray* to) {
    for (int i = 0; i < count; ++i) {
        Ray& ray = to[from[i].index];
        ray.best = from[i].best;
        ray.face = from[i].face;
        ray.v = from[i].v;
        ray.w = from[i].w;
        ray.hit_entry = from[i].hit_entry;
    }
};
// The rays `ids` of `set` meet the triangles of a leaf
auto test_rays = [&](Ray* set, const Id* ids, int count, int code, const char* triangles) INLINE {
    const char* p = triangles + GROUP * ((unsigned)~code >> 3);
    for (int more = ~code & 7; more >= 0; --more, p += GROUP) {
        for (int i = 0; i < count; ++i) {
            Ray& ray = set[ids[i]];
            test(ray, p);
            if (ANY_HIT && ray.face >= 0) ray.best = -1.0f;
        }
    }
};
