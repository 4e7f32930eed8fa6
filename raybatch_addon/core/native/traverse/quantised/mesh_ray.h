// The lane's ray in the tree that it is in.

auto make_ray = [&]() {
    const auto o = rays.origin.data[slot];
    const auto d = rays.direction.data[slot];
    if (!TWO_LEVEL) {
        const auto c = tree.entry_centre.data[0];
        ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], SLAB_MARGIN);
    } else if (entry < 0) {
        const auto c = tree.top_centre;
        ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], tree.top_margin);
        top_order = ray.order;
        to_top_blocks();
    } else {
#if MOTION
        const float time = time_of(slot);
        const auto from_world = from_world_at(entry, time);
        between = between_steps(tree.entry_deform.data[entry], time);
#else
        const auto& from_world = tree.entry_from_world.data[entry];
#endif
        const auto p = transformed_point(from_world, o), v = transformed_vector(from_world, d);
        const auto c = tree.entry_centre.data[entry];
        ray = begin_ray(p[0], p[1], p[2], v[0], v[1], v[2], c[0], c[1], c[2], SLAB_MARGIN);
        to_entry_blocks();
    }
};
