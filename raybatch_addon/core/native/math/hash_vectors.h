// 24 bits that depend on every bit of two vectors and of a number (constants of MurmurHash3).
unsigned state = (unsigned)salt * 0x9E3779B9u;
const float numbers[6] = {a[0], a[1], a[2], b[0], b[1], b[2]};
for (int k = 0; k < 6; ++k) {
    unsigned bits;
    memcpy(&bits, &numbers[k], 4);
    state = (state ^ bits) * 0x85EBCA6Bu;
    state ^= state >> 13;
    state *= 0xC2B2AE35u;
    state ^= state >> 16;
}
return static_cast<int>(state >> 8);
