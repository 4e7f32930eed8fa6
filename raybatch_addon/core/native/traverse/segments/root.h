// Square roots of numbers and of vectors of them, correctly rounded.
#if defined(__CUDA_ARCH__)
auto square_root = [](float x) -> float { return __fsqrt_rn(x); };
#else
auto square_root = [](auto x) INLINE_SEGMENT { return __builtin_elementwise_sqrt(x); };
#endif
