// A ray meets the children of a quantised node (`node.py`).

constexpr unsigned long long NODE = NODE_WORDS, TRIANGLE = TRIANGLE_WORDS;  // in Words
// Which children of a node (words a to e) a ray meets before `limit`: in bits 24 to 31 inner nodes, the one to visit
// first highest; in bits 0 to 23 triangles of leaves.
//
// On CUDA distances are compared as the integers of their bits, three at once. Below 0 these have another order, but
// there an exit is a miss whatever it is, and an entry counts as 0.
auto meet_node = [&](const Ray& r, float limit, const Words& a, const Words& b, const Words& c, const Words& d,
                     const Words& e) -> unsigned {
    const float sx = as_float(((a.w << 23) + BYTE_EXPONENT) & 0x7f800000u) * r.ix;
    const float sy = as_float(((a.w << 15) + BYTE_EXPONENT) & 0x7f800000u) * r.iy;
    const float sz = as_float(((a.w << 7) + BYTE_EXPONENT) & 0x7f800000u) * r.iz;
    const float nx = fused(as_float(a.x), r.ix, r.nx), fx = nx + fabsf(r.ix * r.late);
    const float ny = fused(as_float(a.y), r.iy, r.ny), fy = ny + fabsf(r.iy * r.late);
    const float nz = fused(as_float(a.z), r.iz, r.nz), fz = nz + fabsf(r.iz * r.late);
    unsigned hits = 0u;
#pragma unroll
    for (int half = 0; half < 2; ++half) {
        const unsigned low_x = half ? c.y : c.x, low_y = half ? c.w : c.z, low_z = half ? d.y : d.x;
        const unsigned high_x = half ? d.w : d.z, high_y = half ? e.y : e.x, high_z = half ? e.w : e.z;
        float near_x[4], near_y[4], near_z[4], far_x[4], far_y[4], far_z[4];
        unpack(r.ix < 0.0f ? high_x : low_x, near_x);
        unpack(r.ix < 0.0f ? low_x : high_x, far_x);
        unpack(r.iy < 0.0f ? high_y : low_y, near_y);
        unpack(r.iy < 0.0f ? low_y : high_y, far_y);
        unpack(r.iz < 0.0f ? high_z : low_z, near_z);
        unpack(r.iz < 0.0f ? low_z : high_z, far_z);
        // The bit of `hits` that is a child's first. Only an inner node's has bits 3 and 4 set: its child slot becomes
        // its rank in the ray's order.
        const unsigned meta = half ? b.w : b.z;
        const unsigned inner = (meta & (meta << 1)) & 0x10101010u;
        const unsigned first_bit = meta ^ (r.order & ((inner >> 4) * 0x07u));
        const unsigned count = (meta >> 5) & 0x07070707u;
#pragma unroll
        for (int j = 0; j < 4; ++j) {
            const float x0 = fused(near_x[j], sx, nx), x1 = fused(far_x[j], sx, fx);
            const float y0 = fused(near_y[j], sy, ny), y1 = fused(far_y[j], sy, fy);
            const float z0 = fused(near_z[j], sz, nz), z1 = fused(far_z[j], sz, fz);
#if defined(__CUDA_ARCH__)
            const int enter = __vimax3_s32_relu(as_bits(x0), as_bits(y0), as_bits(z0));
            const int leave = __vimin3_s32(as_bits(x1), as_bits(y1), min(as_bits(z1), as_bits(limit)));
            // added where enter <= leave, by the units for products: those for integers have more to do than any other
            unsigned shift;
            asm("shf.l.wrap.b32 %0, 0, 1, %1;" : "=r"(shift) : "r"(first_bit >> (8 * j)));
            asm("{ .reg .pred met; setp.le.s32 met, %1, %2; @met mad.lo.u32 %0, %3, %4, %0; }"
                : "+r"(hits)
                : "r"(enter), "r"(leave), "r"(__byte_perm(count, 0u, 0x4440 + j)), "r"(shift));
#else
            const float enter = larger(larger(x0, y0), larger(z0, 0.0f));
            const float leave = smaller(smaller(x1, y1), smaller(z1, limit));
            if (enter <= leave) hits += ((count >> (8 * j)) & 255u) << ((first_bit >> (8 * j)) & 31u);
#endif
        }
    }
    return hits;
};
