// Origin, exponents and bytes (words 0 to 3 but for the mask, 8 to 19) of a node of QUANTISED; the mask is kept.
//
// Reads what boxes.h does, and writes `unsigned int* node`.
{
    const double grow = SLAB_MARGIN * reach;
    unsigned int exponents = 0u;
    for (int k = 0; k < 3; ++k) {
        float low[8], high[8], origin = 0.0f, top = 0.0f;
        bool any = false;
        for (int s = 0; s < 8; ++s)
            if (there[s]) {
                low[s] = below((double)box[s][k] - centre[k] - grow);
                high[s] = above((double)box[s][3 + k] - centre[k] + grow);
                origin = any && origin < low[s] ? origin : low[s];
                top = any && top > high[s] ? top : high[s];
                any = true;
            }
        // the smallest power of two, of normal numbers, whose 255 steps reach from the lowest plane to the highest
        Bits step;
        step.value = above(((double)top - (double)origin) / 255.0);
        int exponent = (int)((step.bits + 0x7fffffu) >> 23);
        exponent = exponent < 1 ? 1 : exponent > 254 ? 254 : exponent;
        Bits scale;
        scale.bits = (unsigned int)exponent << 23;
        if (exponent < 254 && origin + 255.0f * scale.value < top)
            scale.bits = (unsigned int)++exponent << 23;  // by rounding
        const double steps_per_unit = 1.0 / (double)scale.value;
        exponents |= (unsigned int)exponent << (8 * k);
        for (int half = 0; half < 2; ++half) {
            unsigned int low_bytes = 0u, high_bytes = 0u;
            for (int j = 0; j < 4; ++j) {
                const int s = 4 * half + j;
                int from = 255, to = 0;  // an empty slot is met by no ray
                if (there[s]) {
                    from = (int)(((double)low[s] - (double)origin) * steps_per_unit);
                    const double steps = ((double)high[s] - (double)origin) * steps_per_unit;
                    to = (int)steps;
                    to += (double)to < steps ? 1 : 0;
                    from = from > 255 ? 255 : from;
                    to = to > 255 ? 255 : to;
                    // as traversal decodes: the planes must enclose the box after rounding too
                    while (from > 0 && origin + (float)from * scale.value > low[s]) --from;
                    while (to < 255 && origin + (float)to * scale.value < high[s]) ++to;
                }
                low_bytes |= (unsigned int)from << (8 * j);
                high_bytes |= (unsigned int)to << (8 * j);
            }
            node[8 + 2 * k + half] = low_bytes;
            node[14 + 2 * k + half] = high_bytes;
        }
        Bits word;
        word.value = origin;
        node[k] = word.bits;
    }
    node[3] = (node[3] & 0xff000000u) | exponents;
}
