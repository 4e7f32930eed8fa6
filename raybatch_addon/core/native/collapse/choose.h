// The least cost of covering each binary node by at most 1 to 7 parts, from the last node to the first; returns an
// error, or NO_ERROR.
static_assert(WIDTH == 8 && GROUPS_MAX == 8, "headers write both as numbers");
const int* T = (const int*)work.triangles.data;
const float* V = (const float*)work.positions.data;
for (int i = work.node_count - 1; i >= 0; --i) {
    const float chance = (float)(chance_of(i) + work.size_cost);
    float* C = work.cost.data + 8ll * i;
    unsigned char* D = work.choice.data + 8ll * i;
    if (N[i].count > 0) {
        if (N[i].count > (work.unit == WIDTH ? GROUPS_MAX * WIDTH : work.leaf_max)) return LEAF_TOO_LARGE;
        const float leaf = chance * work.unit_cost * (float)((N[i].count + work.unit - 1) / work.unit);
        for (int j = 0; j < 8; ++j) {
            C[j] = leaf;
            D[j] = j == 0;
        }
        work.below.data[i] = N[i].count;
        if (work.clipped) {
            double far = 0.0;
            for (int r = 0; r < N[i].count; ++r)
                for (int j = 0; j < 3; ++j)
                    for (int k = 0; k < 3; ++k) {
                        const double x =
                            (double)V[3ll * T[3ll * work.references.data[N[i].first + r] + j] + k] - work.centre[k];
                        far = x > far ? x : -x > far ? -x : far;
                    }
            work.reach.data[i] = above(far);
        }
        continue;
    }
    const int a = N[i].first;
    if (a <= i || a + 1 >= work.node_count) return CHILD_BEFORE_PARENT;
    const int below_i = work.below.data[a] + work.below.data[a + 1];
    work.below.data[i] = below_i;
    if (work.clipped) {
        const float* R = work.reach.data + a;
        work.reach.data[i] = R[0] > R[1] ? R[0] : R[1];
    }
    // cost of 2 to 8 parts, shared out between the two children
    const float* A = work.cost.data + 8ll * a;
    const float* B = A + 8;
    float best[9];
    int share[9];
    for (int j = 2; j <= 8; ++j) {
        int s = j / 2;
        float least = A[s - 1] + B[j - s - 1];
        for (int k = 1; k < j; ++k) {
            const float c = A[k - 1] + B[j - k - 1];
            if (c < least) {
                least = c;
                s = k;
            }
        }
        best[j] = least;
        share[j] = s;
    }
    const float inner = best[8] + chance * work.node_cost;
    const float leaf = chance * work.unit_cost * (float)((below_i + work.unit - 1) / work.unit);
    const bool merged = below_i <= work.leaf_max && leaf <= inner;
    C[0] = merged ? leaf : inner;
    D[0] = merged;
    for (int j = 2; j <= 7; ++j) {
        const bool more = best[j] < C[j - 2];
        C[j - 1] = more ? best[j] : C[j - 2];
        D[j - 1] = more ? share[j] : 0;
    }
    C[7] = best[8];
    D[7] = share[8];
}
return NO_ERROR;
