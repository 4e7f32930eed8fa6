// Estimates of the light that comes to `point` from nodes of the tree over emitters, and from suns and the world, which
// are distant. 0: surely none. The nodes of a block are compared with each other, at the top with all that is distant.
const auto& choice_table = *table.choice.data;
auto within = [](float x, float least, float most) { return wp::min(wp::max(x, least), most); };
const bool has_side = wp::dot(point.normal, point.normal) > 0.0f;  // a point in a volume has none

#if LINKS
// Whether bits of light sets have that of the point; -1: it has none, all light comes there, and there may be no bits.
const bool links = point.receiver >= 0;
auto is_linked = [&](wp::uint64 sets) { return ((sets >> point.receiver) & 1u) != 0u; };
auto is_distant_linked = [&](int number) {
    const auto& owners = choice_table.links.lights;
    const int emitter = choice_table.distant.data[number];
    return is_linked(owners.data[emitter < table.light_count ? emitter : owners.shape[0] - 1]);
};
#endif

#if LOCAL
// Nodes of a block at once: a vector on the CPU, of all or of the first few where there are no others; one after
// another on a GPU.
#if defined(__CUDA_ARCH__)
auto root = [](float x) { return wp::sqrt(x); };
auto absolute = [](float x) { return wp::abs(x); };
auto most = [](float x, float y) { return wp::max(x, y); };
auto least = [](float x, float y) { return wp::min(x, y); };
#else
typedef float Wide __attribute__((ext_vector_type(WIDTH)));
typedef float Few __attribute__((ext_vector_type(4)));
auto root = [](auto x) { return __builtin_elementwise_sqrt(x); };
auto absolute = [](auto x) { return __builtin_elementwise_abs(x); };
auto most = [](auto x, auto y) { return __builtin_elementwise_max(x, y); };
auto least = [](auto x, auto y) { return __builtin_elementwise_min(x, y); };
#endif
// The mean of max(cos, 0) over a sphere seen under a half angle whose sine has the square `spread`, about: `cosine` is
// that of its middle. At the horizon half the sphere is left, and its mean 2 / (3 pi) of the sine.
auto mean_cosine = [&](auto cosine, auto spread) { return 0.5f * (cosine + root(cosine * cosine + 0.18f * spread)); };
auto node_light = [&](const auto* node) {
    typedef decltype(node[0] + node[0]) Lanes;
    const Lanes zero = (Lanes)(0.0f), one = (Lanes)(1.0f), cosine_min = (Lanes)(COSINE_MIN);
    const Lanes x = node[FIELD_X] - point.position[0], y = node[FIELD_Y] - point.position[1],
                z = node[FIELD_Z] - point.position[2];
    const Lanes radius = node[FIELD_RADIUS], cos_axis = node[FIELD_COS_AXIS], sin_axis = node[FIELD_SIN_AXIS],
                cos_edge = node[FIELD_COS_EDGE], power = node[FIELD_POWER];
    const Lanes square = x * x + y * y + z * z, reach = radius * radius;
    // mean square of the distance to what is spread over the sphere
    const Lanes apart = square + (Lanes)(SPREAD)*reach;
    // else its root has lost its digits
    const auto is_sound = (apart > 1e-30f) & (apart < 1e37f);
    const Lanes sound = is_sound ? apart : one, inverse = one / root(sound), spread = reach / sound;
    const Lanes along = -(node[FIELD_AXIS_X] * x + node[FIELD_AXIS_Y] * y + node[FIELD_AXIS_Z] * z);
    const Lanes facing = node[FIELD_TWO_SIDED] > 0.0f ? absolute(along) : along;
    const auto is_directed = cos_axis > -1.0f;
    // cos(a - b - c) <= cos(a) + sin(b) + sin(c): none of its emitters is seen from a side that shines
    const auto is_dark = is_sound & is_directed & (square > reach) &
                         (facing + radius < (cos_edge - COSINE_ERROR - sin_axis) * root(is_sound ? square : one));
    // the normal in the cone that is nearest to the point
    Lanes leaving = facing * inverse;
    const Lanes beside = root(most(one - leaving * leaving, zero));
    leaving = leaving < cos_axis ? leaving * cos_axis + beside * sin_axis : one;
    // from within the sphere, emitters may be in any direction
    const Lanes inside = (Lanes)(INSIDE)*most(reach - square, zero) / most(reach, (Lanes)(1e-30f));
    auto turned = [&](auto cosine) {
        const auto mean = least(most(mean_cosine(cosine, spread), cosine_min), one);
        return mean + (one - mean) * inside;
    };
    Lanes arriving = (point.normal[0] * x + point.normal[1] * y + point.normal[2] * z) * inverse;
    if (point.both_sides) arriving = absolute(arriving);
    Lanes both = is_directed ? turned(leaving) : one;
    if (has_side) both = both * turned(arriving);
    const Lanes light = power * (is_sound ? both : one) / most(apart, (Lanes)(1e-30f));
    const Lanes bounded = least(most(light, (Lanes)(LEAST)), (Lanes)(MOST));
    const Lanes counted = ((power > 0.0f) & !is_dark) ? bounded : zero;
    return counted;
};
#endif

