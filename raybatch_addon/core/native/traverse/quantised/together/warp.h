// The lanes of a warp act and vote together: on CUDA each for itself, on a CPU LANES of them one after another.
//
// A lane comes to every vote, whether it has a ray or not, so that all lanes of a warp take the same turns. On a CPU the
// variables of one lane are in hand, and those of the others in `lanes`; a warp of one is always in hand. What lanes say
// of themselves is asked of `says`, a function of no arguments.

// What a lane says in the votes of a turn; 0: nothing
unsigned long long where = 0ull;  // address of the node that it wants to visit
unsigned peers = 0u;              // lanes that want the same
unsigned key = 0u;

#if defined(__CUDA_ARCH__)
auto each_lane = [&](auto act) { act(); };
auto vote = [&](auto says) -> unsigned { return ballot(says()); };
auto find_peers = [&]() { peers = __match_any_sync(ALL_LANES, where); };
auto largest = [&](auto says) -> unsigned {
#if __CUDA_ARCH__ >= 800
    return __reduce_max_sync(ALL_LANES, says());
#else
    unsigned most = says();
    for (int step = 16; step > 0; step >>= 1) {
        const unsigned other = __shfl_xor_sync(ALL_LANES, most, step);
        most = other > most ? other : most;
    }
    return most;
#endif
};
// what one lane says
auto heard_from = [&](unsigned lane, auto says) -> int { return __shfl_sync(ALL_LANES, says(), (int)lane); };
auto lanes_before = lanes_below;
auto draw = [&](int count) -> int {
    int first = 0;
    if (lanes_below() == 0u) first = atomicAdd(cursor.data, count);
    return __shfl_sync(ALL_LANES, first, 0);
};
constexpr unsigned WARP = ALL_LANES;
#else
constexpr unsigned WARP = LANES == 32 ? 0xffffffffu : (1u << LANES) - 1u;
int lane = 0;  // in hand
#if LANES > 1
struct Lane {
    int slot;
    Ray ray;
    float best;
    const Words *nodes, *triangles;
    unsigned node;
    Group inner, leaf, later;
    int depth;
    unsigned state;
    Group stack[STACK_SIZE + 4];
    unsigned char trail[TRAIL_SIZE];
#if MOTION
    BetweenSteps between;
#endif
#if COUNTERS
    int visits, boxes, tests, entered;
#endif
    unsigned long long where;
    unsigned peers, key;
};
Lane lanes[LANES];
// f(variable of the lane in hand, the same of `other`), for every one
auto with_each = [&](Lane& other, auto f) {
    f(slot, other.slot);
    f(ray, other.ray);
    f(best, other.best);
    f(nodes, other.nodes);
    f(triangles, other.triangles);
    f(node, other.node);
    f(inner, other.inner);
    f(leaf, other.leaf);
    f(later, other.later);
    f(depth, other.depth);
    f(state, other.state);
    for (int i = 0; i < depth; ++i) f(stack[i], other.stack[i]);
    for (int i = STACK_SIZE; i < STACK_SIZE + 4; ++i) f(stack[i], other.stack[i]);
    for (int i = 0; i < TRAIL_SIZE; ++i) f(trail[i], other.trail[i]);
#if MOTION
    f(between, other.between);
#endif
#if COUNTERS
    f(visits, other.visits);
    f(boxes, other.boxes);
    f(tests, other.tests);
    f(entered, other.entered);
#endif
    f(where, other.where);
    f(peers, other.peers);
    f(key, other.key);
};
auto put_away = [&]() { with_each(lanes[lane], [](auto& mine, auto& kept) { kept = mine; }); };
auto take_up = [&]() { with_each(lanes[lane], [](auto& mine, auto& kept) { mine = kept; }); };
for (lane = 0; lane < LANES; ++lane) put_away();
#else
auto put_away = []() {};
auto take_up = []() {};
#endif
auto each_lane = [&](auto act) {
    for (lane = 0; lane < LANES; ++lane) {
        take_up();
        act();
        put_away();
    }
};
auto ask_each = [&](auto hear) {
    for (lane = 0; lane < LANES; ++lane) {
        take_up();
        hear();
    }
};
auto vote = [&](auto says) -> unsigned {
    unsigned said = 0u;
    ask_each([&]() { said |= says() ? 1u << lane : 0u; });
    return said;
};
auto find_peers = [&]() {
    unsigned long long said[LANES];
    ask_each([&]() { said[lane] = where; });
    each_lane([&]() {
        peers = 0u;
        for (int other = 0; other < LANES; ++other) peers |= said[other] == where ? 1u << other : 0u;
    });
};
auto largest = [&](auto says) -> unsigned {
    unsigned most = 0u;
    ask_each([&]() { most = says() > most ? says() : most; });
    return most;
};
auto heard_from = [&](unsigned of, auto says) -> int {
    int said = 0;
    ask_each([&]() { said = (unsigned)lane == of ? says() : said; });
    return said;
};
auto lanes_before = [&]() -> unsigned { return (1u << lane) - 1u; };
auto draw = [&](int count) -> int {
    cursor.data[0] += count;
    return cursor.data[0] - count;
};
#endif
