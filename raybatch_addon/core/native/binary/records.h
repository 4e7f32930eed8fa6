// Records, tasks and jobs of the CPU builder.
//
// A reference is a record of eight floats: the negated low corner, the triangle, the high corner, 0; so that one
// maximum joins two boxes. Lane 3 holds the triangle's index plus INDEX_BIAS, the bits of 1, which is a float above 1:
// squares of small numbers are denormal, and would make the arithmetic beside them slow.
typedef float f4 __attribute__((vector_size(16)));
typedef int i4 __attribute__((vector_size(16)));
typedef float f8 __attribute__((vector_size(32)));
typedef float f16 __attribute__((vector_size(64)));
typedef int i16 __attribute__((vector_size(64)));
typedef float f8u __attribute__((vector_size(32), aligned(4)));  // at any address that NumPy gives
enum { BINS_FEW = 16, FEW = 512, EXACT_MAX = 16 };

// The fields are those of NumPy's tables, which Python passes.
struct Task {
    TASK_FIELDS
};
struct Job {
    JOB_FIELDS
};
struct Bins {
    BINS_FIELDS
};
struct SpatialBins {
    SPATIAL_BINS_FIELDS
};
static_assert(sizeof(Task) == TASK_BYTES && sizeof(Job) == JOB_BYTES, "as NumPy has them");
static_assert(sizeof(Bins) == BINS_BYTES && sizeof(SpatialBins) == SPATIAL_BINS_BYTES, "as NumPy has them");
struct Options {
    int leaf_group, leaf_max;
    float traversal_cost;
    float group_inverse;  // 1 / leaf_group, rounded upwards
};
