// Steps that both arrangements take at a wide node: find its children, write down what a leaf lists.
const unsigned char* D = work.choice.data;
int node_count = 0, listed = 0, levels = 0, leaf_count = 0, reference_count = 0;
double sah = 0.0;
struct Part {
    int binary, parts;
};
// the children of the wide node over binary node b, in the order of the binary tree
auto children_of = [&](int b, int* child) {
    int count = 0, open = 0;
    Part stack[16];
    // a root that is a leaf
    if (N[b].count > 0) {
        child[0] = b;
        return 1;
    }
    stack[open++] = {N[b].first + 1, 8 - D[8ll * b + 7]};
    stack[open++] = {N[b].first, D[8ll * b + 7]};
    while (open) {
        Part p = stack[--open];
        const unsigned char* d = D + 8ll * p.binary;
        while (p.parts > 1 && d[p.parts - 1] == 0) --p.parts;
        if (p.parts == 1) {
            child[count++] = p.binary;
            continue;
        }
        const int s = d[p.parts - 1];
        stack[open++] = {N[p.binary].first + 1, p.parts - s};
        stack[open++] = {N[p.binary].first, s};
    }
    return count;
};
// lists the references of the leaf over binary node b, each once; returns how many there are
auto list_leaf = [&](int b) {
    int stack[DEPTH_MAX + 1], open = 0, count = 0;
    int* L = work.order.data + listed;
    stack[open++] = b;
    while (open) {
        const Binary& n = N[stack[--open]];
        if (n.count == 0) {
            stack[open++] = n.first + 1;
            stack[open++] = n.first;
            continue;
        }
        for (int r = 0; r < n.count; ++r) {
            const int id = work.references.data[n.first + r];
            bool seen = false;
            if (work.clipped)
                for (int q = 0; q < count; ++q) seen |= L[q] == id;
            if (!seen) L[count++] = id;
        }
    }
    leaf_count++;
    reference_count += count;
    const int units = (count + work.unit - 1) / work.unit;
    for (int q = count; q < units * work.unit; ++q) L[q] = -1;
    listed += units * work.unit;
    sah += chance_of(b) * work.unit_cost * units;
    return count;
};
struct Wide {
    int binary, level, node, slot;
};
// each level leaves at most seven siblings waiting
const int STACK = 8 * (DEPTH_MAX + 1);
Wide stack[STACK];
int open = 0;
