"""Native text of the passes that make a wide tree of a binary one (`collapse.py`), CPU only.

None of them recurses: `choose` runs from the last binary node to the first, `arrange` keeps a stack of wide nodes.
"""

from __future__ import annotations

import warp as wp

from .encode import ENCODE_BOXES, ENCODE_QUANTISED, ROUNDING
from .node import EMPTY_CHILD


@wp.struct
class CollapseWork:
    """What the passes share."""

    nodes: wp.array2d(dtype=float)  # binary nodes, shape [n, 8]
    node_count: int
    references: wp.array(dtype=int)
    positions: wp.array(dtype=wp.vec3)
    triangles: wp.array(dtype=wp.vec3i)  # none over entries
    centre: wp.vec3
    clipped: bool  # references were split: boxes may be smaller than their triangles, and leaves may list one twice
    reach: wp.array(dtype=float)  # if clipped: largest |vertex - centre| below each binary node
    node_cost: float
    unit_cost: float
    size_cost: float  # added to the chance that a node or a unit is met, for the memory that it takes
    unit: int  # references of a unit of a leaf
    leaf_max: int  # most references of a merged leaf
    cost: wp.array2d(dtype=float)  # of at most 1 to 7 parts, shape [n, 8]
    choice: wp.array2d(dtype=wp.uint8)  # shape [n, 8]; [0]: whether one part is a leaf; [j]: of j + 1 parts, those of the first child;
    # 0: j parts are as good
    below: wp.array(dtype=int)  # references below each binary node
    plan: wp.array2d(dtype=int)  # shape [wide nodes or more, 16]: binary node of each slot or -1, then BOXES: the word of each child; QUANTISED:
    # first child, first triangle, meta (2 words), mask
    order: wp.array2d(dtype=int)  # what leaves list, shape [units or more, references of a unit]; -1 fills units up
    found: wp.array(dtype=int)  # error, wide nodes, words of `order`, levels, leaves, references in leaves
    sah: wp.array(dtype=wp.float64)


_BINARY = r"""
struct Binary { float low[3]; int first; float high[3]; int count; };
const Binary* N = (const Binary*)work.nodes.data;
auto area_of = [&](int i) {
    const double x = (double)N[i].high[0] - N[i].low[0], y = (double)N[i].high[1] - N[i].low[1], z = (double)N[i].high[2] - N[i].low[2];
    return x * y + y * z + z * x;
};
const double root_area = area_of(0);
// the chance that a ray through the root's box meets box i; 1 when all lie on a line, without area
auto chance_of = [&](int i) { return root_area > 0.0 ? area_of(i) / root_area : 1.0; };
"""


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
return 0;
#else
{ROUNDING}
{_BINARY}
"""
    + r"""
