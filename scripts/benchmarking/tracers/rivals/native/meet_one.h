// Distance and weights of the triangle (a, b, c) for the ray (o, d); a distance of 0 where it is missed.
const ShearedRay sheared = shear_ray(o[0], o[1], o[2], d[0], d[1], d[2]);
float t = 0.0f, v = 0.0f, w = 0.0f;
const bool met =
    meet_triangle(sheared, Corner{a[0], a[1], a[2]}, Corner{b[0], b[1], b[2]}, Corner{c[0], c[1], c[2]}, t, v, w);
return met ? wp::vec_t<3, float>(t, v, w) : wp::vec_t<3, float>(0.0f, 0.0f, 0.0f);
