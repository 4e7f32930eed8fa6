// The planes (words 0 to 47) of a node of BOXES.
//
// Reads, as quantised.h does, so that both devices write the same bits:
//
//     float box[8][6]     lower and upper corner of each child, absolute
//     bool there[8]       whether the slot has a child
//     double reach        largest |coordinate - centre| of the triangles below the node
//     double centre[3]
//
// and writes `float* node`.
{
    const double grow = SLAB_MARGIN * reach;
    Bits infinity;
    infinity.bits = 0x7f800000u;
    for (int k = 0; k < 3; ++k)
        for (int s = 0; s < 8; ++s) {
            node[16 * k + s] = there[s] ? below((double)box[s][k] - centre[k] - grow) : infinity.value;
            node[16 * k + 8 + s] = there[s] ? above((double)box[s][3 + k] - centre[k] + grow) : -infinity.value;
        }
}
