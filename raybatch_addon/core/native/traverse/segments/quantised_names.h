// The test of a triangle has another name where segments have theirs.
#define test test_triangle
#define INLINE_SEGMENT
