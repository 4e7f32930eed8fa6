// The index of a thread that follows `i`; beyond all counts on a GPU, where a thread has one.
#if defined(__CUDA_ARCH__)
return 0x7fffffff;
#else
return i + 1;
#endif
