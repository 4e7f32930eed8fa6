// The third Sobol dimension of index x, with its bits reversed: the numbers of THIRD for the bits of x, all added.
const unsigned int numbers[32] = {THIRD};
unsigned int sum = 0;
for (int bit = 0; bit < 32; ++bit) sum ^= numbers[bit] & (0u - ((x >> bit) & 1u));
return sum;
