// The lane tests one primitive of the group in hand, a triangle or a segment.

#undef test
#undef meet_triangle
auto test = [&]() {
    const Words c = read(triangles + TRIANGLE * (leaf.x + highest_bit(leaf.y)) + 2);
    if ((c.z & SEGMENT_MARK) == SEGMENT_MARK) test_segment();
    else test_triangle();
};
