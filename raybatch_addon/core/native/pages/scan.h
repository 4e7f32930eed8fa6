// How many rays of each kind lie before each chunk, and how many are taken. One block of SCAN_THREADS threads.
__shared__ unsigned long long sums[SCAN_THREADS];
const int n = waiting.parts.shape[0], each = (n + SCAN_THREADS - 1) / SCAN_THREADS, begin = min(thread * each, n),
          end = min(begin + each, n);
unsigned long long sum = 0;
for (int i = begin; i < end; ++i) sum += waiting.parts.data[i];
sums[thread] = sum;
__syncthreads();
for (int step = 1; step < SCAN_THREADS; step *= 2) {
    const unsigned long long before = thread >= step ? sums[thread - step] : 0ull;
    __syncthreads();
    sums[thread] += before;
    __syncthreads();
}
unsigned long long before = sums[thread] - sum;
for (int i = begin; i < end; ++i) {
    const unsigned long long part = waiting.parts.data[i];
    waiting.parts.data[i] = before;
    before += part;
}
if (thread == SCAN_THREADS - 1) {
    const int capacity = taken.slots.shape[0];
    const int first = min((int)(unsigned int)sums[thread], capacity);
    write_counts(first, min(min((int)(sums[thread] >> 32), second_most), capacity - first));
}
