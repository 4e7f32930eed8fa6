// a + b * c, rounded once.
#if defined(__CUDA_ARCH__)
return __fmaf_rn(b, c, a);
#else
return __builtin_fmaf(b, c, a);
#endif
