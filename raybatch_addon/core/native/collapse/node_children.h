// The children of a wide node in their slots, of a binary tree on the device, and words that hold its links.
const double centre[3] = {middle[0], middle[1], middle[2]};
float box[8][6];
bool there[8];
double reach = 0.0;
for (int k = 0; k < 3; ++k) {
    const double from = centre[k] - (double)low.data[root][k], to = (double)high.data[root][k] - centre[k];
    reach = from > reach ? from : reach;
    reach = to > reach ? to : reach;
    for (int s = 0; s < 8; ++s) {
        there[s] = slots[s] >= 0;
        box[s][k] = there[s] ? low.data[slots[s]][k] : 0.0f;
        box[s][3 + k] = there[s] ? high.data[slots[s]][k] : 0.0f;
    }
}
unsigned int words[NODE_WORDS];
unsigned int* node = words;
node[3] = (unsigned int)links[0] << 24;
for (int k = 1; k < 5; ++k) node[3 + k] = (unsigned int)links[k];
