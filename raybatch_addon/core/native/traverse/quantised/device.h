// What differs between the devices: on CUDA a lane of a warp carries a ray, on a CPU the only lane there is.

#if defined(__CUDA_ARCH__)
typedef uint4 Words;
typedef uint2 Group;
constexpr unsigned ALL_LANES = 0xffffffffu;
auto lanes_below = []() -> unsigned {
    unsigned r;
    asm volatile("mov.u32 %0, %%lanemask_lt;" : "=r"(r));
    return r;
};
auto as_float = [](unsigned x) -> float { return __uint_as_float(x); };
auto as_bits = [](float x) -> int { return __float_as_int(x); };
auto highest_bit = [](unsigned x) -> unsigned { return 31u - __clz(x); };
auto bit_count = [](unsigned x) -> int { return __popc(x); };
auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
// The four bytes of a word, times 2^-24: that is what a byte says in the last bits of a float16, below the normal ones
constexpr unsigned BYTE_EXPONENT = 24u << 23;
auto unpack = [](unsigned x, float* q) {
    const unsigned even = x & 0x00ff00ffu, odd = __byte_perm(x, 0u, 0x4341);
    asm("{ .reg .b16 l, h; mov.b32 {l, h}, %2; cvt.f32.f16 %0, l; cvt.f32.f16 %1, h; }"
        : "=f"(q[0]), "=f"(q[2])
        : "r"(even));
    asm("{ .reg .b16 l, h; mov.b32 {l, h}, %2; cvt.f32.f16 %0, l; cvt.f32.f16 %1, h; }"
        : "=f"(q[1]), "=f"(q[3])
        : "r"(odd));
};
auto larger = [](float a, float b) -> float { return fmaxf(a, b); };
auto ballot = [](bool p) -> unsigned { return __ballot_sync(0xffffffffu, p); };
auto read = [](const Words* p) -> Words { return __ldg(p); };
// an ulp off at most, for which the margin has room
auto reciprocal = [](float x) -> float {
    float r;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(x));
    return r;
};
auto quotient = [](float a, float b, float reciprocal_b) -> float { return a * reciprocal_b; };
#else
struct Words {
    unsigned x, y, z, w;
};
struct Group {
    unsigned x, y;
};
constexpr unsigned ALL_LANES = 1u;
auto lanes_below = []() -> unsigned { return 0u; };
auto as_float = [](unsigned x) -> float {
    float r;
    __builtin_memcpy(&r, &x, 4);
    return r;
};
auto as_bits = [](float x) -> int {
    int r;
    __builtin_memcpy(&r, &x, 4);
    return r;
};
auto highest_bit = [](unsigned x) -> unsigned { return 31u - __builtin_clz(x); };
auto bit_count = [](unsigned x) -> int { return __builtin_popcount(x); };
auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
constexpr unsigned BYTE_EXPONENT = 0u;
auto unpack = [](unsigned x, float* q) {
    for (int j = 0; j < 4; ++j) q[j] = (float)((x >> (8 * j)) & 255u);
};
auto larger = [](float a, float b) -> float { return a > b ? a : b; };
auto smaller = [](float a, float b) -> float { return a < b ? a : b; };
auto ballot = [](bool p) -> unsigned { return p ? 1u : 0u; };
auto read = [](const Words* p) -> Words { return *p; };
auto reciprocal = [](float x) -> float { return 1.0f / x; };
auto quotient = [](float a, float b, float reciprocal_b) -> float { return a / b; };
#endif
