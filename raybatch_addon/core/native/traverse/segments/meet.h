// Where a ray enters a segment of a curve (`scene/segments.py`), on either device; of one segment, or of eight in
// vectors.
//
// A segment is a cone around its axis, cut by a plane at either end. The origin is moved along the ray, first to where
// it is nearest to the segment's middle, then to where it is nearest to the axis: what is left is of the segment's
// size, and so are its roundings. The equation of second degree has two roots; the one at which the ray comes in is
// (-B - sqrt(B B - A C)) / A for cones of any slope. A sphere is a segment whose axis is 0.

struct Segment {
    Number ax, ay, az, bx, by, bz;  // its points
    Number r0, r1;                  // its radii there
};
struct Entry {
    Number t;
    Number s;           // how far along the axis: 0 at the first point, 1 at the second
    Number qx, qy, qz;  // the point relative to the middle
    Number good;        // whether t is a hit: not below 0 where it is
};
// The axis from one point of a segment to the other, and the normals of the planes that cut it there
struct Axis {
    float e[3], n[3], m[3];
};
auto enter_segment = [&](const float* o, const float* d, const Segment& g) INLINE_SEGMENT -> Entry {
    const float dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const Number ex = g.bx - g.ax, ey = g.by - g.ay, ez = g.bz - g.az;
    const Number px = (g.ax - o[0]) + 0.5f * ex, py = (g.ay - o[1]) + 0.5f * ey, pz = (g.az - o[2]) + 0.5f * ez;
    const Number to_middle = (px * d[0] + py * d[1] + pz * d[2]) / dd;
    Number ox = to_middle * d[0] - px, oy = to_middle * d[1] - py, oz = to_middle * d[2] - pz;
    const Number ee = ex * ex + ey * ey + ez * ez;
    const Number zero = ee - ee;
    const Number inverse = ee > 0.0f ? 1.0f / ee : zero;
    Number along = (ox * ex + oy * ey + oz * ez) * inverse;
    const Number speed = (d[0] * ex + d[1] * ey + d[2] * ez) * inverse;
    // across the axis
    Number x = ox - ex * along, y = oy - ey * along, z = oz - ez * along;
    const Number dx = d[0] - ex * speed, dy = d[1] - ey * speed, dz = d[2] - ez * speed;
    const Number squared = dx * dx + dy * dy + dz * dz;
    // Rays along the axis are nearest to it far from the segment, where roundings are of that distance. They keep their
    // origin: where one of them meets the segment it is within four radii of the axis already.
    const Number most = g.r0 > g.r1 ? g.r0 : g.r1, reach = 2.0f * ee + 48.0f * (most * most);
    const Number to_nearest = -(dx * x + dy * y + dz * z) / squared;
    const Number to_axis = to_nearest * dd * to_nearest <= reach ? to_nearest : zero;
    x = x + to_axis * dx;
    y = y + to_axis * dy;
    z = z + to_axis * dz;
    along = along + to_axis * speed;
    const Number taper = g.r1 - g.r0, radius = 0.5f * (g.r0 + g.r1) + taper * along, widens = taper * speed;
    const Number a = squared - widens * widens, b = dx * x + dy * y + dz * z - widens * radius;
    const Number c = x * x + y * y + z * z - radius * radius, discriminant = b * b - a * c;
    const Number root = square_root(discriminant > 0.0f ? discriminant : zero);
    const Number step = b < 0.0f ? c / (root - b) : -(b + root) / a;
    Entry entry;
    entry.t = to_middle + to_axis + step;
    along = along + step * speed;
    entry.s = along + 0.5f;
    entry.qx = x + step * dx + ex * along;
    entry.qy = y + step * dy + ey * along;
    entry.qz = z + step * dz + ez * along;
    const Number met = 0.5f * (g.r0 + g.r1) + taper * along;
    // how far out it may be, which the box of the segment allows for; a plane may cut farther out where radii change
    const Number beyond = along > 0.5f ? along - 0.5f : along < -0.5f ? -0.5f - along : zero;
    const Number room = 4.0f * most * most - beyond * beyond * ee;
    Number least = discriminant < met ? discriminant : met;
    least = least < room ? least : room;
    entry.good = met > 2.0f * most ? -1.0f + zero : least;
    return entry;
};
// The same of a strip that faces the ray: where the ray passes the axis, or the nearer end of it, at most a radius
// away. Nearer to the ray's origin than twice the radius no strip is met: not the one that the ray leaves.
auto enter_ribbon = [&](const float* o, const float* d, const Segment& g) INLINE_SEGMENT -> Entry {
    const float dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const Number ex = g.bx - g.ax, ey = g.by - g.ay, ez = g.bz - g.az;
    const Number px = (g.ax - o[0]) + 0.5f * ex, py = (g.ay - o[1]) + 0.5f * ey, pz = (g.az - o[2]) + 0.5f * ez;
    const Number to_middle = (px * d[0] + py * d[1] + pz * d[2]) / dd;
    const Number ox = to_middle * d[0] - px, oy = to_middle * d[1] - py, oz = to_middle * d[2] - pz;
    // the axis as the ray sees it
    const Number speed = (d[0] * ex + d[1] * ey + d[2] * ez) / dd;
    const Number fx = ex - speed * d[0], fy = ey - speed * d[1], fz = ez - speed * d[2];
    const Number ff = fx * fx + fy * fy + fz * fz;
    const Number zero = ff - ff;
    Number along = ff > 0.0f ? (ox * fx + oy * fy + oz * fz) / ff : zero;
    along = along < -0.5f ? zero - 0.5f : along > 0.5f ? zero + 0.5f : along;
    const Number radius = 0.5f * (g.r0 + g.r1) + (g.r1 - g.r0) * along;
    const Number x = ox - along * fx, y = oy - along * fy, z = oz - along * fz;
    Entry entry;
    entry.t = to_middle + along * speed;
    entry.s = along + 0.5f;
    entry.qx = x + along * ex;
    entry.qy = y + along * ey;
    entry.qz = z + along * ez;
    const Number far = entry.t * entry.t * dd - 4.0f * (radius * radius),
                 near = radius * radius - (x * x + y * y + z * z);
    entry.good = ff > 0.0f ? (far < near ? far : near) : zero - 1.0f;
    return entry;
};
// A vector of 22 bits, of any length
auto segment_normal = [&](unsigned bits, float* n) INLINE_SEGMENT {
    const float x = (float)(bits & COORDINATE_MASK) * (2.0f / NORMAL_STEPS) - 1.0f;
    const float y = (float)(bits >> COORDINATE_BITS & COORDINATE_MASK) * (2.0f / NORMAL_STEPS) - 1.0f;
    const float z = 1.0f - fabsf(x) - fabsf(y), fold = z < 0.0f ? -z : 0.0f;
    n[0] = x < 0.0f ? x + fold : x - fold;
    n[1] = y < 0.0f ? y + fold : y - fold;
    n[2] = z;
};
// Between two steps; of a length that is not 1
auto mixed_normal = [&](unsigned before, unsigned behind, float share, float* n) INLINE_SEGMENT {
    float m[3];
    segment_normal(before, n);
    segment_normal(behind, m);
    const float size = 1.0f / square_root(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    const float other = 1.0f / square_root(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
    for (int k = 0; k < 3; ++k) n[k] = n[k] * size + share * (m[k] * other - n[k] * size);
};
// Where around the axis e the direction q points: the corner of a square that is turned to it
auto turn_of = [&](const float* e, const float* q, float& v) INLINE_SEGMENT -> bool {
    // axes across the unit vector a (Duff et al. 2017)
    const float scale = 1.0f / (fabsf(e[0]) + fabsf(e[1]) + fabsf(e[2]));
    const float ax = e[0] * scale, ay = e[1] * scale, az = e[2] * scale;
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
// Whether the point q, relative to the middle, lies between the planes of a segment; its place on the surface
// (`shading/segments.py`): along the axis, and around it
auto place_on_segment = [&](const Axis& axis, const float* q, float s, float& u, float& v) INLINE_SEGMENT -> bool {
    const float *e = axis.e, *n = axis.n, *m = axis.m;
    const float largest = fabsf(e[0]) + fabsf(e[1]) + fabsf(e[2]);
    if (largest == 0.0f) {  // a sphere: the octahedron's coordinates
        const float size = fabsf(q[0]) + fabsf(q[1]) + fabsf(q[2]);
        if (!(size > 0.0f)) return false;
        const float x = q[0] / size, y = q[1] / size;
        u = q[2] < 0.0f ? (x < 0.0f ? fabsf(y) - 1.0f : 1.0f - fabsf(y)) : x;
        v = q[2] < 0.0f ? (y < 0.0f ? fabsf(x) - 1.0f : 1.0f - fabsf(x)) : y;
        return true;
    }
    float before = 0.0f, behind = 0.0f;
    for (int k = 0; k < 3; ++k) {
        before += (q[k] + 0.5f * e[k]) * n[k];
        behind += (q[k] - 0.5f * e[k]) * m[k];
    }
    if (!(before >= 0.0f && behind <= 0.0f)) return false;
    u = s < 0.0f ? 0.0f : s > 1.0f ? 1.0f : s;
    return turn_of(e, q, v);
};
// Whether the point q, relative to the middle, lies between the planes of a strip, turned until the ray lies in them;
// its place on the surface of the round curve that the strip stands for, in front of q. s: 0 to 1
auto place_on_ribbon = [&](const Axis& axis, const float* d, float radius, const float* q, float s, float& u, float& v)
                           INLINE_SEGMENT -> bool {
    const float *e = axis.e, *n = axis.n, *m = axis.m;
    float dd = 0.0f, ed = 0.0f, ee = 0.0f, nd = 0.0f, md = 0.0f, qd = 0.0f, nq = 0.0f, mq = 0.0f, ne = 0.0f, me = 0.0f;
    for (int k = 0; k < 3; ++k) {
        dd += d[k] * d[k];
        ed += e[k] * d[k];
        ee += e[k] * e[k];
        nd += n[k] * d[k];
        md += m[k] * d[k];
        qd += q[k] * d[k];
        nq += n[k] * q[k];
        mq += m[k] * q[k];
        ne += n[k] * e[k];
        me += m[k] * e[k];
    }
    const float before = nq + 0.5f * ne - nd * (qd + 0.5f * ed) / dd,
                behind = mq - 0.5f * me - md * (qd - 0.5f * ed) / dd;
    if (!(before >= 0.0f && behind <= 0.0f)) return false;
    u = s;
    // as far to the side as the ray passes the axis, and towards the viewer
    const float w[3] = {e[1] * d[2] - e[2] * d[1], e[2] * d[0] - e[0] * d[2], e[0] * d[1] - e[1] * d[0]};
    const float ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    float side = 0.0f, f[3], ff = 0.0f;
    for (int k = 0; k < 3; ++k) {
        side += (q[k] - (s - 0.5f) * e[k]) * w[k];
        f[k] = e[k] * (ed / ee) - d[k];
        ff += f[k] * f[k];
    }
    if (!(ww > 0.0f && ff > 0.0f && radius > 0.0f)) return false;
    side = side / (square_root(ww) * radius);
    side = side < -1.0f ? -1.0f : side > 1.0f ? 1.0f : side;
    const float by_side = side / square_root(ww),
                forwards = square_root((1.0f - side) * (1.0f + side)) / square_root(ff);
    const float outwards[3] = {
        by_side * w[0] + forwards * f[0], by_side * w[1] + forwards * f[1], by_side * w[2] + forwards * f[2]
    };
    return turn_of(e, outwards, v);
};
