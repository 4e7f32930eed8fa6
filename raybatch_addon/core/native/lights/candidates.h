// Estimates of the light that comes to `point` from nodes of the tree over emitters, and from suns and the world, which
// are distant. 0: surely none. The nodes of a block are compared with each other, at the top with all that is distant.
const auto& choice_table = *table.choice.data;
auto within = [](float x, float low, float high) { return wp::min(wp::max(x, low), high); };
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
// as one instruction: y where x is no number
auto most = [](auto x, auto y) { return x > y ? x : y; };
auto least = [](auto x, auto y) { return x < y ? x : y; };
#endif
auto node_light = [&](const auto* node) {
    typedef decltype(node[0] + node[0]) Lanes;
    const Lanes zero = (Lanes)(0.0f), one = (Lanes)(1.0f);
    const Lanes x = node[FIELD_X] - point.position[0], y = node[FIELD_Y] - point.position[1],
                z = node[FIELD_Z] - point.position[2];
    const Lanes radius = node[FIELD_RADIUS], power = node[FIELD_POWER];
    const Lanes square = x * x + y * y + z * z, reach = radius * radius;
    // mean square of the distance to what is spread over the sphere
    const Lanes apart = square + (Lanes)(SPREAD)*reach;
    // else its root has lost its digits
    const auto is_sound = (apart > 1e-30f) & (apart < 1e37f);
    const Lanes sound = least(most(apart, (Lanes)(1e-30f)), (Lanes)(1e37f));
    // Cosines are multiplied by this length until the end: so roots and the reciprocal do not wait for each other.
    const Lanes length = root(sound), inverse = one / sound;
    // from within the sphere, emitters may be in any direction
    const Lanes inside = (Lanes)(INSIDE)*most(reach - square, zero) / most(reach, (Lanes)(1e-30f));
    // The mean of max(cos, 0) over a sphere seen under a half angle whose sine has the square reach / sound, about. At
    // the horizon half the sphere is left, and its mean 2 / (3 pi) of the sine.
    auto turned = [&](auto cosine) {
        const auto mean = 0.5f * (cosine + root(cosine * cosine + 0.18f * reach));
        const auto within_one = least(most(mean, length * COSINE_MIN), length);
        return within_one + (length - within_one) * inside;
    };
    Lanes leave = length, arrive = length;
    auto counts = power > 0.0f;
#if DIRECTED
    const Lanes cos_axis = node[FIELD_COS_AXIS], sin_axis = node[FIELD_SIN_AXIS];
    const Lanes along = -(node[FIELD_AXIS_X] * x + node[FIELD_AXIS_Y] * y + node[FIELD_AXIS_Z] * z);
    const Lanes facing = node[FIELD_TWO_SIDED] > 0.0f ? absolute(along) : along;
    const auto is_directed = cos_axis > -1.0f;
    // cos(a - b - c) <= cos(a) + sin(b) + sin(c): none of its emitters is seen from a side that shines. Squares that
    // keep their signs are compared, for roots take long.
    const Lanes most_facing = facing + radius, edge = node[FIELD_COS_EDGE] - COSINE_ERROR - sin_axis;
    counts = counts & !(is_sound & is_directed & (square > reach) &
                        (most_facing * absolute(most_facing) < edge * absolute(edge) * square));
    // the normal in the cone that is nearest to the point
    const Lanes beside = root(most(sound - facing * facing, zero));
    const Lanes nearest = facing < cos_axis * length ? facing * cos_axis + beside * sin_axis : length;
    leave = is_directed ? turned(nearest) : length;
#endif
    if (has_side) {
        const Lanes above = point.normal[0] * x + point.normal[1] * y + point.normal[2] * z;
        arrive = turned(point.both_sides ? absolute(above) : above);
    }
    const Lanes both = leave * inverse * arrive;
    const Lanes light = power * inverse * (is_sound ? both : one);
    const Lanes bounded = least(most(light, (Lanes)(LEAST)), (Lanes)(MOST));
    const Lanes counted = counts ? bounded : zero;
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
// light added. The part is shared among all but one: so many alike count for as much, together, as one that brings
// what they do.
float hidden = 0.0f;  // that part; 0 until `weigh_top`, and where there is nothing to be compared with
#if LOCAL
// What `light` counts for, as a part of a group that brings `group`.
auto weighed = [&](auto light, auto group) {
    const auto all = most(group, light * 0.0f + LEAST);
    return light * (root(all + hidden) / root(all));
};
#endif
#if SUNS || WORLD
float first_distant[KEPT];  // estimates of the first distant emitters
auto counted_distant = [&](int number) -> float {
    const float light = number < KEPT ? first_distant[number] : distant_estimate(number);
    return wp::sqrt(light) * wp::sqrt(light + hidden);  // as a group of itself alone
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
    for (int number = 0; number < choice_table.distant_count; ++number) {
        const float light = distant_estimate(number);
        if (number < KEPT) first_distant[number] = light;
        estimated += light;
    }
#endif
    hidden = apart > 1 ? HIDDEN * estimated / static_cast<float>(apart - 1) : 0.0f;
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

// Where the draws of each node of a block begin, one behind another, then those of what is distant, in the first block,
// and their end; all 0: nothing shines.
struct Shares {
    int begin[WIDTH + 2];
    CUDA_CALLABLE int width(int k) const { return begin[k + 1] - begin[k]; }
};
auto shares_in = [&](int block) {
    Shares shares;
    shares.begin[0] = 0;
    float distant = 0.0f, total = 0.0f;
#if LOCAL && !defined(__CUDA_ARCH__)
    static_assert(WIDTH == 16, "sums and vectors by halves, down to four");
    typedef int WideCounts __attribute__((ext_vector_type(WIDTH)));
    typedef int FewCounts __attribute__((ext_vector_type(4)));
    // sums by halves: the same whatever vectors the processor has, and whether nodes that are not there count as 0
    auto sum_of_four = [](Few of) {
        const auto two = of.lo + of.hi;
        return two.x + two.y;
    };
    auto sum = [&](Wide of) {
        const auto eight = of.lo + of.hi;
        return sum_of_four(eight.lo + eight.hi);
    };
    auto ends_of_four = [](FewCounts of) {
        of += __builtin_shufflevector(of, (FewCounts)(0), 4, 0, 1, 2);
        return of + __builtin_shufflevector(of, (FewCounts)(0), 4, 4, 0, 1);
    };
    auto ends = [](WideCounts of) {
        const WideCounts none = (WideCounts)(0);
        of += __builtin_shufflevector(of, none, 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14);
        of += __builtin_shufflevector(of, none, 16, 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13);
        of += __builtin_shufflevector(of, none, 16, 16, 16, 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11);
        return of + __builtin_shufflevector(of, none, 16, 16, 16, 16, 16, 16, 16, 16, 0, 1, 2, 3, 4, 5, 6, 7);
    };
    auto share = [&](auto light, auto counts, auto sum_of, auto ends_of) {
        constexpr int count = sizeof(light) / sizeof(float);
#if LINKS
        for (int k = 0; links && k < count; ++k) {
            if (!is_linked(choice_table.links.nodes.data[block * WIDTH + k])) light[k] = 0.0f;
        }
#endif
        if (block == 0) {
            total = distant = weigh_top(sum_of(light));
            if (hidden > 0.0f) {
                auto group = light;
                if (choice_table.group_count < choice_table.top_count) gather_groups(group, count);
                light = weighed(light, group);
            }
        }
        total += sum_of(light);
        counts = light > 0.0f ? __builtin_convertvector(
                                    most(light * scale_of(total, WIDTH + 1), light * 0.0f + 1.0f), decltype(counts)
                                )
                              : counts;
        const auto end = ends_of(counts);
        const int far = draws_of(distant, scale_of(total, WIDTH + 1));
        const int left = DRAWS - far - end[count - 1];
        const auto all = end > 0 ? end + left : end;
        __builtin_memcpy(shares.begin + 1, &all, sizeof(all));
        for (int k = count; k < WIDTH; ++k) shares.begin[k + 1] = all[count - 1];
        shares.begin[WIDTH + 1] = far > 0 || end[count - 1] > 0 ? DRAWS : 0;
    };
    const float* fields = choice_table.blocks.data + block * (FIELDS * WIDTH);
    Wide powers;
    __builtin_memcpy(&powers, fields + FIELD_POWER * WIDTH, sizeof(powers));
    powers.lo.lo = (Few)(0.0f);
    if (block != 0 || __builtin_reduce_max(powers) > 0.0f) {
        Wide node[FIELDS];
        __builtin_memcpy(node, fields, sizeof(node));
        share(node_light(node), (WideCounts)(0), sum, ends);
    } else {
        Few node[FIELDS];
        for (int field = 0; field < FIELDS; ++field)
            __builtin_memcpy(node + field, fields + field * WIDTH, sizeof(Few));
        share(node_light(node), (FewCounts)(0), sum_of_four, ends_of_four);
    }
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
            if (choice_table.group_count < choice_table.top_count) gather_groups(group, WIDTH);
            total = 0.0f;
#pragma unroll 1
            for (int k = 0; k < WIDTH; ++k) {
                light[k] = weighed(light[k], group[k]);
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
    int drawn = 0;
#pragma unroll 1
    for (int k = 0; k < WIDTH; ++k) {
        drawn += draws_of(light[k], scale);
        shares.begin[k + 1] = drawn;
    }
    const int far = draws_of(distant, scale), left = DRAWS - far - drawn;
#pragma unroll 1
    for (int k = 0; k < WIDTH; ++k) {
        if (shares.begin[k + 1] > 0) shares.begin[k + 1] += left;
    }
    shares.begin[WIDTH + 1] = far > 0 || drawn > 0 ? DRAWS : 0;
#endif
    return shares;
};
