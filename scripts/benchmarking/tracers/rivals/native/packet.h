// A packet: its rays in blocks of eight, and the interval arithmetic of all of them together.

struct alignas(64) Block {
    Floats inverse[3], low[3], high[3];  // the lower plane p is met at fma(p, inverse, low), the upper with `high`
    Floats best;                         // -1: nothing is asked any more
};
// Bounds of the rays along one axis, if they all go the same way: (plane - from) * rate is below the near plane's
// distance of every ray; likewise the far plane's is below (plane - to) * rate
struct Bounds {
    int row;  // of the near planes; the far ones are at row ^ 32
    float from, from_rate[2], to, to_rate[2];  // rates where plane - from is negative, and where it is not
};
struct Packet {
    Ray* rays;
    Block* blocks;
    int count, block_count, axes;
    Bounds bounds[3];
};
auto least_of = [&](Floats a) INLINE -> float {
    float x = a[0];
    for (int k = 1; k < 8; ++k) x = a[k] < x ? a[k] : x;
    return x;
};
auto most_of = [&](Floats a) INLINE -> float {
    float x = a[0];
    for (int k = 1; k < 8; ++k) x = a[k] > x ? a[k] : x;
    return x;
};
// Blocks and bounds of `count` rays, at least one. The last block is filled with its last ray, which asks nothing there.
//
// The bounds' roundings are 4 of |o| and 3 of |p|, of planes p and origins o relative to the tree's centre, and another
// of |o| for the quotient; `margin.py` leaves 13 and 13.
auto assemble = [&](Packet& packet, int count) {
    packet.count = count;
    packet.block_count = (count + 7) >> 3;
    for (int i = 0; i < packet.block_count * 8; ++i) {
        const Ray& ray = packet.rays[i < count ? i : count - 1];
        Block& block = packet.blocks[i >> 3];
        for (int k = 0; k < 3; ++k) {
            const bool negative = ray.octant >> k & 1;
            ((float*)&block.inverse[k])[i & 7] = ray.inverse[k];
            ((float*)&block.low[k])[i & 7] = negative ? ray.far[k] : ray.near[k];
            ((float*)&block.high[k])[i & 7] = negative ? ray.near[k] : ray.far[k];
        }
        ((float*)&block.best)[i & 7] = i < count ? ray.best : -1.0f;
    }
    packet.axes = 0;
    for (int k = 0; k < 3; ++k) {
        Floats rate_least = packet.blocks[0].inverse[k], rate_most = rate_least;
        Floats low_least = all(__builtin_inff()), low_most = -low_least, high_least = low_least, high_most = low_most;
        for (int b = 0; b < packet.block_count; ++b) {
            const Block& block = packet.blocks[b];
            const Floats low = -block.low[k] / block.inverse[k], high = -block.high[k] / block.inverse[k];
            rate_least = smaller(rate_least, block.inverse[k]);
            rate_most = larger(rate_most, block.inverse[k]);
            low_least = smaller(low_least, low);
            low_most = larger(low_most, low);
            high_least = smaller(high_least, high);
            high_most = larger(high_most, high);
        }
        const float least = least_of(rate_least), most = most_of(rate_most);
        if (least < 0.0f && most > 0.0f) continue;
        Bounds& bounds = packet.bounds[packet.axes++];
        const bool negative = most < 0.0f;
        bounds.row = 64 * k + 32 * negative;
        // a distance is (plane - origin) * rate
        bounds.from = negative ? least_of(high_least) : most_of(low_most);
        bounds.to = negative ? most_of(low_most) : least_of(high_least);
        bounds.from_rate[0] = bounds.to_rate[1] = most;
        bounds.from_rate[1] = bounds.to_rate[0] = least;
    }
};
// Which children of the node at `p` some ray of the packet may meet before `limit`
auto meet_together = [&](const Packet& packet, const char* p, float limit) INLINE -> unsigned {
    Floats enter = all(0.0f), leave = all(limit);
    for (int axis = 0; axis < packet.axes; ++axis) {
        const Bounds& b = packet.bounds[axis];
        const Floats near = *(const Floats*)(p + b.row) - all(b.from), far = *(const Floats*)(p + (b.row ^ 32)) - all(b.to);
        enter = larger(enter, near * (near < 0.0f ? all(b.from_rate[0]) : all(b.from_rate[1])));
        leave = smaller(leave, far * (far < 0.0f ? all(b.to_rate[0]) : all(b.to_rate[1])));
    }
    return at_most(enter, leave) & ~negative(*(const Ints*)(p + NODE_CHILD) == all_ints(EMPTY_CHILD));
};
// Which rays of a block meet the child `k`, which there is, of the node at `p`
auto meet_child = [&](const Block& block, const char* p, int k) INLINE -> unsigned {
    Floats enter = all(0.0f), leave = block.best;
    for (int axis = 0; axis < 3; ++axis) {
        const float* planes = (const float*)(p + 64 * axis) + k;
        const Floats a = fused(all(planes[0]), block.inverse[axis], block.low[axis]);
        const Floats b = fused(all(planes[8]), block.inverse[axis], block.high[axis]);
        enter = larger(smaller(a, b), enter);
        leave = smaller(larger(a, b), leave);
    }
    return at_most(enter, leave);
};
// The largest distance that any ray still asks for
auto limit_of = [&](const Packet& packet) INLINE -> float {
    Floats most = packet.blocks[0].best;
    for (int b = 1; b < packet.block_count; ++b) most = larger(most, packet.blocks[b].best);
    return most_of(most);
};
// What the rays `ids` found, for the next boxes
auto note_hits = [&](Packet& packet, const Id* ids, int count) INLINE {
    for (int i = 0; i < count; ++i) ((float*)packet.blocks)[(ids[i] >> 3) * (sizeof(Block) / 4) + 72 + (ids[i] & 7)] =
        packet.rays[ids[i]].best;
};
static_assert(sizeof(Block) == 320 && __builtin_offsetof(Block, best) == 288, "best is what note_hits writes");
