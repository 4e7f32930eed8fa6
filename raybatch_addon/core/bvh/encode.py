"""Writing the blocks of a tree, for CPU and CUDA: child boxes become nodes, vertices are placed in triangle blocks.

The text of `ENCODE_BOXES` and `ENCODE_QUANTISED` is put inside native functions that have found the boxes: of a binary
tree when a tree is made, of the triangles and nodes below when it is refitted. It reads

    float box[8][6]     lower and upper corner of each child, absolute
    bool there[8]       whether the slot has a child
    double reach        largest |coordinate - centre| of the triangles below the node
    double centre[3]

and computes in float64, so that both devices write the same bits.
"""

import numpy as np
import warp as wp

from ..kernel import KERNEL_OPTIONS
from .margin import SLAB_MARGIN

ROUNDING = r"""
union Bits { float value; unsigned int bits; };
// the largest float32 that is not above x, and the smallest that is not below
auto below = [](double x) {
    Bits r; r.value = (float)x;
    if ((double)r.value > x) r.bits = r.value > 0.0f ? r.bits - 1u : r.value < 0.0f ? r.bits + 1u : 0x80000001u;
    return r.value;
};
auto above = [&](double x) { return -below(-x); };
"""

# -> float* node: the planes (words 0 to 47) of a node of BOXES
ENCODE_BOXES = rf"""{{
    const double grow = {SLAB_MARGIN!r} * reach;
    Bits infinity;
    infinity.bits = 0x7f800000u;
    for (int k = 0; k < 3; ++k)
        for (int s = 0; s < 8; ++s) {{
            node[16 * k + s] = there[s] ? below((double)box[s][k] - centre[k] - grow) : infinity.value;
            node[16 * k + 8 + s] = there[s] ? above((double)box[s][3 + k] - centre[k] + grow) : -infinity.value;
        }}
}}"""

# -> unsigned int* node: origin, exponents and bytes (words 0 to 3 but for the mask, 8 to 19) of a node of QUANTISED; the mask is kept
ENCODE_QUANTISED = rf"""{{
    const double grow = {SLAB_MARGIN!r} * reach;
    unsigned int exponents = 0u;
    for (int k = 0; k < 3; ++k) {{
        float low[8], high[8], origin = 0.0f, top = 0.0f;
        bool any = false;
        for (int s = 0; s < 8; ++s)
            if (there[s]) {{
                low[s] = below((double)box[s][k] - centre[k] - grow);
                high[s] = above((double)box[s][3 + k] - centre[k] + grow);
                origin = any && origin < low[s] ? origin : low[s];
                top = any && top > high[s] ? top : high[s];
                any = true;
            }}
        // the smallest power of two, of normal numbers, whose 255 steps reach from the lowest plane to the highest
        Bits step; step.value = above(((double)top - (double)origin) / 255.0);
        int exponent = (int)((step.bits + 0x7fffffu) >> 23);
        exponent = exponent < 1 ? 1 : exponent > 254 ? 254 : exponent;
        Bits scale; scale.bits = (unsigned int)exponent << 23;
        if (exponent < 254 && origin + 255.0f * scale.value < top) scale.bits = (unsigned int)++exponent << 23; // by rounding
        const double steps_per_unit = 1.0 / (double)scale.value;
        exponents |= (unsigned int)exponent << (8 * k);
        for (int half = 0; half < 2; ++half) {{
            unsigned int low_bytes = 0u, high_bytes = 0u;
            for (int j = 0; j < 4; ++j) {{
                const int s = 4 * half + j;
                int from = 255, to = 0; // an empty slot is met by no ray
                if (there[s]) {{
                    from = (int)(((double)low[s] - (double)origin) * steps_per_unit);
                    const double steps = ((double)high[s] - (double)origin) * steps_per_unit;
                    to = (int)steps;
                    to += (double)to < steps ? 1 : 0;
                    from = from > 255 ? 255 : from;
                    to = to > 255 ? 255 : to;
                    // as traversal decodes: the planes must enclose the box after rounding too
                    while (from > 0 && origin + (float)from * scale.value > low[s]) --from;
                    while (to < 255 && origin + (float)to * scale.value < high[s]) ++to;
                }}
                low_bytes |= (unsigned int)from << (8 * j);
                high_bytes |= (unsigned int)to << (8 * j);
            }}
            node[8 + 2 * k + half] = low_bytes;
            node[14 + 2 * k + half] = high_bytes;
        }}
        Bits word; word.value = origin;
        node[k] = word.bits;
    }}
    node[3] = (node[3] & 0xff000000u) | exponents;
}}"""


@wp.func_native("""
    // row 9 of a group names its triangles; rows 0 to 8 are the coordinates of their corners
    float* rows = (float*)blocks.data + 80ll * i;
    for (int lane = 0; lane < 8; ++lane) {
        const int face = ((const int*)rows)[72 + lane];
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k)
                rows[8 * (3 * j + k) + lane] = face < 0 ? 0.0f : positions.data[triangles.data[face][j]][k];
    }
""")
def place_group(i: int, blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)): ...


@wp.func_native("""
    float* words = (float*)blocks.data + 12ll * i;
    const int face = ((const int*)words)[3];
    for (int j = 0; j < 3; ++j) {
        for (int k = 0; k < 3; ++k) words[4 * j + k] = positions.data[triangles.data[face][j]][k];
        if (j > 0) words[4 * j + 3] = 0.0f;
    }
""")
def place_triangle(
    i: int, blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
): ...


@wp.kernel(**KERNEL_OPTIONS)
def place_groups_kernel(
    blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
):
    """Vertices into groups of triangles of BOXES, by their faces (one thread a group)."""
    place_group(wp.tid(), blocks, positions, triangles)


@wp.kernel(**KERNEL_OPTIONS)
def place_triangles_kernel(
    blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
):
    """Vertices into triangles of QUANTISED, by their faces (one thread a triangle)."""
    place_triangle(wp.tid(), blocks, positions, triangles)


def as_vectors(words: np.ndarray) -> wp.array:
    """The memory of nodes or triangle blocks as kernels on the CPU take it."""
    return wp.array(words.view(np.float32).reshape(-1, 4), dtype=wp.vec4, device="cpu", copy=False)
