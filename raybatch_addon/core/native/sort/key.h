// `ray_key`: the 30 bits that rays are sorted by.

auto cell = [](float x, float cells) -> unsigned int {
    x *= cells;
    x = x > 0.0f ? x : 0.0f;
    return (unsigned int)(int)(x < cells - 1.0f ? x : cells - 1.0f);
};
auto spread = [](unsigned int x) -> unsigned int {
    x = (x | (x << 16)) & 0x030000ffu;
    x = (x | (x << 8)) & 0x0300f00fu;
    x = (x | (x << 4)) & 0x030c30c3u;
    return (x | (x << 2)) & 0x09249249u;
};
auto ray_key = [&](int slot) -> unsigned int {
    const wp::vec3 o = rays_origin.data[slot], d = rays_direction.data[slot];
    const float px = (o[0] - low[0]) * scale[0], py = (o[1] - low[1]) * scale[1], pz = (o[2] - low[2]) * scale[2];
#if ORIGIN_DIRECTION
    const float length = fabsf(d[0]) + fabsf(d[1]) + fabsf(d[2]);
    float u = d[0] / length, v = d[1] / length;
    if (d[2] < 0.0f) {
        const float folded = (1.0f - fabsf(v)) * (u < 0.0f ? -1.0f : 1.0f);
        v = (1.0f - fabsf(u)) * (v < 0.0f ? -1.0f : 1.0f);
        u = folded;
    }
    const unsigned int cells[5] = {
        cell(0.5f * u + 0.5f, 64.0f), cell(0.5f * v + 0.5f, 64.0f), cell(px, 64.0f), cell(py, 64.0f), cell(pz, 64.0f)
    };
    unsigned int key = 0;
    for (int bit = 0; bit < 6; ++bit)
        for (int axis = 0; axis < 5; ++axis) key |= (cells[axis] >> bit & 1u) << (5 * bit + axis);
    return key;
#else
    const unsigned int octant = (d[0] < 0.0f ? 1u : 0u) | (d[1] < 0.0f ? 2u : 0u) | (d[2] < 0.0f ? 4u : 0u);
    const unsigned int code = spread(cell(px, 512.0f)) | spread(cell(py, 512.0f)) << 1 | spread(cell(pz, 512.0f)) << 2;
#if OCTANT_ORIGIN
    return octant << 27 | code;
#else
    return (code >> 12) << 15 | octant << 12 | (code & 0xfffu);
#endif
#endif
};
