// Rounding of float64 to float32 downwards and upwards.
union Bits {
    float value;
    unsigned int bits;
};
// the largest float32 that is not above x, and the smallest that is not below
auto below = [](double x) {
    Bits r;
    r.value = (float)x;
    if ((double)r.value > x) r.bits = r.value > 0.0f ? r.bits - 1u : r.value < 0.0f ? r.bits + 1u : 0x80000001u;
    return r.value;
};
auto above = [&](double x) { return -below(-x); };
