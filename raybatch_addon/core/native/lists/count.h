// How many paths of the block each list has.
const int blocks = (counts.shape[0] - 1) / LISTS;
int found[LISTS] = {};
#if defined(__CUDA_ARCH__)
for (int from = first; from < end; from += 32) {
    const unsigned int lists = from + lane < end ? lists_of(status.data[from + lane]) : 0u;
    for (int k = 0; k < LISTS; ++k) found[k] += __popc(__ballot_sync(0xffffffffu, lists >> k & 1u));
}
#else
count(found);
#endif
if (lane == 0)
    for (int k = 0; k < LISTS; ++k) counts.data[k * blocks + block_number] = found[k];
