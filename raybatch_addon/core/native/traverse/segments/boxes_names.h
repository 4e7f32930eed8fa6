// Triangles' leaves have another name where segments have theirs, of which eight are met at once.
#define test_leaf test_triangle_leaf
#define INLINE_SEGMENT INLINE
typedef Floats Number;
