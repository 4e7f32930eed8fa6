// The boxes of the children of planned node i, as encode/boxes.h reads them.
const double centre[3] = {work.centre[0], work.centre[1], work.centre[2]};
const int* P = work.plan.data + 16ll * i;
float box[8][6];
bool there[8];
double reach = 0.0;
for (int s = 0; s < 8; ++s) {
    there[s] = P[s] >= 0;
    if (!there[s]) continue;
    for (int k = 0; k < 3; ++k) {
        box[s][k] = N[P[s]].low[k];
        box[s][3 + k] = N[P[s]].high[k];
        const double from = centre[k] - box[s][k], to = box[s][3 + k] - centre[k];
        reach = from > reach ? from : reach;
        reach = to > reach ? to : reach;
    }
    if (work.clipped && work.reach.data[P[s]] > reach) reach = work.reach.data[P[s]];
}
