// Vectors of eight for CPUs.
//
// Clang's vector extensions carry most of it to any processor. What they cannot say (comparisons to a bit mask,
// compression, picking by index) is written for AVX-512, for AVX2 and for all others; each gives the same values.

// After the parameters of a lambda
#define INLINE __attribute__((always_inline))

// Eight float32 and eight int32; the last two need not be aligned
typedef float Floats __attribute__((vector_size(32), may_alias));
typedef int Ints __attribute__((vector_size(32), may_alias));
typedef float LooseFloats __attribute__((vector_size(32), may_alias, aligned(4)));
typedef int LooseInts __attribute__((vector_size(32), may_alias, aligned(4)));
typedef int FourInts __attribute__((vector_size(16)));
typedef float FourFloats __attribute__((vector_size(16)));
auto all = [](float x) INLINE -> Floats { return Floats{x, x, x, x, x, x, x, x}; };
auto all_ints = [](int x) INLINE -> Ints { return Ints{x, x, x, x, x, x, x, x}; };
// Where an operand is NaN: the second one
auto larger = [](Floats a, Floats b) INLINE -> Floats { return a > b ? a : b; };
auto smaller = [](Floats a, Floats b) INLINE -> Floats { return a < b ? a : b; };
auto fused = [](Floats a, Floats b, Floats c) INLINE -> Floats { return __builtin_elementwise_fma(a, b, c); };
// a b - c d, the sign exact (`intersect.py`)
auto difference = [&](Floats a, Floats b, Floats c, Floats d) INLINE -> Floats {
    const Floats product = c * d;
    return fused(a, b, -product) + fused(-c, d, product);
};
// Comparisons: bit k of the result for element k; false where an operand is NaN, `not_above` true
#if defined(__AVX512VL__) && defined(__AVX512DQ__)
auto below = [](Floats a, Floats b)
                 INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 17, 0xff); };
auto at_most = [](Floats a, Floats b)
                   INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 18, 0xff); };
auto not_above = [](Floats a, Floats b)
                     INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 26, 0xff); };
auto negative = [](Ints a) INLINE -> unsigned { return (unsigned char)__builtin_ia32_cvtd2mask256(a); };
#else
auto negative = [](Ints a) INLINE -> unsigned {
#if defined(__AVX__)
    return (unsigned)__builtin_ia32_movmskps256((Floats)a);
#else
    return (unsigned)__builtin_reduce_or((a < 0) & Ints{1, 2, 4, 8, 16, 32, 64, 128});
#endif
};
auto below = [&](Floats a, Floats b) INLINE -> unsigned { return negative(a < b); };
auto at_most = [&](Floats a, Floats b) INLINE -> unsigned { return negative(a <= b); };
auto not_above = [&](Floats a, Floats b) INLINE -> unsigned { return negative(~(a > b)); };
#endif
// The elements of `a` whose bit is set, in order; -1 behind them
auto compressed = [](Ints a, unsigned mask) INLINE -> Ints {
    constexpr Ints none = {-1, -1, -1, -1, -1, -1, -1, -1};
#if defined(__AVX512VL__)
    return (Ints)__builtin_ia32_compresssi256_mask(a, none, (unsigned char)mask);
#elif defined(__AVX2__) && defined(__BMI2__)
    // a byte an element: the numbers of the set bits, side by side
    typedef unsigned char Bytes __attribute__((vector_size(8)));
    const unsigned long long chosen = __builtin_ia32_pdep_di(mask, 0x0101010101010101ull) * 0xffull;
    const unsigned long long numbers = __builtin_ia32_pext_di(0x0706050403020100ull, chosen);
    const Ints index = __builtin_convertvector((Bytes)numbers, Ints);
    const Ints order = {0, 1, 2, 3, 4, 5, 6, 7};
    const int count = __builtin_popcount(mask);
    const Ints behind = order >= Ints{count, count, count, count, count, count, count, count};
    return (Ints)__builtin_ia32_permvarsi256(a, index) | behind;
#else
    Ints r = none;
    int count = 0;
    for (unsigned rest = mask; rest; rest &= rest - 1u) r[count++] = a[__builtin_ctz(rest)];
    return r;
#endif
};
// a[index], element by element; an index is 0 to 7
auto picked = [](Ints a, Ints index) INLINE -> Ints {
#if defined(__AVX2__)
    return (Ints)__builtin_ia32_permvarsi256(a, index);
#else
    Ints r;
    for (int k = 0; k < 8; ++k) r[k] = a[index[k]];
    return r;
#endif
};
// The first four in falling order; what is behind them is lost
auto sorted_four = [](Ints a) INLINE -> Ints {
    FourInts x = __builtin_shufflevector(a, a, 0, 1, 2, 3), y, high, low;
    y = __builtin_shufflevector(x, x, 2, 3, 0, 1);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 6, 7);
    y = __builtin_shufflevector(x, x, 1, 0, 3, 2);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 5, 2, 7);
    y = __builtin_shufflevector(x, x, 0, 2, 1, 3);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 6, 3);
    return __builtin_shufflevector(x, x, 0, 1, 2, 3, 0, 1, 2, 3);
};
// All eight in falling order (Batcher's odd-even merge sort). A stage: the partner of each element; then which of the
// two it becomes, the larger (its own number) or the smaller (8 more).
auto sorted_eight = [](Ints x) INLINE -> Ints {
    Ints y, high, low;
    y = __builtin_shufflevector(x, x, 1, 0, 3, 2, 5, 4, 7, 6);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 9, 2, 11, 4, 13, 6, 15);
    y = __builtin_shufflevector(x, x, 2, 3, 0, 1, 6, 7, 4, 5);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 10, 11, 4, 5, 14, 15);
    y = __builtin_shufflevector(x, x, 0, 2, 1, 3, 4, 6, 5, 7);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 10, 3, 4, 5, 14, 7);
    y = __builtin_shufflevector(x, x, 4, 5, 6, 7, 0, 1, 2, 3);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 2, 3, 12, 13, 14, 15);
    y = __builtin_shufflevector(x, x, 0, 1, 4, 5, 2, 3, 6, 7);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 2, 3, 12, 13, 6, 7);
    y = __builtin_shufflevector(x, x, 0, 2, 1, 4, 3, 6, 5, 7);
    high = __builtin_elementwise_max(x, y);
    low = __builtin_elementwise_min(x, y);
    x = __builtin_shufflevector(high, low, 0, 1, 10, 3, 12, 5, 14, 7);
    return x;
};
