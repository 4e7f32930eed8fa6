// Time in trees: when a ray is, the map of an entry that moves, and where the steps of triangles that deform lie.

// The time of the ray in `slot`: a path's shadow ray has the path's
auto time_of = [&](int slot) -> float {
    const int paths = rays.time.shape[0];
    return rays.time.data[slot < paths ? slot : slot - paths];
};
auto from_world_at = [&](int entry, float time) -> wp::mat_t<3, 4, float> {
    const int row = tree.entry_motion.data[entry];
    if (row < 0) return tree.entry_from_world.data[entry];
    const float* keys = tree.motion_keys.data + (long long)KEY_FLOATS * tree.motion_steps * row;
    return rounded_map(inverse_map(moved_map(keys, tree.motion_steps, time)));
};
// Where a ray is between two steps of the vertices: blocks of triangles from those of the first step to those of the
// step before it, and from there to those of the step behind; and how far it is between them. `stride`: blocks of one
// step; 0 where nothing deforms.
struct BetweenSteps {
    long long first, next;
    float share;
};
auto between_steps = [&](long long stride, float time) -> BetweenSteps {
    BetweenSteps between = {0, 0, 0.0f};
    if (stride == 0) return between;
    const float at = time * (tree.deform_steps - 1);
    int step = (int)at;
    step = step < 0 ? 0 : step > tree.deform_steps - 2 ? tree.deform_steps - 2 : step;
    between.first = stride * step;
    between.next = stride;
    between.share = at - step;
    return between;
};