#if SUNS || WORLD
auto distant_estimate = [&](int number) -> float {
#if LINKS
    if (links && !is_distant_linked(number)) return 0.0f;
#endif
#if SUNS
    const int emitter = choice_table.distant.data[number];
    if (emitter < table.light_count) {
        float cosine = -wp::dot(table.lights.data[emitter].axis, point.normal);
        if (point.both_sides) cosine = wp::abs(cosine);
        if (!has_side) cosine = 1.0f;
        return within(choice_table.distant_strength.data[number] * wp::max(cosine, COSINE_MIN), LEAST, MOST);
    }
#endif
#if WORLD
    // irradiance by spherical harmonics (Ramamoorthi and Hanrahan 2001)
    const float* e = choice_table.world_irradiance.data;
    if (!has_side) return within(4.0f * e[0], LEAST, MOST);  // from all sides: four times the mean over all normals
    const float x = point.normal[0], y = point.normal[1], z = point.normal[2];
    const float even =
        e[0] + e[4] * x * y + e[5] * y * z + e[6] * (3.0f * z * z - 1.0f) + e[7] * x * z + e[8] * (x * x - y * y);
    const float odd = e[1] * y + e[2] * z + e[3] * x;
    return within(wp::max(even + (point.both_sides ? wp::abs(odd) : odd), COSINE_MIN * e[0]), LEAST, MOST);
#else
    return 0.0f;
#endif
};
#endif

// Estimates know nothing of what stands in the way, and where the brightest is hidden the others are all there is. So
// what may be hidden by itself counts, at the top, as the geometric mean of its light and of that with a part of all
// light added.
float hidden = 0.0f;  // that part; 0 until `weigh_top`, and where there is nothing to be compared with
#if SUNS || WORLD
float first_distant = 0.0f;  // estimate of the first distant emitter
auto counted_distant = [&](int number) -> float {
    const float light = number == 0 ? first_distant : distant_estimate(number);
    return wp::sqrt(light) * wp::sqrt(light + hidden);
};
auto all_distant = [&]() {
    float total = 0.0f;
    for (int number = 0; number < choice_table.distant_count; ++number) total += counted_distant(number);
    return total;
};
#endif
// Take in what the nodes of the top may bring, `local` together; returns what all that is distant counts for.
auto weigh_top = [&](float local) -> float {
    float estimated = local;
    int apart = 0;
#if LOCAL
    apart = choice_table.group_count;
#endif
#if SUNS || WORLD
    apart += choice_table.distant_count;
    if (choice_table.distant_count > 0) first_distant = distant_estimate(0);
    estimated += first_distant;
    for (int number = 1; number < choice_table.distant_count; ++number) estimated += distant_estimate(number);
#endif
    hidden = apart > 1 ? HIDDEN * estimated : 0.0f;
#if SUNS || WORLD
    return all_distant();
#else
    return 0.0f;
#endif
};
#if LOCAL
// Changes what each node of the top may bring to what its group, `count` nodes at most, may.
auto gather_groups = [&](auto& light, int count) {
    const int* leader = choice_table.hidden_with.data;
    float together[WIDTH] = {};
#pragma unroll 1
    for (int k = 0; k < count; ++k) together[leader[k]] += light[k];
#pragma unroll 1
    for (int k = 0; k < count; ++k) light[k] = together[leader[k]];
};
#endif

// What counts `light` of `total` gets a whole number of the DRAWS that a random number has, at least one; those that
// rounding leaves go to the first of those that are compared. So each is drawn exactly as often as it says.
auto draws_of = [](float light, float scale) -> int {
    return light > 0.0f ? wp::max(static_cast<int>(light * scale), 1) : 0;
};
// room for those that get one in spite of less, and for the rounding of sums
auto scale_of = [](float total, int count) { return static_cast<float>(DRAWS - 4 * count) / total; };

