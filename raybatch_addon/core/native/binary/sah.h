// Binned SAH (Wald 2007): the choice of a split, and the partition by it.
//
// Areas are of boxes scaled by a power of two, exactly, to a largest extent of 1 to 2: no square leaves float32.
struct Sah {
    static f8 larger(f8 a, f8 b) { return a > b ? a : b; }
    static f4 low4(f8 v) { return __builtin_shufflevector(v, v, 0, 1, 2, 3); }
    static f4 high4(f8 v) { return __builtin_shufflevector(v, v, 4, 5, 6, 7); }
    static f8 join(f4 a, f4 b) { return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7); }
    static f8 nothing() {
        f8 v = {};
        return v - __builtin_inff();
    }
    static f4 extent(f8 box) {
        f4 e = high4(box) + low4(box);
        e[3] = 0;
        return e;
    }
    static bool is_spread(f8 box) {
        f4 e = extent(box);
        return e[0] > 0 || e[1] > 0 || e[2] > 0;
    }
    // twice the middle of a box, negated and as it is
    static f8 middle(f8 record) {
        f4 m = high4(record) - low4(record);
        return join(-m, m);
    }
    // by value: Clang's bit cast of a vector's element reads lane 0
    static int bits(float value) { return __builtin_bit_cast(int, value); }
    static float from_bits(int value) { return __builtin_bit_cast(float, value); }
    static int index(f8 record) { return bits(record[3]) - INDEX_BIAS; }
    static float index_lane(int index) { return from_bits(index + INDEX_BIAS); }

    // Measures boxes within one node: half the surface area, or the sum of the extents where the node has no area.
    struct Measure {
        float scale, flat;
        explicit Measure(f8 box) {
            f4 e = extent(box);
            float largest = e[0] > e[1] ? e[0] : e[1];
            largest = largest > e[2] ? largest : e[2];
            int exponent = (bits(largest) >> 23) & 255;
            scale = from_bits((exponent < 1 ? 253 : exponent > 253 ? 1 : 254 - exponent) << 23);
            flat = 0;
            flat = (*this)(box) > 0 ? 0 : 1;
        }
        float operator()(f8 box) const {
            f4 e = (high4(box) + low4(box)) * scale;
            f4 terms = e * __builtin_shufflevector(e, e, 1, 2, 0, 3) + e * flat;
            return terms[0] + terms[1] + terms[2];
        }
    };

    // More bins make a better tree, and small nodes, of which there are many, slow to build.
    static int bin_count(const Task& task) { return task.count > FEW ? BINS_MAX : BINS_FEW; }

    // Which of the equal parts of a range, given as a box, a point falls into, by axis.
    struct Binning {
        f4 origin, scale, last;
        Binning(f8 range, int bins) {
            origin = -low4(range);
            origin[3] = 0;
            f4 e = extent(range);
            scale = e > 0 ? (float)bins / e : f4{};
            last = f4{} + (float)(bins - 1);
        }
        i4 operator()(f4 point) const {
            f4 bin = (point - origin) * scale;
            bin = bin > 0 ? bin : f4{};  // not a number: 0
            return __builtin_convertvector(bin < last ? bin : last, i4);
        }
    };

    static void clear(Bins& bins, const Task& task) {
        bins.bins = bin_count(task);
        for (int k = 0; k < 3; k++)
            for (int b = 0; b < bins.bins; b++) {
                bins.box[k][b] = nothing();
                bins.count[k][b] = 0;
            }
    }
    static void bin(const f8u* records, const Task& task, long long first, long long count, Bins& bins) {
        clear(bins, task);
        Binning binning(task.middle, bins.bins);
        for (long long i = first; i < first + count; i++) {
            f8 record = records[i];
            i4 at = binning(high4(record) - low4(record));
            for (int k = 0; k < 3; k++) {
                bins.box[k][at[k]] = larger(bins.box[k][at[k]], record);
                bins.count[k][at[k]]++;
            }
        }
    }
    static void merge(Bins& bins, const Bins& more) {
        for (int k = 0; k < 3; k++)
            for (int b = 0; b < bins.bins; b++) {
                bins.box[k][b] = larger(bins.box[k][b], more.box[k][b]);
                bins.count[k][b] += more.count[k][b];
            }
    }

    // The tests that `count` triangles cost; exact for small counts, for others within a few roundings
    static float groups(const Options& options, long long count) {
        return __builtin_truncf((count + options.leaf_group - 1) * options.group_inverse);
    }

    // Writes the cheapest split between two bins into `task`, where a plane separates. Its cost is that of its parts,
    // without the step.
    static void choose_object(const Bins& bins, const Options& options, const Measure& measure, Task& task) {
        float best = __builtin_inff();
        for (int k = 0; k < 3; k++) {
            float right_cost[BINS_MAX];
            int right_count[BINS_MAX];
            f8 box = nothing();
            int count = 0;
            for (int b = bins.bins - 1; b > 0; b--) {
                box = larger(box, bins.box[k][b]);
                count += bins.count[k][b];
                right_cost[b] = measure(box) * groups(options, count);
                right_count[b] = count;
            }
            box = nothing();
            count = 0;
            for (int b = 0; b < bins.bins - 1; b++) {
                box = larger(box, bins.box[k][b]);
                count += bins.count[k][b];
                if (count == 0 || right_count[b + 1] == 0) continue;
                float cost = measure(box) * groups(options, count) + right_cost[b + 1];
                if (cost < best) {
                    best = cost;
                    task.kind = OBJECT;
                    task.axis = k;
                    task.bin = b;
                    task.left_count = count;
                    task.right_count = right_count[b + 1];
                }
            }
        }
        if (task.kind != OBJECT) return;
        task.cost = best;
        task.left_box = task.right_box = nothing();
        for (int b = 0; b < bins.bins; b++) {
            f8u& side = b <= task.bin ? task.left_box : task.right_box;
            side = larger(side, bins.box[task.axis][b]);
        }
    }

    // The same among all orders of at most EXACT_MAX records by middle, without bins; `bin` lists the right side, a bit
    // each.
    static void choose_exact(const f8u* records, const Options& options, const Measure& measure, Task& task) {
        const f8u* own = records + task.first;
        int count = task.count, best_left = 0;
        i16 rank[3], lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
        float best = __builtin_inff();
        for (int k = 0; k < 3; k++) {
            f16 middle = {};
            middle += __builtin_inff();
            for (int i = 0; i < count; i++) middle[i] = own[i][4 + k] - own[i][k];
            rank[k] = i16{};
            for (int j = 0; j < count; j++) rank[k] -= (middle > middle[j]) | ((middle == middle[j]) & (lane > j));
            int order[EXACT_MAX] = {};
            for (int i = 0; i < count; i++) order[rank[k][i]] = i;
            float right_cost[EXACT_MAX];
            f8 box = nothing();
            for (int r = count - 1; r > 0; r--) {
                box = larger(box, own[order[r]]);
                right_cost[r] = measure(box) * groups(options, count - r);
            }
            box = nothing();
            for (int r = 1; r < count; r++) {
                box = larger(box, own[order[r - 1]]);
                float cost = measure(box) * groups(options, r) + right_cost[r];
                if (cost < best) {
                    best = cost;
                    task.axis = k;
                    best_left = r;
                }
            }
        }
        if (best_left == 0) return;
        task.kind = LISTED;
        task.cost = best;
        task.bin = 0;
        task.left_box = task.right_box = nothing();
        for (int i = 0; i < count; i++) {
            bool right = rank[task.axis][i] >= best_left;
            f8u& side = right ? task.right_box : task.left_box;
            side = larger(side, own[i]);
            task.bin |= right << i;
        }
        task.left_count = best_left;
        task.right_count = count - best_left;
    }

    // Halving by index from here on ends at DEPTH_MAX at the latest.
    static bool must_halve(const Task& task) {
        return task.count > 1 && task.depth + 64 - __builtin_clzll(task.count - 1) >= DEPTH_MAX;
    }
    static void halve(Task& task, const Options& options, const Measure& measure) {
        task.kind = HALF;
        task.left_count = (task.count + 1) / 2;
        task.right_count = task.count - task.left_count;
        task.cost = measure(task.box) * (groups(options, task.left_count) + groups(options, task.right_count));
    }

    struct Bounds {
        f8 box = nothing(), middles = nothing();
        void add(f8 record) {
            box = larger(box, record);
            middles = larger(middles, middle(record));
        }
    };

    // Copies records first..first + count of `from` to the sides of the split, in order; HALF and LISTED count from the
    // task's first.
    static void partition(
        const f8u* from, f8u* to, const Task& task, long long first, long long count, long long left, long long right,
        Bounds* bounds
    ) {
        long long end[2] = {left, right};
        auto move = [&](long long i, int side) {
            f8 record = from[i];
            to[end[side]++] = record;
            bounds[side].add(record);
        };
        Binning binning(task.middle, bin_count(task));
        float origin = binning.origin[task.axis], scale = binning.scale[task.axis];
        if (task.kind == OBJECT)
            for (long long i = first; i < first + count; i++) {
                const float* lane = (const float*)&from[i] + task.axis;
                move(i, (lane[4] - lane[0] - origin) * scale >= task.bin + 1);  // the bin, as Binning rounds
            }
        else if (task.kind == LISTED)
            for (long long i = first; i < first + count; i++) move(i, task.bin >> (i - task.first) & 1);
        else
            for (long long i = first; i < first + count; i++) move(i, i - task.first >= task.left_count);
    }

    // The children of a task whose references were counted: slack for later splits is shared by their counts.
    static void children(const Task& task, Task& left, Task& right) {
        long long slack = task.capacity - task.left_count - task.right_count;
        left.count = task.left_count;
        right.count = task.right_count;
        left.capacity = left.count + slack * left.count / (left.count + right.count);
        right.capacity = task.capacity - left.capacity;
        left.first = task.first;
        right.first = task.first + left.capacity;
        left.depth = right.depth = task.depth + 1;
        left.buffer = right.buffer = 1 - task.buffer;
    }
};
