// The lane's ray has its closest hit: which instance and primitive that is.

auto write_hit = [&]() {
    const int face = rays.hit_primitive.data[slot];
    int instance = -1, primitive = -1;
    if (face >= 0) identify(TWO_LEVEL ? rays.hit_instance.data[slot] : 0, face, instance, primitive);
    else rays.hit_uv.data[slot] = wp::vec_t<2, float>(0.0f, 0.0f);
    rays.hit_t.data[slot] = best;
    rays.hit_instance.data[slot] = instance;
    rays.hit_primitive.data[slot] = primitive;
};
