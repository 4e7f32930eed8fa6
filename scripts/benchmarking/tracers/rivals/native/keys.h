// `ray_key`: 30 or 32 bits that rays are sorted by.

auto cell = [](float x, float cells) -> unsigned int {
    x *= cells;
    x = x > 0.0f ? x : 0.0f;
    return (unsigned int)(int)(x < cells - 1.0f ? x : cells - 1.0f);
};
// The bits of x, of which there are ten at most, with two zeros between them; and with five between them
auto third = [](unsigned int x) -> unsigned int {
    x = (x | (x << 16)) & 0x030000ffu;
    x = (x | (x << 8)) & 0x0300f00fu;
    x = (x | (x << 4)) & 0x030c30c3u;
    return (x | (x << 2)) & 0x09249249u;
};
auto sixth = [](unsigned int x) -> unsigned int {
    unsigned int spread = 0u;
    for (int bit = 0; bit < 5; ++bit) spread |= (x >> bit & 1u) << (6 * bit);
    return spread;
};
// Of a point, in the scene's box: 3 `bits` of Morton code
auto point_code = [&](float x, float y, float z, float cells) -> unsigned int {
    return third(cell((x - rule.low[0]) * rule.scale[0], cells)) |
           third(cell((y - rule.low[1]) * rule.scale[1], cells)) << 1 |
           third(cell((z - rule.low[2]) * rule.scale[2], cells)) << 2;
};
// Of a direction: 14 bits, of its place on the sphere unfolded from an octahedron (Meyer et al. 2010), in Morton order
auto direction_code = [&](float x, float y, float z) -> unsigned int {
    const float size = fabsf(x) + fabsf(y) + fabsf(z), one = size > 0.0f ? 1.0f / size : 0.0f;
    float u = x * one, v = y * one;
    if (z < 0.0f) {
        const float folded = (1.0f - fabsf(v)) * (u < 0.0f ? -1.0f : 1.0f);
        v = (1.0f - fabsf(u)) * (v < 0.0f ? -1.0f : 1.0f);
        u = folded;
    }
    const unsigned int a = cell(0.5f * u + 0.5f, 128.0f), b = cell(0.5f * v + 0.5f, 128.0f);
    unsigned int code = 0u;
    for (int bit = 0; bit < 7; ++bit) code |= ((a >> bit & 1u) | (b >> bit & 1u) << 1) << (2 * bit);
    return code;
};
// How far the ray goes until it leaves the scene's box, or to t_max
auto way_out = [&](float ox, float oy, float oz, float dx, float dy, float dz, float limit) -> float {
    const float o[3] = {ox, oy, oz}, d[3] = {dx, dy, dz};
    float t = limit;
    for (int k = 0; k < 3; ++k) {
        const float plane = d[k] < 0.0f ? rule.low[k] : rule.high[k], at = (plane - o[k]) / d[k];
        if (d[k] != 0.0f && at >= 0.0f && at < t) t = at;
    }
    return t < 1e30f ? t : 0.0f;
};
auto ray_key = [&](int slot) -> unsigned int {
    const wp::vec3 o = rays_origin.data[slot], d = rays_direction.data[slot];
    const float x = o[0], y = o[1], z = o[2], dx = d[0], dy = d[1], dz = d[2];
    if (rule.key == ORIGIN) return point_code(x, y, z, 1024.0f);
    if (rule.key == ORIGIN_DIRECTION) return point_code(x, y, z, 64.0f) << 14 | direction_code(dx, dy, dz);
    if (rule.key == DIRECTION_ORIGIN) return direction_code(dx, dy, dz) << 18 | point_code(x, y, z, 64.0f);
    const float limit = rule.limit.data[slot];
    if (rule.key == HIT_POINT) {
        const float t = rule.hit.data[slot] >= 0 ? rule.hit_t.data[slot] : way_out(x, y, z, dx, dy, dz, limit);
        return point_code(x + t * dx, y + t * dy, z + t * dz, 1024.0f);
    }
    const float t = limit < rule.reach ? limit : rule.reach;
    const float from[3] = {x, y, z}, to[3] = {x + t * dx, y + t * dy, z + t * dz};
    unsigned int code = 0u;
    for (int k = 0; k < 3; ++k) {
        code |= sixth(cell((from[k] - rule.low[k]) * rule.scale[k], 32.0f)) << (2 * k);
        code |= sixth(cell((to[k] - rule.low[k]) * rule.scale[k], 32.0f)) << (2 * k + 1);
    }
    return code;
};
