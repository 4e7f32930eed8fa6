// Affine maps: the object-space ray of an instance comes from here alone, on every device.

// The point `p` under the map `m`
auto transformed_point = [](const wp::mat_t<3, 4, float>& m, const wp::vec_t<3, float>& p) -> wp::vec_t<3, float> {
    return wp::vec_t<3, float>(
        m.data[0][0] * p[0] + m.data[0][1] * p[1] + m.data[0][2] * p[2] + m.data[0][3],
        m.data[1][0] * p[0] + m.data[1][1] * p[1] + m.data[1][2] * p[2] + m.data[1][3],
        m.data[2][0] * p[0] + m.data[2][1] * p[1] + m.data[2][2] * p[2] + m.data[2][3]
    );
};
// The direction `d` under the linear part of `m`, not normalised, so that ray distances stay those of the world
auto transformed_vector = [](const wp::mat_t<3, 4, float>& m, const wp::vec_t<3, float>& d) -> wp::vec_t<3, float> {
    return wp::vec_t<3, float>(
        m.data[0][0] * d[0] + m.data[0][1] * d[1] + m.data[0][2] * d[2],
        m.data[1][0] * d[0] + m.data[1][1] * d[1] + m.data[1][2] * d[2],
        m.data[2][0] * d[0] + m.data[2][1] * d[1] + m.data[2][2] * d[2]
    );
};
