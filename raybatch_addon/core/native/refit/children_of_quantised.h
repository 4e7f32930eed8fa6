// Boxes and units of the children of node i, of QUANTISED.
unsigned int* node = (unsigned int*)work.nodes.data + NODE_WORDS * (long long)i;
int inner = (int)node[4];
for (int s = 0; s < 8; ++s) {
    const unsigned int meta = node[6 + s / 4] >> (8 * (s % 4)) & 255u;
    there[s] = meta != 0u;
    units[s] = 0;
    if (node[3] >> (24 + s) & 1u) {
        for (int j = 0; j < 6; ++j) box[s][j] = work.boxes.data[6ll * inner + j];
        ++inner;
    } else if (there[s]) {
        // the count is in unary
        for (unsigned int bits = meta >> 5; bits; bits >>= 1) {
            for (int step = 0; step < work.step_count; ++step) {
                const long long unit = node[5] + (meta & 31u) + units[s] + (long long)step * work.unit_count;
                const float* v = (const float*)work.blocks.data + UNIT_WORDS * unit;
                for (int j = 0; j < 3; ++j)
                    for (int k = 0; k < 3; ++k) widen(box[s], v[4 * j + k], k, units[s] == 0 && step == 0 && j == 0);
            }
            ++units[s];
        }
    }
}
