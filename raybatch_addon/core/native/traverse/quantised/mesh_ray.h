// The lane's ray in the tree that it is in.

auto make_ray = [&]() {
    const auto o = rays.origin.data[slot];
    const auto d = rays.direction.data[slot];
    if (!TWO_LEVEL) {
        ray = begin_ray(o, d, tree.entry_centre.data[0], SLAB_MARGIN);
    } else if (entry < 0) {
        ray = begin_ray(o, d, top_centre_of(slot), tree.top_margin);
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
        ray = begin_ray(p, v, tree.entry_centre.data[entry], SLAB_MARGIN);
        to_entry_blocks();
    }
};
