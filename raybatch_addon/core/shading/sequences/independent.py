"""Independent numbers, whose error statistics are textbook Monte Carlo."""

import warp as wp

from .keys import sequence_number


@wp.func
def philox(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Philox4x32-10: 128 random bits (Salmon et al., "Parallel Random Numbers: As Easy as 1, 2, 3", 2011)."""
    c0 = counter[0]
    c1 = counter[1]
    c2 = counter[2]
    c3 = counter[3]
    k0 = key[0]
    k1 = key[1]
    for _ in range(10):
        p0 = wp.uint64(wp.uint32(0xD2511F53)) * wp.uint64(c0)
        p1 = wp.uint64(wp.uint32(0xCD9E8D57)) * wp.uint64(c2)
        n0 = wp.uint32(p1 >> wp.uint64(32)) ^ c1 ^ k0
        n2 = wp.uint32(p0 >> wp.uint64(32)) ^ c3 ^ k1
        c1 = wp.uint32(p1 & wp.uint64(0xFFFFFFFF))
        c3 = wp.uint32(p0 & wp.uint64(0xFFFFFFFF))
        c0 = n0
        c2 = n2
        k0 = k0 + wp.uint32(0x9E3779B9)
        k1 = k1 + wp.uint32(0xBB67AE85)
    return wp.vec4ui(c0, c1, c2, c3)


@wp.func
def philox_1d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> float:
    """The first of the two numbers."""
    return philox_2d(key, sample, dimension)[0]


@wp.func
def philox_2d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> wp.vec2:
    """Two numbers of a set."""
    counter = wp.vec4ui(sample, dimension, wp.uint32(0), wp.uint32(0))
    bits = philox(counter, wp.vec2ui(key[0], wp.uint32(0)))
    return wp.vec2(sequence_number(bits[0]), sequence_number(bits[1]))
