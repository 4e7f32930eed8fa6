"""Native text of `refit.py`: the boxes below a node, and the node written anew from them."""

from __future__ import annotations

import warp as wp

from .encode import ENCODE_BOXES, ENCODE_QUANTISED, ROUNDING
from .node import EMPTY_CHILD


@wp.struct
class RefitWork:
    """A tree that is refitted in place."""

    nodes: wp.array(dtype=wp.vec4)
    blocks: wp.array(dtype=wp.vec4)  # triangles, with their new vertices
    node_count: int
    boxes: wp.array(dtype=float)  # box of whole triangles below each node, absolute, shape [6 n]: low corner, high corner
    cost: wp.array(dtype=wp.float64)  # part of the `sah` of each node and its leaves
    node_cost: float
    unit_cost: float


# -> float box[8][6], bool there[8], int units[8] (of leaves) of the children of node i
_START = r"""
float box[8][6];
bool there[8];
int units[8];
auto widen = [](float* b, float x, int k, bool first) {
    b[k] = first || x < b[k] ? x : b[k];
    b[3 + k] = first || x > b[3 + k] ? x : b[3 + k];
};
"""

_CHILDREN_OF_BOXES = rf"""
{_START}
const int* child = (const int*)work.nodes.data + 64ll * i + 48;
for (int s = 0; s < 8; ++s) {{
    const int c = child[s];
    there[s] = c != {EMPTY_CHILD};
    units[s] = 0;
    if (c >= 0) {{
        for (int j = 0; there[s] && j < 6; ++j) box[s][j] = work.boxes.data[6ll * c + j];
        continue;
    }}
    units[s] = (~c & 7) + 1;
    bool first = true;
    for (int g = 0; g < units[s]; ++g) {{
        const float* rows = (const float*)work.blocks.data + 80ll * ((~c >> 3) + g);
        for (int lane = 0; lane < 8; ++lane)
            if (((const int*)rows)[72 + lane] >= 0) {{
                for (int row = 0; row < 9; ++row) widen(box[s], rows[8 * row + lane], row % 3, first && row < 3);
                first = false;
            }}
    }}
}}
"""

_CHILDREN_OF_QUANTISED = rf"""
{_START}
const unsigned int* words = (const unsigned int*)work.nodes.data + 20ll * i;
int inner = (int)words[4];
for (int s = 0; s < 8; ++s) {{
    const unsigned int meta = words[6 + s / 4] >> (8 * (s % 4)) & 255u;
    there[s] = meta != 0u;
    units[s] = 0;
    if (words[3] >> (24 + s) & 1u) {{
        for (int j = 0; j < 6; ++j) box[s][j] = work.boxes.data[6ll * inner + j];
        ++inner;
    }} else if (there[s]) {{
        // the count is in unary
        for (unsigned int bits = meta >> 5; bits; bits >>= 1) {{
            const float* v = (const float*)work.blocks.data + 12ll * (words[5] + (meta & 31u) + units[s]);
            for (int j = 0; j < 3; ++j)
                for (int k = 0; k < 3; ++k) widen(box[s], v[4 * j + k], k, units[s] == 0 && j == 0);
            ++units[s];
        }}
    }}
}}
"""

_JOIN = r"""
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
"""

# -> what `encode.py` reads, and the node's part of the cost
_MEASURE = r"""
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
"""


@wp.func_native(_CHILDREN_OF_BOXES + _JOIN)
def join_boxes(work: RefitWork, i: int): ...


@wp.func_native(_CHILDREN_OF_QUANTISED + _JOIN)
def join_quantised(work: RefitWork, i: int): ...


@wp.func_native(f"{ROUNDING}{_CHILDREN_OF_BOXES}{_MEASURE}float* node = (float*)work.nodes.data + 64ll * i;\n{ENCODE_BOXES}")
def write_boxes(work: RefitWork, i: int): ...


@wp.func_native(f"{ROUNDING}{_CHILDREN_OF_QUANTISED}{_MEASURE}unsigned int* node = (unsigned int*)work.nodes.data + 20ll * i;\n{ENCODE_QUANTISED}")
def write_quantised(work: RefitWork, i: int): ...
