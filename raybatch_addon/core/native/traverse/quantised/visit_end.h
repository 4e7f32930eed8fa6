// The visits to treelets of all lanes of a warp.

#if defined(__CUDA_ARCH__)
for (int step = 16; step > 0; step >>= 1) visit_count += __shfl_xor_sync(ALL_LANES, visit_count, step);
if (lanes_below() == 0u && visit_count)
    atomicAdd((unsigned long long*)progress.visits.data, (unsigned long long)visit_count);
#else
progress.visits.data[0] += visit_count;
#endif
