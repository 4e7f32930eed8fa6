"""The watertight triangle test.

Woop, Benthin and Wald 2013, "Watertight Ray/Triangle Intersection": the corners are moved to the ray's origin and
sheared so that the ray runs along an axis z; in the plane across it the signs of three edge functions tell whether the
ray passes through. Two triangles that share an edge see the same sheared corners, and the sign of each edge function
is exact: it is a difference of two products by Kahan's scheme with fused multiply-adds (relative error at most 2u;
Jeannerod, Louvet and Muller 2013), and where it is so small that a product may leave the normal numbers all three are
computed again in float64, where products of float32 are exact. So no ray slips between two triangles.

    Sx = dx / dz, Sy = dy / dz, Sz = 1 / dz     z: the axis of the largest |d|, the first of equals; x, y follow in
    cycle a' = a - o; ax = fma(-Sx, az', ax'), ay = fma(-Sy, az', ay')                likewise b, c
    U = cx by - cy bx, V = ax cy - ay cx, W = bx ay - by ax
    hit when all are >= 0 or all are <= 0, and U + V + W is not 0
    r = 1 / (U + V + W); weights U r, V r, W r of the corners a, b, c
    t = fma(W r, cz', fma(V r, bz', (U r) az')) Sz

The result is a function of ray and triangle alone. `margin.py` bounds its error. On CUDA it is the same but for
rounding: reciprocals are approximate, and the order of x and y differs, which mirrors the triangle.
"""

EDGE_TINY = 2.0**-80
"""Edge functions up to this size are computed again in float64."""
