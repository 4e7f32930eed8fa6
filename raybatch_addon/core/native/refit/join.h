// The box of node i, around those of its children.
bool first = true;
float* joined = work.boxes.data + 6ll * i;
for (int s = 0; s < 8; ++s)
    if (there[s]) {
        for (int k = 0; k < 3; ++k) {
            widen(joined, box[s][k], k, first);
            widen(joined, box[s][3 + k], k, false);
        }
        first = false;
    }
