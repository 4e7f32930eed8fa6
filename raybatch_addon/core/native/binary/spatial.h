// Spatial splits: triangles are cut at a plane where that costs less than sorting them (Stich, Friedrich and Dietrich
// 2009).
//
// A reference that is cut becomes two, whose boxes hold the parts of the triangle inside the reference's box; computed
// in float64 and rounded outwards, so that every point of a triangle is in the box of one of its references. A
// reference is left whole ("unsplitting") where that costs less. What is decided about one reference depends on the
// bins alone, never on others.
typedef double d4 __attribute__((vector_size(32)));
struct Spatial {
    const float* positions;
    const int* triangles;

    // A plane cuts a box where they overlap by more than this share of `root_area`
    static bool is_worthwhile(const Task& task, float share, double root_area) {
        f8 left = task.left_box, right = task.right_box;
        f8 overlap = left < right ? left : right;
        double e[3];
        for (int k = 0; k < 3; k++) e[k] = (double)overlap[k] + overlap[4 + k];
        if (!(e[0] >= 0 && e[1] >= 0 && e[2] >= 0)) return false;
        return e[0] * e[1] + e[1] * e[2] + e[2] * e[0] > share * root_area;
    }

    struct Corners {
        d4 at[3], error;  // error bounds the rounding of a point on an edge: below 2^-50 of the largest corner
    };
    Corners corners(f8 record) const {
        Corners c;
        d4 largest = {};
        for (int i = 0; i < 3; i++) {
            const float* p = positions + 3ll * triangles[3ll * Sah::index(record) + i];
            c.at[i] = d4{p[0], p[1], p[2], 0};
            d4 size = c.at[i] < 0 ? -c.at[i] : c.at[i];
            largest = size > largest ? size : largest;
        }
        c.error = largest * 0x1p-48 + 0x1p-149;
        return c;
    }

    static bool is_box(f8 record) {
        i4 is_not = ~(Sah::high4(record) + Sah::low4(record) >= 0);  // never in lane 3
        return !(is_not[0] | is_not[1] | is_not[2]);
    }

    // The parts of the record's triangle below and above the plane, within the record's box. A part without a box is
    // empty.
    static void cut(const Corners& triangle, f8 record, int axis, float plane, f8& left, f8& right) {
        d4 infinite = {};
        infinite += __builtin_inf();
        d4 low[2] = {infinite, infinite}, high[2] = {-infinite, -infinite};
        auto add = [&](int side, d4 from, d4 to) {
            low[side] = from < low[side] ? from : low[side];
            high[side] = to > high[side] ? to : high[side];
        };
        for (int i = 0; i < 3; i++) {
            d4 a = triangle.at[i], b = triangle.at[i == 2 ? 0 : i + 1];
            double da = a[axis] - plane, db = b[axis] - plane;
            if (da <= 0) add(0, a, a);
            if (da >= 0) add(1, a, a);
            if ((da < 0 && db > 0) || (da > 0 && db < 0)) {
                d4 point = a + (b - a) * (da / (da - db));
                d4 error = triangle.error + 0x1.01p-24 * (point < 0 ? -point : point);  // rounding to float32 too
                add(0, point - error, point + error);
                add(1, point - error, point + error);
            }
        }
        for (int side = 0; side < 2; side++) {
            f4 l = -__builtin_convertvector(low[side], f4), h = __builtin_convertvector(high[side], f4);
            l[3] = record[3];
            h[3] = 0;
            f8 part = Sah::join(l, h);
            part = part < record ? part : record;
            if (side == 0) {
                if (part[4 + axis] > plane) part[4 + axis] = plane;
                left = part;
            } else {
                if (part[axis] > -plane) part[axis] = -plane;
                right = part;
            }
        }
    }

    static void merge(SpatialBins& bins, const SpatialBins& more) {
        for (int k = 0; k < 3; k++)
            for (int b = 0; b < bins.bins; b++) {
                bins.box[k][b] = Sah::larger(bins.box[k][b], more.box[k][b]);
                bins.enter[k][b] += more.enter[k][b];
                bins.leave[k][b] += more.leave[k][b];
            }
    }

    // Planes cut the node's own box into equal parts
    static float plane(const SpatialBins& bins, f8 box, int axis, int bin) {
        return -box[axis] + (box[4 + axis] + box[axis]) * ((bin + 1) * (1.0f / bins.bins));
    }

    // The parts of a record's triangle that lie in bins from..to of an axis, to rounding: each edge is followed from
    // plane to plane.
    __attribute__((always_inline)) static void slice(
        const f8* corners, const i4* corner_bins, f8 record, int k, int from, int to, const float* planes, f8* parts
    ) {
        float low = -record[k], high = record[4 + k];
        for (int b = from; b <= to; b++) parts[b] = Sah::nothing();
        for (int e = 0; e < 3; e++) {
            int i = e, j = e == 2 ? 0 : e + 1;
            if (corners[i][4 + k] > corners[j][4 + k]) {
                i = j;
                j = e;
            }
            f8 a = corners[i], along = corners[j] - a;
            float start = a[4 + k], end = corners[j][4 + k], inverse = 1 / (end - start);
            if (end < low || start > high) continue;
            f8 point = start < low ? a + along * ((low - start) * inverse) : a;
            f8 last = end > high ? a + along * ((high - start) * inverse) : corners[j];
            int b = start < low ? from : corner_bins[i][k], b_end = end > high ? to : corner_bins[j][k];
            for (; b < b_end; b++) {
                f8 next = a + along * ((planes[b] - start) * inverse);
                parts[b] = Sah::larger(parts[b], Sah::larger(point, next));
                point = next;
            }
            parts[b] = Sah::larger(parts[b], Sah::larger(point, last));
        }
    }

