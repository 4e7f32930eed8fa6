"""Native text: vectors of eight for CPUs.

Clang's vector extensions carry most of it to any processor. What they cannot say (comparisons to a bit mask, compression,
picking by index) has a text for AVX-512, one for AVX2 and one for all others; each gives the same values.
"""

from __future__ import annotations

VECTOR_TEXT = """
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
    auto below = [](Floats a, Floats b) INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 17, 0xff); };
    auto at_most = [](Floats a, Floats b) INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 18, 0xff); };
    auto not_above = [](Floats a, Floats b) INLINE -> unsigned { return (unsigned char)__builtin_ia32_cmpps256_mask(a, b, 26, 0xff); };
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
        const Ints place = __builtin_convertvector((Bytes)numbers, Ints);
        const Ints order = {0, 1, 2, 3, 4, 5, 6, 7};
        const int count = __builtin_popcount(mask);
        const Ints behind = order >= Ints{count, count, count, count, count, count, count, count};
        return (Ints)__builtin_ia32_permvarsi256(a, place) | behind;
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
        high = __builtin_elementwise_max(x, y); low = __builtin_elementwise_min(x, y);
        x = __builtin_shufflevector(high, low, 0, 1, 6, 7);
        y = __builtin_shufflevector(x, x, 1, 0, 3, 2);
        high = __builtin_elementwise_max(x, y); low = __builtin_elementwise_min(x, y);
        x = __builtin_shufflevector(high, low, 0, 5, 2, 7);
        y = __builtin_shufflevector(x, x, 0, 2, 1, 3);
        high = __builtin_elementwise_max(x, y); low = __builtin_elementwise_min(x, y);
        x = __builtin_shufflevector(high, low, 0, 1, 6, 3);
        return __builtin_shufflevector(x, x, 0, 1, 2, 3, 0, 1, 2, 3);
    };
    // All eight in falling order (Batcher's odd-even merge sort)
    auto sorted_eight = [](Ints x) INLINE -> Ints {
        Ints y, high, low;
        EXCHANGES
        return x;
    };
"""

# Stages of the sort: partner of each element, and whether it gets the smaller of the two
_STAGES = (
    ((1, 0, 3, 2, 5, 4, 7, 6), (0, 1, 0, 1, 0, 1, 0, 1)),
    ((2, 3, 0, 1, 6, 7, 4, 5), (0, 0, 1, 1, 0, 0, 1, 1)),
    ((0, 2, 1, 3, 4, 6, 5, 7), (0, 0, 1, 0, 0, 0, 1, 0)),
    ((4, 5, 6, 7, 0, 1, 2, 3), (0, 0, 0, 0, 1, 1, 1, 1)),
    ((0, 1, 4, 5, 2, 3, 6, 7), (0, 0, 0, 0, 1, 1, 0, 0)),
    ((0, 2, 1, 4, 3, 6, 5, 7), (0, 0, 1, 0, 1, 0, 1, 0)),
)


def _exchange(partner: tuple[int, ...], takes_low: tuple[int, ...]) -> str:
    chosen = ", ".join(str(k + 8 * low) for k, low in enumerate(takes_low))
    return (
        f"y = __builtin_shufflevector(x, x, {', '.join(map(str, partner))}); high = __builtin_elementwise_max(x, y); "
        f"low = __builtin_elementwise_min(x, y); x = __builtin_shufflevector(high, low, {chosen});\n        "
    )


VECTOR_TEXT = VECTOR_TEXT.replace("EXCHANGES", "".join(_exchange(*stage) for stage in _STAGES).rstrip())
INLINE = "__attribute__((always_inline))"
"""What `INLINE` in a text stands for, after the parameters of a lambda."""
