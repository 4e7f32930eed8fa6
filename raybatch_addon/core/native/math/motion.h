// Where a thing is at a time in [0, 1]: between evenly spaced keys of KEY_FLOATS, which are a quaternion (its real part
// last), a translation and a stretch (row by row). The rotation is interpolated along great arcs, the rest linearly, as
// Cycles does it (`core/scene/motion.py`). In float64, so that a map is as right as one that does not move.

struct AffineMap {
    double m[3][4];
};
auto moved_map = [](const float* keys, int steps, float time) -> AffineMap {
    const double at = (double)time * (steps - 1);
    int step = (int)at;
    step = step < 0 ? 0 : step > steps - 2 ? steps - 2 : step;
    const double t = at - step;
    const float *a = keys + KEY_FLOATS * step, *b = a + KEY_FLOATS;
    double cosine = 0.0, q[4], length = 0.0;
    for (int i = 0; i < 4; ++i) cosine += (double)a[i] * b[i];
    double share_a = 1.0 - t, share_b = t;
    if (cosine < 0.9995) {
        const double angle = wp::acos(cosine < -1.0 ? -1.0 : cosine), sine = wp::sin(angle);
        if (sine > 0.0) {
            share_a = wp::sin(angle * (1.0 - t)) / sine;
            share_b = wp::sin(angle * t) / sine;
        }
    }
    for (int i = 0; i < 4; ++i) {
        q[i] = share_a * a[i] + share_b * b[i];
        length += q[i] * q[i];
    }
    const double s = 2.0 / length, x = q[0], y = q[1], z = q[2], w = q[3];
    const double r[3][3] = {
        {1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)},
        {s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)},
        {s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)}
    };
    auto mixed = [&](int i) -> double { return (1.0 - t) * a[i] + t * b[i]; };
    AffineMap map;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            map.m[i][j] = r[i][0] * mixed(7 + j) + r[i][1] * mixed(10 + j) + r[i][2] * mixed(13 + j);
        map.m[i][3] = mixed(4 + i);
    }
    return map;
};
// The inverse of a map; numbers that are not finite where there is none
auto inverse_map = [](const AffineMap& map) -> AffineMap {
    const auto& m = map.m;
    AffineMap inverse;
    auto minor = [&](int i, int j, int k, int l) -> double { return m[i][k] * m[j][l] - m[i][l] * m[j][k]; };
    const double c0 = minor(1, 2, 1, 2), c1 = minor(1, 2, 2, 0), c2 = minor(1, 2, 0, 1);
    const double d = 1.0 / (m[0][0] * c0 + m[0][1] * c1 + m[0][2] * c2);
    const double n[3][3] = {
        {c0, minor(2, 0, 1, 2), minor(0, 1, 1, 2)},
        {c1, minor(2, 0, 2, 0), minor(0, 1, 2, 0)},
        {c2, minor(2, 0, 0, 1), minor(0, 1, 0, 1)}
    };
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) inverse.m[i][j] = d * n[i][j];
        inverse.m[i][3] = -(inverse.m[i][0] * m[0][3] + inverse.m[i][1] * m[1][3] + inverse.m[i][2] * m[2][3]);
    }
    return inverse;
};
auto rounded_map = [](const AffineMap& map) -> wp::mat_t<3, 4, float> {
    wp::mat_t<3, 4, float> result;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) result.data[i][j] = static_cast<float>(map.m[i][j]);
    return result;
};
