// Where a ray enters a segment of a curve (`scene/segments.py`), on either device; of one segment, or of eight in
// vectors.
//
// A segment is a cone around its axis, cut by a plane at either end. The origin is moved along the ray, first to where
// it is nearest to the segment's middle, then to where it is nearest to the axis: what is left is of the segment's
// size, and so are its roundings. The equation of second degree has two roots; the one at which the ray comes in is
// (-B - sqrt(B B - A C)) / A for cones of any slope. A sphere is a segment whose axis is 0.

// Rays closer to the axis's direction than this, squared, keep their origin: nothing says where they are nearest to it
constexpr float PARALLEL = 1e-10f;
constexpr unsigned RADIUS_MASK = 0xffffu, NORMAL_MASK = 0x7ffu;
// t, how far along the axis (0 at the first point, 1 at the second), and the point relative to the middle. Whether t is
// a hit is in `good`: not below 0 where it is.
auto enter_segment = [&](const float* o, const float* d, auto ax, auto ay, auto az, auto bx, auto by, auto bz, auto r0,
                         auto r1, auto& t, auto& s, auto& qx, auto& qy, auto& qz, auto& good) INLINE_SEGMENT {
    const float dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const auto ex = bx - ax, ey = by - ay, ez = bz - az;
    const auto px = (ax - o[0]) + 0.5f * ex, py = (ay - o[1]) + 0.5f * ey, pz = (az - o[2]) + 0.5f * ez;
    const auto to_middle = (px * d[0] + py * d[1] + pz * d[2]) / dd;
    auto ox = to_middle * d[0] - px, oy = to_middle * d[1] - py, oz = to_middle * d[2] - pz;
    const auto ee = ex * ex + ey * ey + ez * ez;
    const auto zero = ee - ee;
    const auto inverse = ee > 0.0f ? 1.0f / ee : zero;
    auto along = (ox * ex + oy * ey + oz * ez) * inverse;
    const auto speed = (d[0] * ex + d[1] * ey + d[2] * ez) * inverse;
    // across the axis
    auto x = ox - ex * along, y = oy - ey * along, z = oz - ez * along;
    const auto dx = d[0] - ex * speed, dy = d[1] - ey * speed, dz = d[2] - ez * speed;
    const auto squared = dx * dx + dy * dy + dz * dz;
    const auto to_axis = squared > PARALLEL * dd ? -(dx * x + dy * y + dz * z) / squared : zero;
    x = x + to_axis * dx;
    y = y + to_axis * dy;
    z = z + to_axis * dz;
    along = along + to_axis * speed;
    const auto taper = r1 - r0, radius = 0.5f * (r0 + r1) + taper * along, widens = taper * speed;
    const auto a = squared - widens * widens, b = dx * x + dy * y + dz * z - widens * radius;
    const auto c = x * x + y * y + z * z - radius * radius, discriminant = b * b - a * c;
    const auto root = square_root(discriminant > 0.0f ? discriminant : zero);
    const auto step = b < 0.0f ? c / (root - b) : -(b + root) / a;
    t = to_middle + to_axis + step;
    along = along + step * speed;
    s = along + 0.5f;
    qx = x + step * dx + ex * along;
    qy = y + step * dy + ey * along;
    qz = z + step * dz + ez * along;
    const auto met = 0.5f * (r0 + r1) + taper * along, most = r0 > r1 ? r0 : r1;
    // how far out it may be, which the box of the segment allows for; a plane may cut farther out where radii change
    const auto beyond = along > 0.5f ? along - 0.5f : along < -0.5f ? -0.5f - along : zero;
    const auto room = 4.0f * most * most - beyond * beyond * ee;
    auto least = discriminant < met ? discriminant : met;
    least = least < room ? least : room;
    good = met > 2.0f * most ? -1.0f + zero : least;
};
// A vector of 22 bits, of any length
auto segment_normal = [](unsigned bits, float* n) INLINE_SEGMENT {
    const float x = (float)(bits & NORMAL_MASK) * (2.0f / NORMAL_STEPS) - 1.0f;
    const float y = (float)(bits >> 11 & NORMAL_MASK) * (2.0f / NORMAL_STEPS) - 1.0f;
    const float z = 1.0f - fabsf(x) - fabsf(y), fold = z < 0.0f ? -z : 0.0f;
    n[0] = x < 0.0f ? x + fold : x - fold;
    n[1] = y < 0.0f ? y + fold : y - fold;
    n[2] = z;
};
// Whether the point q, relative to the middle, lies between the planes of a segment with the axis e; its place on the
// surface (`shading/segments.py`): along the axis, and around it
auto place_on_segment = [&](const float* e, unsigned first, unsigned second, const float* q, float s, float& u,
                            float& v) INLINE_SEGMENT -> bool {
    const float largest = fabsf(e[0]) + fabsf(e[1]) + fabsf(e[2]);
    if (largest == 0.0f) {  // a sphere: the octahedron's coordinates
        const float size = fabsf(q[0]) + fabsf(q[1]) + fabsf(q[2]);
        if (!(size > 0.0f)) return false;
        const float x = q[0] / size, y = q[1] / size;
        u = q[2] < 0.0f ? (x < 0.0f ? fabsf(y) - 1.0f : 1.0f - fabsf(y)) : x;
        v = q[2] < 0.0f ? (y < 0.0f ? fabsf(x) - 1.0f : 1.0f - fabsf(x)) : y;
        return true;
    }
    float n[3], m[3];
    segment_normal(first, n);
    segment_normal(second, m);
    float before = 0.0f, behind = 0.0f;
    for (int k = 0; k < 3; ++k) {
        before += (q[k] + 0.5f * e[k]) * n[k];
        behind += (q[k] - 0.5f * e[k]) * m[k];
    }
    if (!(before >= 0.0f && behind <= 0.0f)) return false;
    u = s < 0.0f ? 0.0f : s > 1.0f ? 1.0f : s;
    // axes across the unit vector a (Duff et al. 2017), and the corner of a square that is turned to the point
    const float scale = 1.0f / largest, ax = e[0] * scale, ay = e[1] * scale, az = e[2] * scale;
    const float inverse = 1.0f / square_root(ax * ax + ay * ay + az * az);
    const float x = ax * inverse, y = ay * inverse, z = az * inverse, sign = z < 0.0f ? -1.0f : 1.0f;
    const float p = -1.0f / (sign + z), r = x * y * p;
    const float i = q[0] * (1.0f + sign * x * x * p) + q[1] * (sign * r) - q[2] * (sign * x);
    const float j = q[0] * r + q[1] * (sign + y * y * p) - q[2] * y;
    const float size = fabsf(i) + fabsf(j);
    if (!(size > 0.0f)) return false;
    v = j < 0.0f ? i / size - 1.0f : 1.0f - i / size;
    return true;
};
