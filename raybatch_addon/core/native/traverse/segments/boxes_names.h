// Triangles' leaves have another name where segments have theirs.
#define test_leaf test_triangle_leaf
#define INLINE_SEGMENT INLINE
