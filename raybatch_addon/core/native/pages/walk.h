// The chunk of a warp: it goes over SLOTS_A_TURN slots at a time, 4 a lane, and asks for the next ones before it looks
// at these.
#if defined(__CUDA_ARCH__)
const int lane = thread & 31, warp = thread >> 5;
const long long begin = (long long)warp * waiting.chunk;
const long long all = waiting.location.shape[0], end = begin + waiting.chunk < all ? begin + waiting.chunk : all;
auto four = [&](long long i) {
    int4 states = make_int4(IDLE, IDLE, IDLE, IDLE);
    if (i + 3 < end) return *(const int4*)(waiting.location.data + i);
    if (i < end) states.x = waiting.location.data[i];
    if (i + 1 < end) states.y = waiting.location.data[i + 1];
    if (i + 2 < end) states.z = waiting.location.data[i + 2];
    return states;
};
int4 next = four(begin + 4 * lane);
#endif
