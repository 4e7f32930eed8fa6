// Variables for the children of node i: boxes, whether they are there, and `units` of leaves.
float box[8][6];
bool there[8];
int units[8];
auto widen = [](float* b, float x, int k, bool first) {
    b[k] = first || x < b[k] ? x : b[k];
    b[3 + k] = first || x > b[3 + k] ? x : b[3 + k];
};
