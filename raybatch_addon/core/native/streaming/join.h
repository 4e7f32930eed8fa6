// The lanes of a warp wait for each other, and see what each of them wrote.
#if defined(__CUDA_ARCH__)
__syncwarp();
#endif
