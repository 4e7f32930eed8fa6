// The stable sort of a whole list on the CPU: digits of all three passes are counted at once, then come three stable
// scatters; a key and its slot travel as one 64-bit entry.
const int n = count.data[0], digits = 1 << DIGIT_BITS;
unsigned long long* from = (unsigned long long*)entries.data;
unsigned long long* to = from + entries.shape[0] / 2;
int first[3][digits] = {};
for (int i = 0; i < n; ++i) {
    const unsigned int key = ray_key(slots.data[i]);
    from[i] = (unsigned long long)key << 32 | (unsigned int)slots.data[i];
    for (int k = 0; k < 3; ++k) ++first[k][key >> (DIGIT_BITS * k) & (digits - 1)];
}
for (int k = 0; k < 3; ++k) {
    int sum = 0;
    for (int digit = 0; digit < digits; ++digit) {
        const int found = first[k][digit];
        first[k][digit] = sum;
        sum += found;
    }
}
for (int k = 0; k < 2; ++k) {
    for (int i = 0; i < n; ++i) to[first[k][from[i] >> (32 + DIGIT_BITS * k) & (digits - 1)]++] = from[i];
    unsigned long long* swapped = from;
    from = to;
    to = swapped;
}
for (int i = 0; i < n; ++i) {
    const int digit = (int)(from[i] >> (32 + 2 * DIGIT_BITS) & (digits - 1));
    result.data[first[2][digit]++] = (int)(unsigned int)from[i];
}
