// Estimates of the light that comes to `point` from nodes of the tree over emitters, and from suns and the world, which
// are distant. 0: surely none. What is compared is a block: nodes beside each other, and at the top all that is distant
// as one more.
const auto& choice_table = *table.choice.data;
auto within = [](float x, float least, float most) { return wp::min(wp::max(x, least), most); };

#if LOCAL
#if defined(__CUDA_ARCH__)
struct alignas(16) Quarter {
    float x, y, z, w;
};
#endif
using Node = typename wp::remove_reference<decltype(choice_table.nodes.data[0])>::type;
// On a GPU threads go down the tree apart, and each load of one takes as long as that of all: few wide ones.
auto load_node = [&](int at) -> Node {
#if defined(__CUDA_ARCH__)
    static_assert(sizeof(Node) == 3 * sizeof(Quarter), "LightNode is loaded by quarters of 64 bytes");
    union Parts {
        Quarter quarters[3];
        Node node;
        __device__ Parts() {}
    } parts;
    const Quarter* from = reinterpret_cast<const Quarter*>(choice_table.nodes.data + at);
    for (int i = 0; i < 3; ++i) parts.quarters[i] = from[i];
    return parts.node;
#else
    return choice_table.nodes.data[at];
#endif
};
// The mean of max(cos, 0) over a sphere seen under a half angle whose sine has the square `spread`, about: `cosine` is
// that of its middle. At the horizon half the sphere is left, and its mean 2 / (3 pi) of the sine.
auto mean_cosine = [](float cosine, float spread) {
    return 0.5f * (cosine + wp::sqrt(cosine * cosine + 0.18f * spread));
};
auto node_light = [&](const Node& node) -> float {
    if (!(node.power > 0.0f)) return 0.0f;
    const wp::vec3 to = node.centre - point.position;
    const float square = wp::dot(to, to), reach = node.radius * node.radius;
    float turned = 1.0f;
    if (square > reach && square > 1e-30f && square < 1e37f) {  // else its root has lost its digits
        const float inverse = 1.0f / wp::sqrt(square), sine = node.radius * inverse, spread = sine * sine;
        if (node.cos_axis > -1.0f) {
            float leaving = -wp::dot(node.axis, to) * inverse;
            if (node.two_sided) leaving = wp::abs(leaving);
            // cos(a - b - c) <= cos(a) + sin(b) + sin(c): none of its emitters is seen from a side that shines
            const float sin_axis = wp::sqrt(wp::max(1.0f - node.cos_axis * node.cos_axis, 0.0f));
            if (leaving + sin_axis + sine < node.cos_edge - COSINE_ERROR) return 0.0f;
            // the normal in the cone that is nearest to the point
            if (leaving < node.cos_axis) {
                const float beside = wp::sqrt(wp::max(1.0f - leaving * leaving, 0.0f));
                leaving = leaving * node.cos_axis + beside * sin_axis;
            } else {
                leaving = 1.0f;
            }
            turned = wp::max(mean_cosine(leaving, spread), COSINE_MIN);
        }
        float arriving = wp::dot(point.normal, to) * inverse;
        if (point.both_sides) arriving = wp::abs(arriving);
        turned *= wp::max(mean_cosine(arriving, spread), COSINE_MIN);
    }
    return within(node.power * turned / wp::max(square, reach), LEAST, MOST);
};
#endif

#if SUNS || WORLD
auto distant_light = [&](int number) -> float {
#if SUNS
    const int emitter = choice_table.distant.data[number];
    if (emitter < table.light_count) {
        float cosine = -wp::dot(table.lights.data[emitter].axis, point.normal);
        if (point.both_sides) cosine = wp::abs(cosine);
        return within(choice_table.distant_strength.data[number] * wp::max(cosine, COSINE_MIN), LEAST, MOST);
    }
#endif
#if WORLD
    // irradiance by spherical harmonics (Ramamoorthi and Hanrahan 2001)
    const float* e = choice_table.world_irradiance.data;
    const float x = point.normal[0], y = point.normal[1], z = point.normal[2];
    const float even =
        e[0] + e[4] * x * y + e[5] * y * z + e[6] * (3.0f * z * z - 1.0f) + e[7] * x * z + e[8] * (x * x - y * y);
    const float odd = e[1] * y + e[2] * z + e[3] * x;
    return within(wp::max(even + (point.both_sides ? wp::abs(odd) : odd), COSINE_MIN * e[0]), LEAST, MOST);
#else
    return 0.0f;
#endif
};
auto all_distant = [&]() {
    float total = 0.0f;
    for (int number = 0; number < choice_table.distant_count; ++number) total += distant_light(number);
    return total;
};
#endif

// What counts `light` of `total` gets a whole number of the DRAWS that a random number has, at least one; those that
// rounding leaves go to the first of those that are compared. So each is drawn exactly as often as it says.
auto draws_of = [](float light, float scale) -> int {
    return light > 0.0f ? wp::max(static_cast<int>(light * scale), 1) : 0;
};
// room for those that get one in spite of less, and for the rounding of sums
auto scale_of = [](float total, int count) { return static_cast<float>(DRAWS - 4 * count) / total; };

struct Block {
    int draws[WIDTH + 1];  // the last: of what is distant, at the top
    int first;             // the first that has any; WIDTH + 1: none
};
auto block_of = [&](int first, int count, bool at_top) {
    Block block;
    float light[WIDTH + 1], total = 0.0f;
    for (int k = 0; k <= WIDTH; ++k) light[k] = 0.0f;
#if LOCAL
    for (int k = 0; k < count; ++k) light[k] = node_light(load_node(first + k));
#endif
#if SUNS || WORLD
    if (at_top) light[WIDTH] = all_distant();
#endif
    for (int k = 0; k <= WIDTH; ++k) total += light[k];
    const float scale = scale_of(total, WIDTH + 1);
    int left = DRAWS;
    block.first = WIDTH + 1;
    for (int k = WIDTH; k >= 0; --k) {
        block.draws[k] = draws_of(light[k], scale);
        left -= block.draws[k];
        if (block.draws[k] > 0) block.first = k;
    }
    if (block.first <= WIDTH) block.draws[block.first] += left;
    return block;
};
