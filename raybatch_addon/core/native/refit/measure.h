// Centre and reach of node i as encode/boxes.h reads them, and its part of the cost.
const float* root = work.boxes.data;
auto area_of = [](const float* b) {
    const double x = (double)b[3] - b[0], y = (double)b[4] - b[1], z = (double)b[5] - b[2];
    return x * y + y * z + z * x;
};
const double root_area = area_of(root);
auto chance_of = [&](const float* b) { return root_area > 0.0 ? area_of(b) / root_area : 1.0; };
double centre[3], reach = 0.0;
for (int k = 0; k < 3; ++k) {
    centre[k] = (double)(float)(((double)root[k] + (double)root[3 + k]) / 2.0);
    const double from = centre[k] - work.boxes.data[6ll * i + k], to = work.boxes.data[6ll * i + 3 + k] - centre[k];
    reach = from > reach ? from : reach;
    reach = to > reach ? to : reach;
}
double cost = chance_of(work.boxes.data + 6ll * i) * work.node_cost;
for (int s = 0; s < 8; ++s)
    if (units[s]) cost += chance_of(box[s]) * work.unit_cost * units[s];
work.cost.data[i] = cost;