const int* T = (const int*)work.triangles.data;
const float* V = (const float*)work.positions.data;
for (int i = work.node_count - 1; i >= 0; --i) {
    const float chance = (float)(chance_of(i) + work.size_cost);
    float* C = work.cost.data + 8ll * i;
    unsigned char* D = work.choice.data + 8ll * i;
    if (N[i].count > 0) {
        if (N[i].count > (work.unit == 8 ? 64 : work.leaf_max)) return 1;
        const float leaf = chance * work.unit_cost * (float)((N[i].count + work.unit - 1) / work.unit);
        for (int j = 0; j < 8; ++j) { C[j] = leaf; D[j] = j == 0; }
        work.below.data[i] = N[i].count;
        if (work.clipped) {
            double far = 0.0;
            for (int r = 0; r < N[i].count; ++r)
                for (int j = 0; j < 3; ++j)
                    for (int k = 0; k < 3; ++k) {
                        const double x = (double)V[3ll * T[3ll * work.references.data[N[i].first + r] + j] + k] - work.centre[k];
                        far = x > far ? x : -x > far ? -x : far;
                    }
            work.reach.data[i] = above(far);
        }
        continue;
    }
    const int a = N[i].first;
    if (a <= i || a + 1 >= work.node_count) return 2;
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
            if (c < least) { least = c; s = k; }
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
return 0;
#endif
"""
)
def choose(work: CollapseWork) -> int: ...


# What both arrangements do with a wide node: find its children, and write down what a leaf lists
_ARRANGE = r"""
const unsigned char* D = work.choice.data;
int node_count = 0, listed = 0, levels = 0, leaf_count = 0, reference_count = 0;
double sah = 0.0;
struct Part { int binary, parts; };
// the children of the wide node over binary node b, in the order of the binary tree
auto children_of = [&](int b, int* child) {
    int count = 0, open = 0;
    Part stack[16];
    if (N[b].count > 0) { child[0] = b; return 1; } // a root that is a leaf
    stack[open++] = {N[b].first + 1, 8 - D[8ll * b + 7]};
    stack[open++] = {N[b].first, D[8ll * b + 7]};
    while (open) {
        Part p = stack[--open];
        const unsigned char* d = D + 8ll * p.binary;
        while (p.parts > 1 && d[p.parts - 1] == 0) --p.parts;
        if (p.parts == 1) { child[count++] = p.binary; continue; }
        const int s = d[p.parts - 1];
        stack[open++] = {N[p.binary].first + 1, p.parts - s};
        stack[open++] = {N[p.binary].first, s};
    }
    return count;
};
// lists the references of the leaf over binary node b, each once; returns how many there are
auto list_leaf = [&](int b) {
    int stack[64], open = 0, count = 0;
    int* L = work.order.data + listed;
    stack[open++] = b;
    while (open) {
        const Binary& n = N[stack[--open]];
        if (n.count == 0) { stack[open++] = n.first + 1; stack[open++] = n.first; continue; }
        for (int r = 0; r < n.count; ++r) {
            const int id = work.references.data[n.first + r];
            bool seen = false;
            if (work.clipped) for (int q = 0; q < count; ++q) seen |= L[q] == id;
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
struct Wide { int binary, level, node, slot; };
// each level leaves at most seven siblings waiting
const int STACK = 512;
Wide stack[STACK];
int open = 0;
"""

_ARRANGED = r"""
int* F = work.found.data;
F[1] = node_count; F[2] = listed; F[3] = levels; F[4] = leaf_count; F[5] = reference_count;
work.sah.data[0] = sah;
return 0;
#endif
"""


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
return 0;
#else
{_BINARY}
{_ARRANGE}
const int EMPTY = {EMPTY_CHILD};
"""
    + r"""
stack[open++] = {0, 1, -1, 0}; // node and slot that hold it
while (open) {
    const Wide w = stack[--open];
    int child[8];
    const int count = children_of(w.binary, child);
    int* P = work.plan.data + 16ll * node_count;
    if (8ll * listed > 0x7fffff00ll * work.unit) return 4;
    if (w.node >= 0) work.plan.data[16ll * w.node + 8 + w.slot] = node_count;
    levels = w.level > levels ? w.level : levels;
    sah += chance_of(w.binary) * work.node_cost;
    for (int s = 0; s < 8; ++s) {
        P[s] = s < count ? child[s] : -1;
        P[8 + s] = EMPTY;
        if (s < count && D[8ll * child[s]]) {
            const int first = listed / work.unit;
            list_leaf(child[s]);
            P[8 + s] = ~(first * 8 + (listed / work.unit - first - 1));
        }
    }
    for (int s = count - 1; s >= 0; --s)
        if (!D[8ll * child[s]]) {
            if (open == STACK) return 3;
            stack[open++] = {child[s], w.level + 1, node_count, s};
        }
    ++node_count;
}
"""
    + _ARRANGED
)
def arrange_boxes(work: CollapseWork) -> int: ...


@wp.func_native(
    f"""
#if defined(__CUDA_ARCH__)
return 0;
#else
{_BINARY}
{_ARRANGE}
"""
    + r"""
stack[open++] = {0, 1, 0, 0}; // its own node
node_count = 1;
while (open) {
    const Wide w = stack[--open];
    int child[8];
    const int count = children_of(w.binary, child);
    int* P = work.plan.data + 16ll * w.node;
    levels = w.level > levels ? w.level : levels;
    sah += chance_of(w.binary) * work.node_cost;
    // Slots by octant (section 3.2 of the paper): a child is the better placed the farther it lies towards the slot's corner of the
    // node. The best pair of child and free slot is taken first.
    float offset[8][3];
    for (int c = 0; c < count; ++c)
        for (int k = 0; k < 3; ++k)
            offset[c][k] = 0.5f * (N[child[c]].low[k] - N[w.binary].low[k]) + 0.5f * (N[child[c]].high[k] - N[w.binary].high[k]);
    float gain[8][8];
    for (int c = 0; c < count; ++c)
        for (int s = 0; s < 8; ++s)
            gain[c][s] = (s & 4 ? offset[c][0] : -offset[c][0]) + (s & 2 ? offset[c][1] : -offset[c][1]) + (s & 1 ? offset[c][2] : -offset[c][2]);
    for (int s = 0; s < 8; ++s) P[s] = -1;
    bool placed[8] = {};
    for (int round = 0; round < count; ++round) {
        int best_c = -1, best_s = -1;
        for (int c = 0; c < count; ++c)
            for (int s = 0; s < 8; ++s)
                if (!placed[c] && P[s] < 0 && (best_c < 0 || gain[c][s] > gain[best_c][best_s])) { best_c = c; best_s = s; }
        placed[best_c] = true;
        P[best_s] = child[best_c];
    }
    unsigned char* meta = (unsigned char*)(P + 10);
    int mask = 0, inner = 0;
    P[8] = node_count;
    P[9] = listed;
    for (int s = 0; s < 8; ++s) {
        meta[s] = 0;
        if (P[s] < 0) continue;
        if (D[8ll * P[s]]) {
            const int offset = listed - P[9];
            meta[s] = (unsigned char)(((1 << list_leaf(P[s])) - 1) << 5 | offset);
        } else {
            meta[s] = (unsigned char)(1 << 5 | (24 + s));
            mask |= 1 << s;
            ++inner;
        }
    }
    P[12] = mask;
    if (open + inner > STACK) return 3;
    node_count += inner;
    for (int s = 7, i = node_count; s >= 0; --s)
        if (mask >> s & 1) stack[open++] = {P[s], w.level + 1, --i, s};
}
"""
    + _ARRANGED
)
def arrange_quantised(work: CollapseWork) -> int: ...


# The boxes of the children of wide node i
_CHILD_BOXES = r"""
const double centre[3] = {work.centre[0], work.centre[1], work.centre[2]};
for (int i = 0; i < work.found.data[1]; ++i) {
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
"""


@wp.func_native(
    f"""
#if !defined(__CUDA_ARCH__)
{ROUNDING}
{_BINARY}
{_CHILD_BOXES}
    float* node = (float*)nodes.data + 64ll * i;
    {ENCODE_BOXES}
    for (int s = 0; s < 8; ++s) {{
        ((int*)node)[48 + s] = P[8 + s];
        ((int*)node)[56 + s] = 0;
    }}
}}
#endif
"""
)
def fill_boxes(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)): ...


@wp.func_native(
    f"""
#if !defined(__CUDA_ARCH__)
{ROUNDING}
{_BINARY}
{_CHILD_BOXES}
    unsigned int* node = (unsigned int*)nodes.data + 20ll * i;
    node[3] = (unsigned int)P[12] << 24;
    for (int j = 0; j < 4; ++j) node[4 + j] = (unsigned int)P[8 + j];
    {ENCODE_QUANTISED}
}}
#endif
"""
)
def fill_quantised(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)): ...
