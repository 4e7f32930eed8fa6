// New states of rays, and their classes in the tally.
const int n = taken.count.data[0];
auto class_of = [&](int state, int slot) {
    if (state >= 0) return CLASS_PAGES + waiting.page.data[state];
    if (state == DONE) return slot < waiting.shadow_first ? CLASS_DONE_CLOSEST : CLASS_DONE_SHADOW;
    return state == NEW ? CLASS_NEW : CLASS_IDLE;
};
#if defined(__CUDA_ARCH__)
const bool mine = thread < n;
int from = -1, to = -1;
if (mine) {
    const int slot = taken.slots.data[thread], state = taken.locations.data[thread], old = waiting.location.data[slot];
    if (state != old) {
        waiting.location.data[slot] = state;
        from = class_of(old, slot);
        to = class_of(state, slot);
    }
}
// lanes of a class add together
int* tally = waiting.tally.data + (thread >> 7) % waiting.copies * waiting.classes;
const int lane = thread & 31;
unsigned int same = __match_any_sync(0xffffffffu, from);
if (from >= 0 && __ffs(same) - 1 == lane) atomicSub(tally + from, __popc(same));
same = __match_any_sync(0xffffffffu, to);
if (to >= 0 && __ffs(same) - 1 == lane) atomicAdd(tally + to, __popc(same));
#else
for (int i = 0; i < n; ++i) {
    const int slot = taken.slots.data[i], state = taken.locations.data[i], old = waiting.location.data[slot];
    --waiting.tally.data[class_of(old, slot)];
    ++waiting.tally.data[class_of(state, slot)];
    waiting.location.data[slot] = state;
}
#endif
