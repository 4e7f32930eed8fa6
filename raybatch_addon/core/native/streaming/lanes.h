// Lanes of a warp.
#if defined(__CUDA_ARCH__)
return 32;
#else
return 1;
#endif
