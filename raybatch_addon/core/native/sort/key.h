// `ray_key`: the KEY_BITS bits that rays are sorted by, the octant of the direction above the Morton code of the
// origin.

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
    const unsigned int octant = (d[0] < 0.0f ? 1u : 0u) | (d[1] < 0.0f ? 2u : 0u) | (d[2] < 0.0f ? 4u : 0u);
    const unsigned int code = spread(cell(px, 512.0f)) | spread(cell(py, 512.0f)) << 1 | spread(cell(pz, 512.0f)) << 2;
    return octant << (KEY_BITS - 3) | code;
};
