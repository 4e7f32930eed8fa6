"""How far a box must reach so that no hit of the triangle test is ever outside it.

The triangle test (`intersect.py`) finds a distance t that is a little wrong, and the box test rounds too. A box or
subtree may be skipped only where no triangle inside could give a hit, so boxes and rays carry a margin that bounds
both. Then the closest hit does not depend on the tree, nor on the order in which it is visited.

Write u = 2**-24 for half an ulp of 1, o' and v' for the ray's origin and a vertex relative to the tree's `centre`,
|.| for the largest absolute coordinate, and m = |o'| + M where M bounds |v'|. Second-order terms are left out; the
slack below is far larger.

Where is the exact ray at the computed t? Along the axis z where the direction d is largest (|dx / dz| <= 1):

- corners minus origin, a = v - o:                            u m a coordinate
- shear, x = ax - (dx / dz) az, one FMA:                      u m (ax) + u m (dx / dz) + u m (az) + 2 u m (FMA) = 5 u m
- the edge functions of the sheared corners as computed have the right sign and relative error 2u (Kahan's difference
  of products; Jeannerod, Louvet and Muller 2013); their sum, its reciprocal and the products make the three weights,
  which are those of a point inside the triangle to 8u each
- z = sum of weights times az, three roundings:               8 u m + u m (az) + 3 u m = 12 u m
- t = z / dz by a rounded reciprocal and product:             14 u m in all, measured along z

So t dz is within 14 u m of a weighted mean of the az, and t dx within 14 u m + 5 u m = 19 u m of the same mean of the
ax: the ray's point at t is within **19 u m of the triangle's box** in each coordinate.

The slab test computes fma(plane, 1/d, b) with b = -(o' +- margin) / d. In units of length the roundings of 1/d, of b
and of the FMA cost 2 u (|o'| + M) + 2 u |o'|, and o' itself u |o'|. A component of d that is raised to 2**-40 of the
largest moves the point by 2**-40 m, less than u m / 2**15. All together 24 u |o'| + 21 u M, for which 32 is used. (CUDA
computes with approximate reciprocals; what they take of the slack is counted in `traverse/quantised/ray.h`.)

The two parts are split: every child box in a wide node is grown by `SLAB_MARGIN` M, M the largest absolute coordinate
of the boxes in that node, and every ray moves its near planes back and its far planes on by `SLAB_MARGIN` |o'|.

For lengths m between 1e-18 and 1e18 nothing here leaves the normal numbers of float32, but for the edge functions of
slivers, which the triangle test computes again in float64 when they are tiny.
"""

SLAB_MARGIN = 32 * 2.0**-24
"""Of the largest absolute coordinate relative to the tree's centre: of a node (grows its boxes) and of a ray's
origin.
"""

TRIANGLE_TEST = 25 * 2.0**-24
"""How far the ray's point at the distance that is found may be off the triangle in each coordinate, of the largest
coordinate of the corners relative to the ray's origin: the 19 roundings above, and what CUDA's approximate reciprocals
add."""

DIRECTION_LEAST = 2.0**-40
"""A component of a direction counts as at least this times the largest one in the box test."""
