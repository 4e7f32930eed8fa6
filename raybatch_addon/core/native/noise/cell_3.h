// Gradient noise in a cell of the lattice whose lowest corner is (i, j, k), at `at` in [0, 1) from there: the slopes of
// its eight corners, mixed by `fade`. Corner 4 z + 2 y + x is a step further along x, y and z. All corners at once as a
// vector on a CPU, one after another on a GPU; every sum and product is the same.
#if defined(__CUDA_ARCH__)
typedef float Numbers;
typedef wp::uint32 Words;
auto chosen = [](bool first, float a, float b) { return first ? a : b; };
#else
typedef float Numbers __attribute__((ext_vector_type(8)));
typedef wp::uint32 Words __attribute__((ext_vector_type(8)));
typedef int Mask __attribute__((ext_vector_type(8)));
auto chosen = [](Mask first, Numbers a, Numbers b) { return first ? a : b; };
#endif

// The final mix of lookup3 over three words
auto hashed = [](Words a, Words b, Words c) {
    auto rotated = [](Words x, int k) { return (x << k) | (x >> (32 - k)); };
    c = (c ^ b) - rotated(b, 14);
    a = (a ^ c) - rotated(c, 11);
    b = (b ^ a) - rotated(a, 25);
    c = (c ^ b) - rotated(b, 16);
    a = (a ^ c) - rotated(c, 4);
    b = (b ^ a) - rotated(a, 14);
    return (c ^ b) - rotated(b, 24);
};
// A corner's slope times the distance from it: one of the twelve directions to the middles of a cube's edges, of which
// four count twice
auto slope = [&](Words a, Words b, Words c, Numbers x, Numbers y, Numbers z) {
    const Words bits = hashed(a + HASH_SEED, b + HASH_SEED, c + HASH_SEED), direction = bits & 15u;
    const Numbers u = chosen(direction < 8u, x, y);
    const Numbers v = chosen(direction < 4u, y, chosen((direction == 12u) | (direction == 14u), x, z));
    return chosen((bits & 1u) != 0u, -u, u) + chosen((bits & 2u) != 0u, -v, v);
};
auto mixed = [](auto a, auto b, float t) { return a + t * (b - a); };

#if defined(__CUDA_ARCH__)
float planes[2];
#pragma unroll 1  // a GPU waits for instructions more than for anything else
for (int layer = 0; layer < 2; ++layer) {
    float rows[2];
#pragma unroll
    for (int row = 0; row < 2; ++row) {
        const float y = at[1] - static_cast<float>(row), z = at[2] - static_cast<float>(layer);
        rows[row] = mixed(
            slope(i, j + row, k + layer, at[0], y, z), slope(i + 1u, j + row, k + layer, at[0] - 1.0f, y, z), fade[0]
        );
    }
    planes[layer] = mixed(rows[0], rows[1], fade[1]);
}
return mixed(planes[0], planes[1], fade[2]);
#else
const Words along_x = {0, 1, 0, 1, 0, 1, 0, 1}, along_y = {0, 0, 1, 1, 0, 0, 1, 1}, along_z = {0, 0, 0, 0, 1, 1, 1, 1};
const Numbers slopes = slope(
    i + along_x, j + along_y, k + along_z, at[0] - __builtin_convertvector(along_x, Numbers),
    at[1] - __builtin_convertvector(along_y, Numbers), at[2] - __builtin_convertvector(along_z, Numbers)
);
const auto rows = mixed(slopes.even, slopes.odd, fade[0]);
const auto planes = mixed(rows.even, rows.odd, fade[1]);
return mixed(planes.x, planes.y, fade[2]);
#endif