struct Shares {
    int draws[WIDTH + 1];  // the last: of what is distant, in the first block
    int first;             // the first that has any; WIDTH + 1: none
};
auto shares_in = [&](int block) {
    Shares shares;
    float distant = 0.0f, total = 0.0f;
    int left = DRAWS;
#if LOCAL && !defined(__CUDA_ARCH__)
    // sums by halves: the same whatever vectors the processor has, and whether nodes that are not there count as 0
    static_assert(WIDTH == 16, "halved twice to four");
    auto sum_of_four = [](auto of) {
        const auto two = of.lo + of.hi;
        return two.x + two.y;
    };
    auto sum = [&](auto of) {
        const auto eight = of.lo + of.hi;
        return sum_of_four(eight.lo + eight.hi);
    };
    auto weigh = [&](auto& light, int count, auto sum_of) {
        typedef decltype(light + light) Lanes;
        total = distant = weigh_top(sum_of(light));
        if (hidden == 0.0f) return;
        Lanes group = light;
        if (choice_table.group_count < choice_table.top_count) gather_groups(group, count);
        group = most(group, (Lanes)(LEAST));
        light = light * (root(group + hidden) / root(group));
    };
    auto share = [&](auto light, auto counts, auto sum_of) {
        typedef decltype(light + light) Lanes;
        total += sum_of(light);
        const auto draws =
            light > 0.0f
                ? __builtin_convertvector(most(light * scale_of(total, WIDTH + 1), (Lanes)(1.0f)), decltype(counts))
                : counts;
        left -= sum_of(draws);
        __builtin_memcpy(shares.draws, &draws, sizeof(draws));
    };
    typedef int WideCounts __attribute__((ext_vector_type(WIDTH)));
    typedef int FewCounts __attribute__((ext_vector_type(4)));
    const float* fields = choice_table.blocks.data + block * (FIELDS * WIDTH);
    Wide powers;
    __builtin_memcpy(&powers, fields + FIELD_POWER * WIDTH, sizeof(powers));
    powers.lo.lo = (Few)(0.0f);
    if (__builtin_reduce_max(powers) > 0.0f) {
        Wide node[FIELDS];
        __builtin_memcpy(node, fields, sizeof(node));
        Wide light = node_light(node);
#if LINKS
        for (int k = 0; links && k < WIDTH; ++k) {
            if (!is_linked(choice_table.links.nodes.data[block * WIDTH + k])) light[k] = 0.0f;
        }
#endif
        if (block == 0) weigh(light, WIDTH, sum);
        share(light, (WideCounts)(0), sum);
    } else {
        Few node[FIELDS];
        for (int field = 0; field < FIELDS; ++field)
            __builtin_memcpy(node + field, fields + field * WIDTH, sizeof(Few));
        Few light = node_light(node);
#if LINKS
        for (int k = 0; links && k < 4; ++k) {
            if (!is_linked(choice_table.links.nodes.data[block * WIDTH + k])) light[k] = 0.0f;
        }
#endif
        for (int k = 4; k < WIDTH; ++k) shares.draws[k] = 0;
        if (block == 0) weigh(light, 4, sum_of_four);
        share(light, (FewCounts)(0), sum_of_four);
    }
    const float scale = scale_of(total, WIDTH + 1);
#else
    float light[WIDTH];
#if LOCAL
    const float* fields = choice_table.blocks.data + block * (FIELDS * WIDTH);
#pragma unroll 1  // a GPU waits for instructions more than for memory
    for (int k = 0; k < WIDTH; ++k) {
        float node[FIELDS];
#pragma unroll
        for (int field = 0; field < FIELDS; ++field) node[field] = fields[field * WIDTH + k];
        light[k] = node_light(node);
#if LINKS
        if (links && !is_linked(choice_table.links.nodes.data[block * WIDTH + k])) light[k] = 0.0f;
#endif
        total += light[k];
    }
    if (block == 0) {
        distant = weigh_top(total);
        if (hidden > 0.0f) {
            float group[WIDTH];
#pragma unroll 1
            for (int k = 0; k < WIDTH; ++k) group[k] = light[k];
            gather_groups(group, WIDTH);
            total = 0.0f;
#pragma unroll 1
            for (int k = 0; k < WIDTH; ++k) {
                const float all = wp::max(group[k], LEAST);
                light[k] *= wp::sqrt(all + hidden) / wp::sqrt(all);
                total += light[k];
            }
        }
        total += distant;
    }
#else
    for (int k = 0; k < WIDTH; ++k) light[k] = 0.0f;
    total = distant = weigh_top(0.0f);
#endif
    const float scale = scale_of(total, WIDTH + 1);
#pragma unroll 1
    for (int k = 0; k < WIDTH; ++k) {
        shares.draws[k] = draws_of(light[k], scale);
        left -= shares.draws[k];
    }
#endif
    shares.draws[WIDTH] = draws_of(distant, scale);
    left -= shares.draws[WIDTH];
    shares.first = 0;
    while (shares.first <= WIDTH && shares.draws[shares.first] == 0) ++shares.first;
    if (shares.first <= WIDTH) shares.draws[shares.first] += left;
    return shares;
};
