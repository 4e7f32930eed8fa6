// The test of a triangle has another name where segments have theirs, of which one is met at a time.
#define test test_triangle
#define INLINE_SEGMENT
typedef float Number;
