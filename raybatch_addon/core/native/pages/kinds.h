// The two kinds of rays that are taken together: READY, those whose treelet is on the device and new ones; otherwise
// those that are done, closest-hit rays and shadow rays.
#if READY
auto is_first = [&](int state, int slot) { return state >= 0 && there.data[state] != 0; };
auto is_second = [&](int state, int slot) { return state == NEW; };
#else
auto is_first = [&](int state, int slot) { return state == DONE && slot < waiting.shadow_first; };
auto is_second = [&](int state, int slot) { return state == DONE && slot >= waiting.shadow_first; };
#endif
