// The top level that a ray goes through: where things move there may be several, each for a range of time.

#if MOTION
// Ranges are as many as a power of two, so that a product tells exactly which one a time is in
auto top_range = [&](int slot) -> int {
    const int range = (int)(time_of(slot) * tree.top_ranges);
    return range < 0 ? 0 : range >= tree.top_ranges ? tree.top_ranges - 1 : range;
};
auto top_node_of = [&](int slot) -> int { return tree.range_node.data[top_range(slot)]; };
auto top_centre_of = [&](int slot) -> const wp::vec_t<3, float>& { return tree.range_centre.data[top_range(slot)]; };
#else
auto top_node_of = [&](int) -> int { return tree.top_node; };
auto top_centre_of = [&](int) -> const wp::vec_t<3, float>& { return tree.top_centre; };
#endif
