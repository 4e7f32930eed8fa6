// Boxes and units of the children of node i, of BOXES.
float* node = (float*)((char*)work.nodes.data + NODE_BYTES * (long long)i);
const int* child = (const int*)((const char*)node + NODE_CHILD);
for (int s = 0; s < 8; ++s) {
    const int c = child[s];
    there[s] = c != EMPTY_CHILD;
    units[s] = 0;
    if (c >= 0) {
        for (int j = 0; there[s] && j < 6; ++j) box[s][j] = work.boxes.data[6ll * c + j];
        continue;
    }
    units[s] = (~c & 7) + 1;
    bool first = true;
    for (int g = 0; g < units[s]; ++g) {
        for (int step = 0; step < work.step_count; ++step) {
            const long long unit = (~c >> 3) + g + (long long)step * work.unit_count;
            const char* group = (const char*)work.blocks.data + GROUP_BYTES * unit;
            const float* rows = (const float*)group;
            for (int lane = 0; lane < 8; ++lane)
                if (((const int*)(group + GROUP_FACE))[lane] >= 0) {
                    for (int row = 0; row < 9; ++row) widen(box[s], rows[8 * row + lane], row % 3, first && row < 3);
                    first = false;
                }
        }
    }
}
