// The first index of a thread. A launch on a CPU is one loop: its first thread goes through all of them itself.
#if defined(__CUDA_ARCH__)
return thread;
#else
return thread == 0 ? 0 : 0x7fffffff;
#endif