    void bin(const f8u* records, const Task& task, long long first, long long count, SpatialBins& bins) const {
        bins.bins = Sah::bin_count(task);
        float planes[3][BINS_MAX];
        for (int k = 0; k < 3; k++)
            for (int b = 0; b < bins.bins; b++) {
                bins.box[k][b] = Sah::nothing();
                bins.enter[k][b] = bins.leave[k][b] = 0;
                planes[k][b] = plane(bins, task.box, k, b);
            }
        Sah::Binning binning(task.box, bins.bins);
        for (long long i = first; i < first + count; i++) {
            f8 record = records[i], corners[3];
            i4 from = binning(-Sah::low4(record)), to = binning(Sah::high4(record)), corner_bins[3];
            if (from[0] != to[0] || from[1] != to[1] || from[2] != to[2])
                for (int c = 0; c < 3; c++) {
                    const float* p = positions + 3ll * triangles[3ll * Sah::index(record) + c];
                    f4 point = {p[0], p[1], p[2], 0};
                    corners[c] = Sah::join(-point, point);
                    corner_bins[c] = binning(point);
                }
#pragma clang loop unroll(full)
            for (int k = 0; k < 3; k++) {
                bins.enter[k][from[k]]++;
                bins.leave[k][to[k]]++;
                if (from[k] == to[k]) {
                    bins.box[k][from[k]] = Sah::larger(bins.box[k][from[k]], record);
                    continue;
                }
                f8 parts[BINS_MAX];
                slice(corners, corner_bins, record, k, from[k], to[k], planes[k], parts);
                for (int b = from[k]; b <= to[k]; b++) {
                    f8 part = parts[b] < record ? parts[b] : record;
                    if (is_box(part)) bins.box[k][b] = Sah::larger(bins.box[k][b], part);
                }
            }
        }
    }

    // Writes a cheaper split between two spatial bins into `task`, if there is one with room for its references
    static bool choose(const SpatialBins& bins, const Options& options, const Sah::Measure& measure, Task& task) {
        float best = task.cost;
        for (int k = 0; k < 3; k++) {
            float right_cost[BINS_MAX];
            int right_count[BINS_MAX], count = 0;
            f8 box = Sah::nothing(), right_box[BINS_MAX];
            for (int b = bins.bins - 1; b > 0; b--) {
                box = Sah::larger(box, bins.box[k][b]);
                count += bins.leave[k][b];
                right_cost[b] = measure(box) * Sah::groups(options, count);
                right_count[b] = count;
                right_box[b] = box;
            }
            box = Sah::nothing();
            count = 0;
            for (int b = 0; b < bins.bins - 1; b++) {
                box = Sah::larger(box, bins.box[k][b]);
                count += bins.enter[k][b];
                if (count == 0 || right_count[b + 1] == 0 || count + right_count[b + 1] > task.capacity) continue;
                float cost = measure(box) * Sah::groups(options, count) + right_cost[b + 1];
                if (cost < best) {
                    best = task.cost = cost;
                    task.kind = SPATIAL;
                    task.axis = k;
                    task.position = plane(bins, task.box, k, b);
                    task.left_box = box;
                    task.right_box = right_box[b + 1];
                    task.left_weight = count;
                    task.right_weight = right_count[b + 1];
                }
            }
        }
        return task.kind == SPATIAL;
    }

    // The sides that references go to at a spatial split.
    struct Sides {
        const Spatial& mesh;
        const Task& task;
        Sah::Measure measure;
        float left_area, right_area;
        Sides(const Spatial& mesh, const Task& task) : mesh(mesh), task(task), measure(task.box) {
            left_area = measure(task.left_box);
            right_area = measure(task.right_box);
        }
        // 1: left, 2: right, 3: both; the records to put there
        int operator()(f8 record, f8& left, f8& right) const {
            left = right = record;
            if (record[4 + task.axis] <= task.position) return 1;
            if (-record[task.axis] >= task.position) return 2;
            float both = left_area * task.left_weight + right_area * task.right_weight;
            float all_left =
                measure(Sah::larger(task.left_box, record)) * task.left_weight + right_area * (task.right_weight - 1);
            float all_right =
                left_area * (task.left_weight - 1) + measure(Sah::larger(task.right_box, record)) * task.right_weight;
            if (all_left < both && all_left <= all_right) return 1;
            if (all_right < both) return 2;
            cut(mesh.corners(record), record, task.axis, task.position, left, right);
            int sides = is_box(left) + 2 * is_box(right);
            if (sides == 0) {
                left = record;
                return 1;
            }  // its triangle meets no point of the box: never lost, though
            return sides;
        }
    };

    void count(
        const f8u* records, const Task& task, long long first, long long count, long long& left_count,
        long long& right_count
    ) const {
        Sides sides(*this, task);
        left_count = right_count = 0;
        for (long long i = first; i < first + count; i++) {
            f8 left, right;
            int to = sides(records[i], left, right);
            left_count += to & 1;
            right_count += to >> 1;
        }
    }

    void partition(
        const f8u* from, f8u* to, const Task& task, long long first, long long count, long long left, long long right,
        Sah::Bounds* bounds
    ) const {
        Sides sides(*this, task);
        for (long long i = first; i < first + count; i++) {
            f8 parts[2];
            int chosen = sides(from[i], parts[0], parts[1]);
            if (chosen & 1) {
                to[left++] = parts[0];
                bounds[0].add(parts[0]);
            }
            if (chosen & 2) {
                to[right++] = parts[1];
                bounds[1].add(parts[1]);
            }
        }
    }
};
