// Nodes of a binary tree, and the chance that a ray meets one.
struct Binary {
    float low[3];
    int first;
    float high[3];
    int count;
};
const Binary* N = (const Binary*)work.nodes.data;
auto area_of = [&](int i) {
    const double x = (double)N[i].high[0] - N[i].low[0], y = (double)N[i].high[1] - N[i].low[1],
                 z = (double)N[i].high[2] - N[i].low[2];
    return x * y + y * z + z * x;
};
const double root_area = area_of(0);
// the chance that a ray through the root's box meets box i; 1 when all lie on a line, without area
auto chance_of = [&](int i) { return root_area > 0.0 ? area_of(i) / root_area : 1.0; };
